"""What a data set of the benchmark is, and one of its trials."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..recording import Recording

#: Of the tasks: it changes when a split, a gap or a way to score does.
VERSION = 1
#: What the authors of a method worked with, and what none of them should look at before they publish.
SPLITS = ("development", "test")


@dataclass(frozen=True)
class BenchmarkTrial:
    """A recording in which gaps are hidden.

    Attributes
    ----------
    dataset : str
        Key of its data set.
    name : str
        As its files are called, without the ending.
    split : str
        One of `SPLITS`.
    files : tuple of Path
        What it is read from.
    calibrated_on : str
        The group of recordings that calibrate its arm beforehand; "" where nothing does.
    """

    dataset: str
    name: str
    split: str
    files: tuple[Path, ...]
    calibrated_on: str = ""

    @property
    def key(self) -> str:
        """Which of all trials it is, wherever the files are."""
        return f"{self.dataset}/{self.name}"

    def seed(self, seed: int) -> int:
        """Of its gaps: by its name, so that no other trial moves them."""
        digest = hashlib.sha256(f"{VERSION}/{seed}/{self.key}".encode()).digest()
        return int.from_bytes(digest[:4], "big")


@dataclass(frozen=True)
class BenchmarkData:
    """A public data set.

    Attributes
    ----------
    key : str
        Its folder, and what users call it.
    title : str
    source : str
        The paper or the place to cite, with its licence.
    point : str
        What is scored, in words.
    lengths_s : tuple of float, s
        Of the gaps.
    gaps : int
        Most gaps of a length in a trial.
    together : bool
        Gaps of all lengths are in one copy of a trial, as long recordings allow; else a copy a length.
    find : callable
        From the data set's folder to its trials that are there, in a fixed order; those of which a file is
        missing are left out.
    open : callable
        From a trial to its recording; raises `UnoccludeError`.
    calibrations : callable
        From the folder to the files of each group that calibrates, by the group's name.
    layout : str
        Which files are looked for, for messages.
    """

    key: str
    title: str
    source: str
    point: str
    lengths_s: tuple[float, ...]
    gaps: int
    together: bool
    find: Callable[[Path], Iterator[BenchmarkTrial]]
    open: Callable[[BenchmarkTrial], Recording]
    layout: str
    calibrations: Callable[[Path], dict[str, list[BenchmarkTrial]]] = lambda folder: {}
