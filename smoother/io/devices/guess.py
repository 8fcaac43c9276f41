"""A guess at what a table holds, and the recording.toml that it makes."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from .sheet import Sheet


@dataclass
class Guess:
    """What a table seems to hold.

    Attributes
    ----------
    kind : str
        "imu", "skeleton" or "" where nothing fits.
    columns : dict of str to object
        As in recording.toml: a name or a number by what it is.
    keys : dict of str to object
        Further keys of the section (time_unit, accelerometer_unit ..).
    reasons : dict of str to str
        Why, by column or key.
    unsure : list of str
        What to check, a sentence each.
    """

    kind: str = ""
    columns: dict[str, object] = field(default_factory=dict)
    keys: dict[str, object] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    unsure: list[str] = field(default_factory=list)


def toml_of(path: Path, guess: Guess, name: str) -> str:
    """A recording.toml of a guess, with its reasons as comments."""
    section = "camera" if guess.kind == "skeleton" else f"imu.{name}"
    lines = [f"[{section}]"]
    lines.append(f"{'skeleton' if guess.kind == 'skeleton' else 'file'} = {_value(path.name)}")
    for key, value in guess.keys.items():
        reason = guess.reasons.get(key, "")
        lines.append(f"{key} = {_value(value)}" + (f"  # {reason}" if reason else ""))
    lines += ["", f"[{section}.columns]"]
    for key, value in guess.columns.items():
        reason = guess.reasons.get(key[0], "") if guess.kind == "imu" and key[1:] == "x" else ""
        lines.append(f"{key} = {_value(value)}" + (f"  # {reason}" if reason else ""))
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_value(str(key))} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_value(one) for one in value) + "]"
    if isinstance(value, str):  # JSON lets one control character stand that TOML does not
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return f"{value:g}"


def named(sheet: Sheet, column: int) -> str | int:
    """A column as recording.toml names it: by its name where it has one of its own, else by its number."""
    name = sheet.layout.names[column] if sheet.layout.names else ""
    return name if name and list(sheet.layout.names).count(name) == 1 else column + 1


def is_numeric(sheet: Sheet, column: int) -> bool:
    """Whether most cells of a column are numbers."""
    try:
        return bool(np.isfinite(sheet.numbers(column)).mean() > 0.5)
    except RecordingError:
        return False
