"""What checks of accuracy share: how they are named, options, data sets of others, root mean squares."""

from __future__ import annotations

import argparse
import os
import sys
from ast import literal_eval
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smoother.config import Config

#: The simulated cameras whose figures are published.
PRESETS = ("white", "realistic", "azure")
ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})

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


PRESET = option("--preset", default="realistic", help="of `unocclude simulate arm` [realistic]")
CHANGES = option("--set", nargs="*", default=[], metavar="NAME=VALUE", help="change the simulation")
ONLY = option("--only", default="", help="trials whose name contains this")
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


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
