"""Pairs and detectable changes of measures from files of `validate`, `progress` and the user."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeGuard

from pydantic import TypeAdapter

from ..errors import UnoccludeError
from ..measures.definitions import definitions, is_measure
from ..runtime.inputs import read_toml
from .measure_agreement import MeasurePair


def read_pairs(path: Path) -> list[MeasurePair]:
    """The pairs of an earlier validation's `--json`."""
    pairs = [pair for arm in _arms(path, _json(path)) for pair in arm["measures"].get("pairs", [])]
    try:
        finite = [
            {key: math.nan if value is None and key != "movement" else value for key, value in pair.items()}
            for pair in pairs
        ]
        read = TypeAdapter(list[MeasurePair]).validate_python(finite)
    except (AttributeError, ValueError) as error:
        raise UnoccludeError(
            f"{path}: its measures cannot be read; run `unocclude validate` again"
        ) from error
    if not read:
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return read


def read_detectable(path: Path) -> dict[str, float]:
    """Minimal detectable changes by the measures' keys: of a user, of repeated sessions or of pairs."""
    if path.suffix.lower() == ".toml":
        return _of_user(path)
    figures = _json(path)
    found: dict[str, float] = {}
    if (repeated := figures.get("reliability")) is not None:
        what = (
            "smallest detectable change; `progress --reliability` needs three persons with two sessions each"
        )
        for each in repeated if isinstance(repeated, list) else []:
            key, value = (each.get("key"), each.get("sdc")) if isinstance(each, dict) else (None, None)
            if isinstance(key, str) and _is_change(value):
                _check_keys([key], path)
                found[key] = max(float(value), found.get(key, 0.0))  # the largest of several arms
    else:
        what = (
            "minimal detectable change of a session; it takes three recordings with motion capture, each"
            " validated with --pool and the JSON of those before"
        )
        pairs: dict[str, int] = {}
        for arm in _arms(path, figures):
            for key, own in arm["measures"].get("agreement", {}).get("session", {}).items():
                value, count = own.get("mdc95"), own.get("pairs", 0)
                if _is_change(value) and count > pairs.get(key, 0):
                    found[key], pairs[key] = float(value), count
    if not found:
        raise UnoccludeError(f"{path} has no {what}")
    return found


def _is_change(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _json(path: Path) -> dict[str, Any]:
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise UnoccludeError(f"{path} is not JSON; name what `unocclude validate --json` wrote") from error
    return figures if isinstance(figures, dict) else {}


def _arms(path: Path, figures: dict[str, Any]) -> list[dict[str, Any]]:
    """What `validate --json` wrote, one entry per arm."""
    arms = figures.get("arms", [figures]) if figures else []
    if not arms or not all(isinstance(arm, dict) and isinstance(arm.get("measures"), dict) for arm in arms):
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return arms


def _of_user(path: Path) -> dict[str, float]:
    try:
        table = read_toml(path).get("mdc95")
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise UnoccludeError(f"{path} is not TOML: {error}") from error
    if not isinstance(table, dict) or not table:
        raise UnoccludeError(
            f"{path} has no table [mdc95]; write one with a line per measure: elbow_flexion_range_deg = 5.0"
        )
    _check_keys(table, path)
    for key, value in table.items():
        if not _is_change(value):
            raise UnoccludeError(f"{path}: mdc95 of {key} is {value!r}; it must be a number above 0")
    return {key: float(value) for key, value in table.items()}


def _check_keys(keys: Iterable[str], path: Path) -> None:
    """Refuse a key that no measure has, with the nearest that one has."""
    for key in keys:
        if not is_measure(key):
            near = get_close_matches(key, definitions(), n=1, cutoff=0.0)
            raise UnoccludeError(
                f"{path}: there is no measure {key}, so its mdc95 has no effect; the nearest is {near[0]}"
            )
