"""JSON files of skeletons: read whole, with an error that names the file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from .head import decode


def read_json(path: Path, expected: str) -> Any:
    """The value that a JSON file holds; a line a value makes a list.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        What it should be, for messages.

    Raises
    ------
    RecordingError
        It cannot be read, or is no JSON.
    """
    check_input(path, RecordingError)
    try:
        text = decode(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        rows = _lines(text)
        if rows is not None:
            return rows
        where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise RecordingError(
            f"{path} should be {expected}, and its JSON breaks off{where}; copy or export it again."
        ) from None


def _lines(text: str) -> list[Any] | None:
    """The values of JSON lines; None where the text is none. A last line that is cut off is left out."""
    lines = [line for line in text.splitlines() if line.strip()]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            rows.append(json.loads(line))
        except (ValueError, RecursionError):
            if number < len(lines) or not rows:
                return None
    return rows if len(rows) > 1 else None


def xyz_of(value: Any) -> tuple[float, float, float, float]:
    """x, y, z and confidence of a point as a list or a mapping; nan for what is missing."""
    if isinstance(value, Mapping):
        small = {str(key).lower(): entry for key, entry in value.items()}
        inner = next(
            (small[key] for key in ("position", "pos", "xyz", "location", "point") if key in small), None
        )
        if inner is not None:
            x, y, z, _ = xyz_of(inner)
        else:
            x, y, z = (number(small.get(axis)) for axis in "xyz")
        names = (
            "visibility",
            "confidence",
            "confidence_level",
            "state",
            "trackingstate",
            "tracking_state",
            "score",
        )
        share = next((number(small[name]) for name in names if name in small), float("nan"))
        return x, y, z, share
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) >= 3:
        x, y, z, *rest = value[:4]
        return number(x), number(y), number(z), number(rest[0]) if rest else float("nan")
    return (float("nan"),) * 4


def number(value: Any) -> float:
    """A number, or nan for anything else (words of confidence count 0 to 3)."""
    if isinstance(value, bool):
        return float("nan")
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e300 else float("nan")
    if isinstance(value, str):
        word = value.lower().rpartition("_")[2]
        levels = {
            "none": 0.0,
            "nottracked": 0.0,
            "low": 1.0,
            "inferred": 1.0,
            "medium": 2.0,
            "tracked": 2.0,
            "high": 3.0,
        }
        if word in levels:
            return levels[word]
        try:
            return float(value)
        except ValueError:
            return float("nan")
    return float("nan")


def points(values: Sequence[tuple[float, float, float, float]]) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) and confidences (N,)."""
    table = np.array(values, dtype=float).reshape(-1, 4)
    return table[:, :3].copy(), table[:, 3].copy()
