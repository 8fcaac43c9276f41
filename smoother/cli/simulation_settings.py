"""Settings of a simulation as options of a command."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from .option_groups import with_signature

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo


def with_settings(command: Any, settings: dict[str, FieldInfo]) -> Any:
    """The command with an option for every setting of a simulation."""
    own = [p for p in inspect.signature(command, eval_str=True).parameters.values() if p.name != "settings"]
    taken = {parameter.name for parameter in own}
    fields = {name: field for name, field in settings.items() if name not in taken}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=_option(name, field))
        for name, field in fields.items()
    ]

    def run(**values: Any) -> None:
        command(**values)

    return with_signature(run, command, own + more)


def _option(name: str, field: FieldInfo) -> Any:
    """The option of a setting; None where it is not given."""
    flag = "--" + name.replace("_", "-")
    default = field.get_default()
    text = _shown(default)
    about = ". ".join(part for part in (field.description, f"[{text}]") if part)
    if isinstance(default, bool):
        return Annotated[bool | None, typer.Option(f"{flag}/--no-{flag[2:]}", help=about, show_default=False)]
    kind: Any = str
    if isinstance(default, int):
        kind = int
    elif isinstance(default, float) or (default is None and float in get_args(field.annotation)):
        kind = float
    metavar = "|".join(_choices(field)) or {int: "N", float: "X", str: "X,X,.."}[kind]
    return Annotated[kind | None, typer.Option(flag, metavar=metavar, help=about, show_default=False)]


def _choices(field: FieldInfo) -> list[str]:
    """Values that a setting may take, where they are named."""
    if hasattr(field.annotation, "__members__"):
        return [str(member.value) for member in field.annotation]  # type: ignore[union-attr]
    return [value for value in get_args(field.annotation) if isinstance(value, str)]


def _shown(default: Any) -> str:
    if default is None:
        return "none"
    if isinstance(default, tuple):
        return ",".join(str(item) for item in default)
    return str(default.value if hasattr(default, "value") else default).lower()
