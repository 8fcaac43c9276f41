"""The public data sets, a loader each; whoever runs the benchmark brings the files.

The `development` split is what this project was developed on; the rest has not been looked at.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..recording import Recording

#: Of the tasks: it changes when a split, a gap or a way to score does.
VERSION = 1
#: What the authors of a method worked with, and what none of them should look at before they publish.
SPLITS = ("development", "test")


@dataclass(frozen=True)
class BenchmarkTrial:
    """A recording in which gaps are hidden."""

    dataset: str  # Key of its data set
    name: str  # As its files are called, without the ending
    split: str  # One of `SPLITS`
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

    key: str  # Its folder, and what users call it
    title: str
    lengths_s: tuple[float, ...]  # Of the gaps
    gaps: int  # Most gaps of a length in a trial
    together: bool  # Gaps of all lengths are in one copy of a trial, as long recordings allow
    # From the data set's folder to its trials that are there, in a fixed order
    find: Callable[[Path], Iterator[BenchmarkTrial]]
    open: Callable[[BenchmarkTrial], Recording]  # From a trial to its recording; raises `UnoccludeError`
    layout: str  # Which files are looked for, for messages
    # From the folder to the files of each group that calibrates, by the group's name
    calibrations: Callable[[Path], dict[str, list[BenchmarkTrial]]] = lambda folder: {}


#: The development split: BROAD's trials by number, UTD-MHAD's and SmartFallMM's subjects.
_DEVELOPMENT = {"broad": {3, 5, 7, 11, 14, 16, 24, 33}, "utd_mhad": {1, 2, 3, 4}, "smartfallmm": {43, 44}}


def _split(dataset: str, number: str) -> str:
    return "development" if int(number) in _DEVELOPMENT[dataset] else "test"


# --- BROAD


def broad_trials(folder: Path) -> Iterator[BenchmarkTrial]:
    """The trials of BROAD, in order of their numbers."""
    for path in sorted(folder.rglob("*.mat")):
        number = re.match(r"(\d+)_", path.name)
        if number:
            yield BenchmarkTrial("broad", path.stem, _split("broad", number[1]), (path,))


def _open_broad(trial: BenchmarkTrial) -> Recording:
    from ..io import import_broad

    return import_broad(trial.files[0], seed=trial.seed(0))


# --- UTD-MHAD: trial 1 of each action calibrates the subject's arm, the others are scored


def utd_files(folder: Path) -> dict[tuple[int, int, int], BenchmarkTrial]:
    """The trials of the actions with the IMU on the wrist (1 to 21), by subject, action and trial."""
    found = {}
    for inertial in folder.rglob("a*_s*_t*_inertial.mat"):
        numbers = re.fullmatch(r"a(\d+)_s(\d+)_t(\d+)_inertial\.mat", inertial.name)
        if not numbers or int(numbers[1]) > 21:
            continue
        action, subject, trial = (int(each) for each in numbers.groups())
        name = f"a{action}_s{subject}_t{trial}"
        places = (inertial.parent, inertial.parent.parent / "Skeleton")
        skeleton = next((at for place in places if (at := place / f"{name}_skeleton.mat").exists()), None)
        if skeleton is not None:
            found[subject, action, trial] = BenchmarkTrial(
                *("utd_mhad", name, _split("utd_mhad", numbers[2])),
                *((inertial, skeleton), f"subject {subject}"),
            )
    return dict(sorted(found.items()))


def utd_trials(folder: Path) -> Iterator[BenchmarkTrial]:
    """The trials of UTD-MHAD that are scored."""
    yield from (trial for (_, _, number), trial in utd_files(folder).items() if number != 1)


def utd_calibrations(folder: Path) -> dict[str, list[BenchmarkTrial]]:
    """The trials that calibrate, by subject."""
    groups: dict[str, list[BenchmarkTrial]] = {}
    for (_, _, number), trial in utd_files(folder).items():
        if number == 1:
            groups.setdefault(trial.calibrated_on, []).append(trial)
    return groups


def open_utd(trial: BenchmarkTrial) -> Recording:
    """A trial of UTD-MHAD."""
    from ..io import import_utd_mhad

    return import_utd_mhad(*trial.files)


# --- SmartFallMM: the MetaMotion on the right wrist


def smartfallmm_trials(folder: Path) -> Iterator[BenchmarkTrial]:
    """The trials that have a skeleton and both sensors of the MetaMotion."""
    for skeleton in sorted((folder / "skeleton").glob("S*A*T*.csv")):
        sensors = [folder / kind / "meta_wrist" / skeleton.name for kind in ("accelerometer", "gyroscope")]
        subject = re.match(r"S(\d+)A", skeleton.name)
        if subject and all(path.exists() for path in sensors):
            split = _split("smartfallmm", subject[1])
            yield BenchmarkTrial("smartfallmm", skeleton.stem, split, (skeleton, *sensors))


def open_smartfallmm(trial: BenchmarkTrial) -> Recording:
    """A trial as `unocclude import files` makes it, with what the importer found about its clocks."""
    return imported(trial.name, trial.files[0], trial.files[1:])


def imported(name: str, skeleton: Path, sensors: tuple[Path, ...]) -> Recording:
    """The recording of files as devices write them."""
    from ..io import read_recording, write_recording
    from ..io.files import ImuFiles, import_files

    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        path = Path(folder) / f"{name}.mcap"
        file, _ = import_files([skeleton], [ImuFiles(sensors, "forearm_right")])
        write_recording(file, path)
        return read_recording(path, side="right")


#: Every data set, by the name of its folder.
DATASETS: Mapping[str, BenchmarkData] = {
    data.key: data
    for data in (
        # the IMU against optical motion capture, whose positions at 30 Hz with 8 mm of noise are the camera
        BenchmarkData(
            *("broad", "BROAD", (0.5, 1.0, 2.0, 3.0), 4, True, broad_trials, _open_broad), "broad/NN_*.mat"
        ),
        # the others: the wrist against the camera's hidden samples
        BenchmarkData(
            *("utd_mhad", "UTD-MHAD", (0.5, 1.0), 1, False, utd_trials, open_utd),
            "utd_mhad/Inertial/aA_sS_tT_inertial.mat and utd_mhad/Skeleton/aA_sS_tT_skeleton.mat",
            utd_calibrations,
        ),
        BenchmarkData(
            *("smartfallmm", "SmartFallMM", (0.5, 1.0, 2.0), 2, False, smartfallmm_trials, open_smartfallmm),
            "smartfallmm/skeleton/SnnAnnTnn.csv with accelerometer/meta_wrist and gyroscope/meta_wrist",
        ),
    )
}
