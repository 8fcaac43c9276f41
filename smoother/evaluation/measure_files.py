"""Pairs and detectable changes of measures from files of `validate`, `progress` and the user."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from ..measures.definitions import definitions, is_measure
from ..runtime.inputs import read_toml
from .measure_agreement import MeasurePair


def read_pairs(path: Path) -> list[MeasurePair]:
    """The pairs of an earlier validation's `--json`."""
    figures = _figures(path)
    pairs = [pair for arm in figures for pair in arm.get("measures", {}).get("pairs", [])]
    names = set(MeasurePair.__dataclass_fields__)
    try:
        read = [_pair({name: pair[name] for name in names}) for pair in pairs]
    except (KeyError, TypeError, ValueError) as error:
        raise UnoccludeError(
            f"{path}: its measures cannot be read; run `unocclude validate` again"
        ) from error
    if not read:
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return read


def read_detectable(path: Path) -> dict[str, float]:
    """Minimal detectable changes by the measures' keys."""
    if path.suffix.lower() == ".toml":
        return _detectable_of_user(path)
    if (repeated := _json(path).get("reliability")) is not None:
        return _detectable_of_sessions(path, repeated)
    found: dict[str, float] = {}
    pairs: dict[str, int] = {}
    for arm in _figures(path):
        for key, figures in arm.get("measures", {}).get("agreement", {}).get("session", {}).items():
            value, count = figures.get("mdc95"), figures.get("pairs", 0)
            if isinstance(value, int | float) and value > 0 and count > pairs.get(key, 0):
                found[key], pairs[key] = float(value), count
    if not found:
        raise UnoccludeError(
            f"{path} has no minimal detectable change of a session; it takes three recordings with motion"
            " capture, each validated with --pool and the JSON of those before"
        )
    return found


def _detectable_of_sessions(path: Path, repeated: object) -> dict[str, float]:
    """Smallest detectable changes that `progress --reliability --json` wrote; the largest of several arms."""
    found: dict[str, float] = {}
    for each in repeated if isinstance(repeated, list) else []:
        key, value = (each.get("key"), each.get("sdc")) if isinstance(each, dict) else (None, None)
        if isinstance(key, str) and isinstance(value, int | float) and 0 < value < math.inf:
            _check_key(key, path)
            found[key] = max(float(value), found.get(key, 0.0))
    if not found:
        raise UnoccludeError(
            f"{path} has no smallest detectable change; `progress --reliability` needs three persons with"
            " two sessions each"
        )
    return found


def _json(path: Path) -> dict[str, Any]:
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise UnoccludeError(f"{path} is not JSON; name what `unocclude validate --json` wrote") from error
    return figures if isinstance(figures, dict) else {}


def _figures(path: Path) -> list[dict[str, Any]]:
    """What `validate --json` wrote, one entry per arm."""
    figures = _json(path)
    arms = figures.get("arms", [figures]) if figures else []
    if not arms or not all(isinstance(arm, dict) and isinstance(arm.get("measures"), dict) for arm in arms):
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return arms


def _pair(values: Mapping[str, Any]) -> MeasurePair:
    numbers = ("value", "low", "high", "reference", "recovered_share")
    texts = ("recording", "side", "scope", "key", "name", "unit")
    if not all(isinstance(values[name], str) for name in texts):
        raise TypeError("text expected")
    if values["scope"] not in ("session", "movement", "repetition"):
        raise ValueError(values["scope"])
    finite = {name: math.nan if values[name] is None else float(values[name]) for name in numbers}
    return MeasurePair(**{**values, **finite})


def _detectable_of_user(path: Path) -> dict[str, float]:
    try:
        tables = read_toml(path)
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except ValueError as error:
        raise UnoccludeError(f"{path} is not TOML: {error}") from error
    table = tables.get("mdc95")
    if not isinstance(table, dict) or not table:
        raise UnoccludeError(
            f"{path} has no table [mdc95]; write one with a line per measure: elbow_flexion_range_deg = 5.0"
        )
    for key, value in table.items():
        _check_key(key, path)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
            raise UnoccludeError(f"{path}: mdc95 of {key} is {value!r}; it must be a number above 0")
    return {key: float(value) for key, value in table.items()}


def _check_key(key: str, path: Path) -> None:
    """Refuse a key that no measure has, with the nearest that one has."""
    if is_measure(key):
        return
    near = get_close_matches(key, definitions(), n=1, cutoff=0.0)
    raise UnoccludeError(
        f"{path}: there is no measure {key}, so its mdc95 has no effect; the nearest is {near[0]}"
    )
