"""The configuration as a TOML file: read, and printed with its units."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TypeVar

import typer
from pydantic import BaseModel, ValidationError

from ..config import Anatomy, ArmPrior, Config
from ..errors import UnoccludeError
from ..runtime.inputs import check_input, read_toml

Settings = TypeVar("Settings", bound=BaseModel)


def read_config(
    path: Path | None,
    processes: int | None = None,
    anatomy: str | None = None,
    height_m: float | None = None,
) -> Config:
    """Read a configuration; what neither it nor the options name keeps its default."""
    config = with_processes(read_settings(path, Config), processes)
    arm: dict[str, Any] = {} if anatomy is None else {"anatomy": Anatomy(anatomy)}
    if height_m is not None:
        try:
            arm["height_m"] = ArmPrior(height_m=height_m).height_m
        except ValidationError as error:
            raise typer.BadParameter(f"--body-height is in m, as 1.75; not {height_m:g}") from error
    return config.model_copy(update={"arm": config.arm.model_copy(update=arm)}) if arm else config


def read_settings(path: Path | None, kind: type[Settings]) -> Settings:
    """Read settings of any kind; what the file does not name keeps its default."""
    if path is None:
        return kind()
    check_input(path)
    try:
        return kind.model_validate(read_toml(path))
    except ValidationError as error:
        raise UnoccludeError(f"{path}: {describe(error)}") from error
    except OSError as error:
        raise UnoccludeError(f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # also a number of thousands of digits
        raise UnoccludeError(f"{path}: not a TOML file: {error}") from error


def describe(error: ValidationError) -> str:
    """The first thing that a check found, with the key that it concerns."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"there is no setting '{key}'{more}"
    return f"'{key}' = {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}{more}"


def with_processes(config: Config, processes: int | None) -> Config:
    """The configuration with another number of worker processes, if one is given."""
    if processes is None:
        return config
    windows = config.windows.model_copy(update={"processes": processes})
    return config.model_copy(update={"windows": windows})


def to_toml(config: BaseModel) -> str:
    """The configuration as TOML; each setting's meaning and unit in a comment."""
    lines: list[str] = []
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if not isinstance(value, BaseModel):
            lines.append(_line(name, value, field.description))
            continue
        if lines:
            lines.append("")
        summary = (type(value).__doc__ or "").strip().splitlines()
        lines += [f"# {summary[0]}"] if summary else []
        lines.append(f"[{name}]")
        lines += [
            _line(key, getattr(value, key), leaf.description)
            for key, leaf in type(value).model_fields.items()
        ]
    return "\n".join(lines) + "\n"


def _line(name: str, value: Any, description: str | None) -> str:
    comment = f"  # {description}" if description else ""
    if value is None:
        return f"# {name} ={comment}"
    return f"{name} = {_value(value)}{comment}"


def _value(value: Any) -> str:
    """A TOML value; its strings, numbers and flags are written as JSON writes them."""
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
