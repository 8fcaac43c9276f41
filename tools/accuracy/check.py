"""What checks of accuracy share: how they are named, options, one table of errors, data sets of others."""

from __future__ import annotations

import argparse
import os
import sys
from ast import literal_eval
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from smoother.array_types import FloatArray
from smoother.config import Config
from smoother.errors import UnoccludeError

#: The simulated cameras whose figures are published.
PRESETS = ("white", "realistic", "azure")
ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})
#: Of a normal number 95 of 100 lie within this many standard deviations.
Z_95 = 1.96

#: From the options to the lines that are printed.
Rows = Callable[[argparse.Namespace], Iterator[str]]
#: An option as `ArgumentParser.add_argument` takes it.
Option = tuple[tuple[str, ...], dict[str, Any]]
#: Every check by name: `python -m tools.accuracy NAME`.
CHECKS: dict[str, tuple[Rows, tuple[Option, ...]]] = {}


def check(*options: Option) -> Callable[[Rows], Rows]:
    """A figure that can be repeated, by the function's name."""

    def named(rows: Rows) -> Rows:
        CHECKS[rows.__name__] = rows, options
        return rows

    return named


def option(*names: str, **settings: Any) -> Option:
    """An option by its names."""
    return names, settings


def seeds_option(default: str, about: str = "seeds") -> Option:
    """The seeds of a check: `A:B` from A up to B - 1, or `N` from 0 up to N - 1."""
    words = f"{about}: A up to B - 1, or 0 up to N - 1 [{default}]"
    return option("--seeds", type=seed_range, default=seed_range(default), metavar="A:B", help=words)


def seed_range(text: str) -> range:
    """Seeds as `--seeds` takes them."""
    first, _, last = text.partition(":")
    return range(int(first), int(last)) if last else range(int(first))


CHANGES = option("--set", nargs="*", default=[], metavar="NAME=VALUE", help="change the simulation")
DRAWS = option("--draws", type=int, default=64, help="motions drawn of each recording [64]")


def parts_option(*names: str) -> Option:
    """Which parts of a check are wanted; all if none is named."""
    return option("parts", nargs="*", choices=[[], *names], help="what to measure; all if none is named")


def changes(options: argparse.Namespace) -> dict[str, Any]:
    """What `--set` changes: numbers and tuples as such, anything else as text."""
    found: dict[str, Any] = dict(pair.split("=", 1) for pair in options.set)
    for name, text in found.items():
        try:
            found[name] = literal_eval(text)
        except (ValueError, SyntaxError):
            continue
    return found


def datasets(name: str) -> Path:
    """One of the folders of recordings that others made."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        sys.exit("set UNOCCLUDE_DATASETS to the folder of the data sets")
    return Path(folder) / name


@dataclass(frozen=True)
class Run:
    """What a recording adds to a row of the oracle: errors (n, 4) and counts."""

    errors: list[FloatArray] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)


def ended(error: Exception) -> Counter[str]:
    """What is counted of a recording without an answer; a traceback is a finding."""
    refused = isinstance(error, UnoccludeError)
    print("" if refused else f"{type(error).__name__}: {error}\n", end="", file=sys.stderr)
    return Counter({"recordings": 1, "refused" if refused else "crashed": 1})


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def table(sql: str, found: Iterable[dict[str, Any]]) -> Iterator[str]:
    """The answer of SQL on the rows called `found`, as a table of Markdown."""
    found = pa.Table.from_pylist(list(found))
    answer = duckdb.sql(sql)
    yield f"| {' | '.join(answer.columns)} |\n|{'---|' * len(answer.columns)}"
    for row in answer.fetchall():
        cells = (
            f"{cell:.4g}" if isinstance(cell, float) else "" if cell is None else str(cell) for cell in row
        )
        yield f"| {' | '.join(cells)} |"


def error_table(errors: Iterable[dict[str, Any]], by: str) -> Iterator[str]:
    """Errors `off` (n,) with their `sigma` (n,), and the labels of `by`: a line for each group.

    `squared`, the squared error over the variance, is of the two if it is not given; so is `inside`, whether
    the error lies inside its 95 % interval.
    """
    rows = []
    for each in errors:
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.where(np.isfinite(each["sigma"]), np.abs(each["off"]) / each["sigma"], np.nan)
        inside = np.where(np.isfinite(ratio), ratio < Z_95, np.nan)
        columns = {"squared": ratio**2, "inside": inside} | each
        values = [np.broadcast_to(value, ratio.shape).ravel().tolist() for value in columns.values()]
        known = [[None if one != one else one for one in column] for column in values]
        rows += [dict(zip(columns, row, strict=True)) for row in zip(*known, strict=True)]
    return table(
        f"""select {by}, count(off) as n, sqrt(avg(off * off)) as rms, avg(off) as bias,
        max(abs(off)) as worst, median(sigma) as sigma, avg(squared::double) as NEES,
        100 * avg(inside::double) as "inside %" from found group by {by} order by {by}""",
        rows,
    )
