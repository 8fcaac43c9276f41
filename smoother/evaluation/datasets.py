"""The public data sets, a loader each; whoever runs the benchmark brings the files.

The `development` split is what this project was developed on; the rest has not been looked at.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..io import import_broad, import_utd_mhad, read_recording, write_recording
from ..io.files import ImuFiles, import_files
from ..recording import Recording

#: Of the tasks: it changes when a split, a gap or a way to score does.
VERSION = 1
#: What the authors of a method worked with, and what none of them should look at before they publish.
SPLITS = ("development", "test")
#: What is not scored: it calibrates the arm of a group of trials.
CALIBRATION = "calibration"


@dataclass(frozen=True)
class BenchmarkTrial:
    """A recording in which gaps are hidden."""

    dataset: str  # Key of its data set
    name: str  # As its files are called, without the ending
    split: str  # One of `SPLITS`, or `CALIBRATION`
    files: tuple[Path, ...]  # What it is read from
    calibrated_on: str = ""  # The group of recordings that calibrate its arm beforehand

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
    """A public data set; docs/benchmark.md has its source and licence."""

    title: str
    lengths_s: tuple[float, ...]  # Of the gaps
    gaps: int  # Most gaps of a length in a trial
    together: bool  # Gaps of all lengths are in one copy of a trial, as long recordings allow
    find: Callable[[Path], Iterable[BenchmarkTrial]]  # The trials in its folder, in a fixed order
    open: Callable[[BenchmarkTrial], Recording]  # From a trial to its recording; raises `UnoccludeError`
    layout: str  # Which files are looked for, for messages


#: The development split: BROAD's trials by number, UTD-MHAD's and SmartFallMM's subjects.
_DEVELOPMENT = {"broad": {3, 5, 7, 11, 14, 16, 24, 33}, "utd_mhad": {1, 2, 3, 4}, "smartfallmm": {43, 44}}


def _split(dataset: str, number: str) -> str:
    return "development" if int(number) in _DEVELOPMENT[dataset] else "test"


def broad_trials(folder: Path) -> list[BenchmarkTrial]:
    """The trials of BROAD, in order of their numbers."""
    numbers = {path: re.match(r"(\d+)_", path.name) for path in sorted(folder.rglob("*.mat"))}
    return [
        BenchmarkTrial("broad", path.stem, _split("broad", number[1]), (path,))
        for path, number in numbers.items()
        if number
    ]


def utd_files(folder: Path) -> dict[tuple[int, int, int], BenchmarkTrial]:
    """The trials of UTD-MHAD's actions with the IMU on the wrist (1 to 21), by subject, action and trial.

    Trial 1 of each action calibrates the subject's arm.
    """
    found = {}
    for inertial in folder.rglob("a*_s*_t*_inertial.mat"):
        numbers = re.fullmatch(r"a(\d+)_s(\d+)_t(\d+)_inertial\.mat", inertial.name)
        name = inertial.name.replace("inertial", "skeleton")
        places = (inertial.with_name(name), inertial.parent.parent / "Skeleton" / name)
        skeleton = next((path for path in places if path.exists()), None)
        if numbers and int(numbers[1]) <= 21 and skeleton:
            action, subject, trial = map(int, numbers.groups())
            split = CALIBRATION if trial == 1 else _split("utd_mhad", numbers[2])
            found[subject, action, trial] = BenchmarkTrial(
                *("utd_mhad", f"a{action}_s{subject}_t{trial}", split),
                *((inertial, skeleton), f"subject {subject}"),
            )
    return dict(sorted(found.items()))


def open_utd(trial: BenchmarkTrial) -> Recording:
    """A trial of UTD-MHAD."""
    return import_utd_mhad(*trial.files)


def smartfallmm_trials(folder: Path) -> list[BenchmarkTrial]:
    """The trials of SmartFallMM that have a skeleton and both sensors of the MetaMotion on the wrist."""
    found = []
    for skeleton in sorted((folder / "skeleton").glob("S*A*T*.csv")):
        sensors = [folder / kind / "meta_wrist" / skeleton.name for kind in ("accelerometer", "gyroscope")]
        subject = re.match(r"S(\d+)A", skeleton.name)
        if subject and all(path.exists() for path in sensors):
            split = _split("smartfallmm", subject[1])
            found.append(BenchmarkTrial("smartfallmm", skeleton.stem, split, (skeleton, *sensors)))
    return found


def open_smartfallmm(trial: BenchmarkTrial) -> Recording:
    """A trial as `unocclude import files` makes it, with what the importer found about its clocks."""
    skeleton, *sensors = trial.files
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        path = Path(folder) / f"{trial.name}.mcap"
        file, _ = import_files([skeleton], [ImuFiles(tuple(sensors), "forearm_right")])
        write_recording(file, path)
        return read_recording(path, side="right")


#: Every data set, by the name of its folder, which is what users call it.
DATASETS: Mapping[str, BenchmarkData] = {
    # the IMU against optical motion capture, whose positions at 30 Hz with 8 mm of noise are the camera
    "broad": BenchmarkData(
        *("BROAD", (0.5, 1.0, 2.0, 3.0), 4, True, broad_trials),
        lambda trial: import_broad(trial.files[0], seed=trial.seed(0)),
        "broad/NN_*.mat",
    ),
    # the others: the wrist against the camera's hidden samples
    "utd_mhad": BenchmarkData(
        *("UTD-MHAD", (0.5, 1.0), 1, False, lambda folder: utd_files(folder).values(), open_utd),
        "utd_mhad/Inertial/aA_sS_tT_inertial.mat and utd_mhad/Skeleton/aA_sS_tT_skeleton.mat",
    ),
    "smartfallmm": BenchmarkData(
        *("SmartFallMM", (0.5, 1.0, 2.0), 2, False, smartfallmm_trials, open_smartfallmm),
        "smartfallmm/skeleton/SnnAnnTnn.csv with accelerometer/meta_wrist and gyroscope/meta_wrist",
    ),
}
