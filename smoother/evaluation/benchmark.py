"""The public benchmark: every trial, length of gap and method; the same input gives the same digits.

Whoever runs it brings the files of the data sets. The `development` split is what this project was developed
on; the rest has not been looked at.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import RecordingError, UnoccludeError
from ..io import import_broad, import_utd_mhad, read_recording, write_recording
from ..io.files import ImuFiles, import_files
from ..recording import Recording
from ..runtime.pool import Pool
from ..table import Table, cell_text, centimetres, tabulated
from .gaps import (
    GapCopy,
    GapGroup,
    GapTable,
    HiddenGap,
    by_length,
    counted,
    hide,
    place_gaps,
    pooled,
    try_methods,
)
from .methods import GRAPH, make_methods

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

    @property
    def seed(self) -> int:
        """Of its gaps: by its name, so that no other trial moves them."""
        return int.from_bytes(hashlib.sha256(f"{VERSION}/0/{self.key}".encode()).digest()[:4], "big")


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
        lambda trial: import_broad(trial.files[0], seed=trial.seed),
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


#: The methods are as they come: their settings by default, on one process.
_CONFIG = {"windows": {"processes": 1}}
#: Frames that the pool counts: a trial is always worth a process.
_MANY_FRAMES = 1_000_000
#: What `gaps.csv` has of each gap.
_OF_GAP = ("length_s", "method", "start_s", "end_s", "samples", "rms_m", "max_m", "sigma_max_m", "failure")
#: The gaps by data set and split.
Tables = Mapping[tuple[str, str], GapTable]
#: One copy of one trial, with gaps of one length or of several, s.
_Task = tuple[BenchmarkTrial, tuple[float, ...]]


def find_trials(folder: Path, splits: Sequence[str]) -> tuple[list[BenchmarkTrial], list[str]]:
    """The trials that are there, and a sentence on each data set that is not."""
    found: list[BenchmarkTrial] = []
    notes = []
    for key, data in DATASETS.items():
        own = list(data.find(folder / key)) if (folder / key).is_dir() else []
        if not own:
            notes.append(f"{data.title} is not there: no {data.layout} in {folder}.")
        found += [trial for split in splits for trial in own if trial.split == split]
    if not found:
        layouts = "; ".join(data.layout for data in DATASETS.values())
        raise UnoccludeError(f"{folder} has no trial of {' or '.join(splits)}; expected are {layouts}")
    return found, notes


def run_benchmark(
    folder: Path,
    trials: Sequence[BenchmarkTrial],
    methods: Sequence[str],
    progress: Callable[[float, str], None],
    processes: int = 0,
) -> Tables:
    """Hide, recover and score; 0 processes are one per core."""
    tasks = [
        (trial, lengths_s)
        for trial in trials
        for data in [DATASETS[trial.dataset]]
        for lengths_s in ([data.lengths_s] if data.together else [(each,) for each in data.lengths_s])
    ]
    answers: dict[tuple[str, str], list[GapTable]] = {}
    groups: dict[tuple[str, str], list[BenchmarkTrial]] = {}
    scored = {(trial.dataset, trial.calibrated_on) for trial in trials}
    for key in {trial.dataset for trial in trials}:
        for trial in DATASETS[key].find(folder / key):
            if trial.split == CALIBRATION and (group := (key, trial.calibrated_on)) in scored:
                groups.setdefault(group, []).append(trial)
    with Pool(processes, _MANY_FRAMES) as pool:
        progress(0.0, "calibrating")
        made = zip(groups, pool.map(_calibration, groups.values()), strict=True)
        job = partial(_tried, methods=tuple(methods), calibrations=dict(made))
        for number, ((trial, _), answer) in enumerate(zip(tasks, pool.map(job, tasks), strict=True)):
            progress(number / len(tasks), trial.key)
            answers.setdefault((trial.dataset, trial.split), []).append(answer)
    progress(1.0, "done")
    return {key: pooled(tables) for key, tables in answers.items()}


def _calibration(group: list[BenchmarkTrial]) -> ArmCalibration | None:
    from calib.motion import calibrate_motion

    recordings = [DATASETS[trial.dataset].open(trial) for trial in group]
    try:
        return calibrate_motion(recordings, None, Config.model_validate(_CONFIG)).calibration
    except UnoccludeError:
        return None


def _tried(
    task: _Task,
    methods: tuple[str, ...],
    calibrations: Mapping[tuple[str, str], ArmCalibration | None],
) -> GapTable:
    """One task by all methods."""
    trial, lengths_s = task
    try:
        recording = replace(DATASETS[trial.dataset].open(trial), name=trial.name)
        gaps = placed_gaps(trial, lengths_s, recording)
    except UnoccludeError as error:
        return GapTable((), (f"{trial.key} could not be opened: {error}",))
    lengths = {gap: length_s for length_s, gap in gaps}
    notes = []
    if missing := [f"{length_s:g}" for length_s in lengths_s if length_s not in lengths.values()]:
        notes = [f"{trial.key} shows no arm for long enough to hide it for {' and '.join(missing)} s."]
    if not gaps:
        return GapTable((), tuple(notes))
    calibration = calibrations.get((trial.dataset, trial.calibrated_on))
    made = make_methods([GRAPH, *methods], calibration, Config.model_validate(_CONFIG))
    found = try_methods(GapCopy(lengths_s[0], 0, list(lengths)), recording, made, one_noise=True)
    rows = [replace(row, length_s=lengths[row.gap]) for row in found.rows if row.method in methods]
    return GapTable(tuple(rows), (*notes, *(f"{trial.key}: {note}" for note in found.notes)))


def placed_gaps(
    trial: BenchmarkTrial, lengths_s: Sequence[float], recording: Recording
) -> list[tuple[float, HiddenGap]]:
    """The gaps of a copy with their lengths, s, in order of time."""
    placed: list[tuple[float, HiddenGap]] = []
    for length_s in sorted(lengths_s, reverse=True):
        rng = np.random.default_rng([trial.seed, round(1000 * length_s)])
        seen = replace(hide(recording, [gap for _, gap in placed]), truth=recording.truth)
        gaps = place_gaps(seen, length_s, rng, count=DATASETS[trial.dataset].gaps)
        placed += [(length_s, gap) for gap in gaps]
    return sorted(placed, key=lambda each: each[1].start_s)


def digest(trials: Sequence[BenchmarkTrial]) -> str:
    """SHA-256 over names and contents of the files of the trials: two runs with the same one saw the same."""
    total = hashlib.sha256()
    for trial in trials:
        total.update(trial.key.encode())
        for path in trial.files:
            try:
                total.update(hashlib.sha256(path.read_bytes()).digest())
            except OSError as error:
                raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    return total.hexdigest()


def plain(tables: Tables, version: str, data: str) -> dict[str, Any]:
    """Plain values by name, as `benchmark.json` holds them; nothing in it changes from run to run."""

    def rank(row: dict[str, Any]) -> tuple[int, float]:
        """Methods by the sum of their medians, those without an answer last."""
        known = [value for value in row["median_m"].values() if value is not None]
        return len(row["median_m"]) - len(known), sum(known)

    datasets: list[dict[str, Any]] = []
    for (dataset, split), table in tables.items():
        lengths = dict(sorted(table.lengths.items()))
        rows = []
        for name in dict.fromkeys(row.method for row in table.rows):
            groups = {f"{length:g}": methods[name] for length, methods in lengths.items()}
            whole = GapGroup([row for group in groups.values() for row in group.rows])
            each: dict[str, Any] = {"method": name}
            each |= {"median_m": {length: group.spread["median_m"] for length, group in groups.items()}}
            each |= {"rms_m": {length: group.figures.position_rms_m for length, group in groups.items()}}
            rows.append(each | {"inside_95": whole.figures.coverage_95} | whole.counts)
        about: dict[str, Any] = {
            "dataset": dataset,
            "split": split,
            "trials": len({row.recording for row in table.rows}),
        }
        about |= {"lengths": by_length(lengths, GapGroup.to_dict), "methods": sorted(rows, key=rank)}
        datasets.append(about)
    notes = list(dict.fromkeys(note for table in tables.values() for note in table.notes))
    head = {"benchmark": VERSION, "version": version, "data_sha256": data}
    return head | {"datasets": datasets, "notes": notes}


def summary(figures: Mapping[str, Any]) -> Table:
    """The table of a data set of `plain`: by method median / rms in cm by length, share inside, gaps."""

    def errors(length: str) -> Callable[[Mapping[str, Any]], object]:
        return lambda row: " / ".join(cell_text(centimetres(row[of][length])) for of in ("median_m", "rms_m"))

    lengths = [f"{each['length_s']:g}" for each in figures["lengths"]]
    trials, title = figures["trials"], DATASETS[figures["dataset"]].title
    return tabulated(
        f"{title}, {figures['split']}: {trials} trial{'' if trials == 1 else 's'}",
        figures["methods"],
        {
            "method": "method",
            **{f"{length} s": errors(length) for length in lengths},
            "inside 95 %": "inside_95",
            "gaps": counted,
        },
    )


def gap_rows(tables: Tables) -> Iterator[Sequence[object]]:
    """One row per gap, as in `gaps.csv`; the header first."""
    yield "dataset", "split", "trial", *_OF_GAP
    for (dataset, split), table in tables.items():
        for row in table.rows:
            figures = row.to_dict() | {"length_s": f"{row.length_s:g}"}
            yield dataset, split, row.recording, *(figures[name] for name in _OF_GAP)
