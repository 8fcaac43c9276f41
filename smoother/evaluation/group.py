"""Measures and curves of several persons together: mean, spread, change; the long format for statistics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..runtime.csv_rows import write_rows
from ..runtime.outputs import writing
from .progress import first_of

#: Measures of a group's table.
MOST_MEASURES = 12
#: Names of the long format's columns.
LONG = (
    *("person", "session", "session_number", "day", "task", "recording", "side", "trusted"),
    *("measure", "name", "unit", "value", "low", "high", "sigma", "recovered_share"),
)


@dataclass(frozen=True)
class Spread:
    """Values of several persons."""

    count: int  # Persons
    mean: float  # nan without any
    sd: float  # nan without two


@dataclass(frozen=True)
class GroupMeasure:
    """One measure over the persons."""

    side: str
    task: str
    key: str
    name: str
    unit: str
    first: Spread  # Of the persons' first sessions
    last: Spread  # Of the last sessions of those who have several
    change: float = math.nan  # Mean of last less first over those persons; nan without any
    low: float = math.nan  # 95 % interval of that mean by Student's t over the persons
    high: float = math.nan


def write_long(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the long format as CSV: a header, a comma, a point, empty cells where there is nothing."""
    with (
        writing(path, force=True) as temporary,
        open(temporary, "w", newline="", encoding="utf-8") as file,
    ):
        write_rows(file, [LONG, *([row[key] for key in LONG] for row in rows)])


def group_measures(rows: Sequence[Mapping[str, Any]]) -> list[GroupMeasure]:
    """The main measures over the persons, without what is not to be trusted."""
    from scipy.stats import t

    values: dict[tuple[str, str, str], dict[str, dict[int, float]]] = {}
    about: dict[str, tuple[str, str]] = {}
    for row in rows:
        if not row["trusted"] or row["value"] is None:
            continue
        about[row["measure"]] = row["name"], row["unit"] or ""
        persons = values.setdefault((row["side"], row["task"], row["measure"]), {})
        persons.setdefault(row["person"], {})[row["session_number"]] = float(row["value"])
    keys = first_of(list(about), MOST_MEASURES)
    chosen = sorted((key for key in values if key[2] in keys), key=lambda key: (*key[:2], keys.index(key[2])))
    found = []
    for key in chosen:
        sessions = [[each[number] for number in sorted(each)] for each in values[key].values()]
        several = [each for each in sessions if len(each) > 1]
        change = _spread([each[-1] - each[0] for each in several])
        half = math.nan
        if change.count > 1:
            half = float(t.ppf(0.975, change.count - 1)) * change.sd / math.sqrt(change.count)
        first, last = _spread([each[0] for each in sessions]), _spread([each[-1] for each in several])
        ends = (change.mean - half, change.mean + half)
        found.append(GroupMeasure(*key, *about[key[2]], first, last, change.mean, *ends))
    return found


def _spread(values: Sequence[float]) -> Spread:
    count = len(values)
    mean = float(np.mean(values)) if count else math.nan
    return Spread(count, mean, float(np.std(values, ddof=1)) if count > 1 else math.nan)
