"""What several tools share: the data sets' folder, one process, the parts to run."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from smoother.config import Config

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})


def datasets(name: str) -> Path:
    """One of the folders of recordings that others made."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        sys.exit("set UNOCCLUDE_DATASETS to the folder of the data sets")
    return Path(folder) / name


def rms(values: ArrayLike) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def run_parts(about: str, parts: Mapping[str, Callable[[int], None]], seeds: int) -> None:
    """Run the parts that the command line asks for, all if it names none, each on its seeds."""
    parser = argparse.ArgumentParser(description=about.splitlines()[0])
    parser.add_argument(
        "parts", nargs="*", choices=[[], *parts], help="what to measure; all if none is named"
    )
    parser.add_argument("--seeds", type=int, default=seeds)
    options = parser.parse_args()
    for name in options.parts or parts:
        parts[name](options.seeds)
