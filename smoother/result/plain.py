"""Values of a result as plain ones, as files and `--json` state them, and back, by their type hints."""

from __future__ import annotations

import json
from functools import cache
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError

T = TypeVar("T")

#: A number that a file states as null where it is not known.
Known = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]
Vector = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]
Matrix = Annotated[tuple[Vector, ...], Field(min_length=3, max_length=3)]


def plain(value: object) -> Any:
    """A dataclass as plain values: lists for tuples, null for a number that is not known."""
    return json.loads(TypeAdapter(type(value)).dump_json(value))


def from_plain(kind: type[T], value: object) -> T | None:
    """A dataclass from plain values; None where one is of another kind."""
    return _checked(TypeAdapter(kind), value)


def field_from_plain(kind: type, name: str, value: object) -> Any:
    """A dataclass's field from a plain value; None where it is of another kind, or there is no such field."""
    adapter = _fields(kind).get(name)
    return None if adapter is None else _checked(adapter, value)


def _checked(adapter: TypeAdapter[Any], value: object) -> Any:
    try:  # strict as JSON: a list may be a tuple, and a whole number a number, and nothing else
        return adapter.validate_json(json.dumps(value), strict=True)
    except (ValidationError, TypeError, ValueError):
        return None


@cache
def _fields(kind: type) -> dict[str, TypeAdapter[Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: TypeAdapter(hint) for name, hint in hints.items()}
