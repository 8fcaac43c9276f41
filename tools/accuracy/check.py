"""What a check of accuracy is, and what checks share: options, data sets of others, root mean squares."""

from __future__ import annotations

import argparse
import os
import sys
from ast import literal_eval
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from smoother.config import Config

#: The simulated cameras whose figures are published.
PRESETS = ("white", "realistic", "azure")
ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})


@dataclass(frozen=True)
class Option:
    """An option of a check, as `ArgumentParser.add_argument` takes it."""

    names: tuple[str, ...]
    settings: Mapping[str, Any]


def option(*names: str, **settings: Any) -> Option:
    """An option by its names."""
    return Option(names, settings)


@dataclass(frozen=True)
class Check:
    """A figure that can be repeated."""

    name: str  # `python -m tools.accuracy NAME`
    rows: Callable[[argparse.Namespace], Iterator[str]]  # From the options to the lines that are printed
    options: tuple[Option, ...] = ()

    @property
    def about(self) -> str:
        """What it measures."""
        return (self.rows.__doc__ or "").strip()


def seeds_option(default: str, about: str = "") -> Option:
    """The seeds of a check: `A:B` from A up to B - 1, or `N` from 0 up to N - 1."""
    words = f"{about or 'seeds'}: A up to B - 1, or 0 up to N - 1 [{default}]"
    return option("--seeds", type=seed_range, default=seed_range(default), metavar="A:B", help=words)


def seed_range(text: str) -> range:
    """Seeds as `--seeds` takes them."""
    first, _, last = text.partition(":")
    return range(int(first), int(last)) if last else range(int(first))


def preset_option(default: str) -> Option:
    """Which simulated camera."""
    return option("--preset", default=default, help=f"of `unocclude simulate arm` [{default}]")


CHANGES = option(
    "--set", nargs="*", default=[], metavar="NAME=VALUE", help="change a setting of the simulation"
)
ONLY = option("--only", default="", help="trials whose name contains this")
DRAWS = option("--draws", type=int, default=64, help="motions drawn of each recording [64]")
JSON = option("--json", type=Path, help="the figures in a file")


def parts_option(*names: str) -> Option:
    """Which parts of a check are wanted; all if none is named."""
    return option("parts", nargs="*", choices=[[], *names], help="what to measure; all if none is named")


def changes(options: argparse.Namespace) -> dict[str, Any]:
    """What `--set` changes: numbers and tuples as such, anything else as text."""
    return {name: _value(text) for name, text in (pair.split("=", 1) for pair in options.set)}


def _value(text: str) -> Any:
    try:
        return literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def datasets(name: str) -> Path:
    """One of the folders of recordings that others made."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        sys.exit("set UNOCCLUDE_DATASETS to the folder of the data sets")
    return Path(folder) / name


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
