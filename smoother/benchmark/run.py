"""Runs the benchmark: every trial, length of gap and method; the same input gives the same digits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import RecordingError, UnoccludeError
from ..evaluation.gap_table import GapTable, pooled, table_of
from ..evaluation.gaps import Collected, GapCopy, hide, row_of, try_methods
from ..evaluation.hidden_gaps import GapErrors, HiddenGap, place_gaps, score_points
from ..evaluation.methods import GRAPH, SharedGraph, make_methods
from ..recording import Recording
from ..runtime.pool import Pool
from .answers import Answers, task_name, write_task
from .datasets import DATASETS, BenchmarkTrial

#: The methods are as they come: their settings by default, on one process.
_CONFIG = {"windows": {"processes": 1}}
#: Frames that the pool counts: a trial is always worth a process.
_MANY_FRAMES = 1_000_000
Progress = Callable[[float, str], None]


class BenchmarkTask(NamedTuple):
    """One copy of one trial, with gaps of one length or of several."""

    trial: BenchmarkTrial
    lengths_s: tuple[float, ...]


@dataclass(frozen=True)
class BenchmarkOptions:
    """What is run.

    Attributes
    ----------
    methods : tuple of str
        Ours, of `evaluation.methods.METHODS`.
    answers : tuple of Answers
        Other methods' answers.
    seed : int
        0 is the published benchmark.
    processes : int
        0 = one per core.
    tasks : Path or None
        Write the tasks to this folder, and answer none.
    """

    methods: tuple[str, ...]
    answers: tuple[Answers, ...] = ()
    seed: int = 0
    processes: int = 0
    tasks: Path | None = None

    @property
    def all_methods(self) -> tuple[str, ...]:
        """Ours, then the others."""
        return (*self.methods, *(each.method for each in self.answers))


@dataclass(frozen=True)
class BenchmarkRun:
    """What came out.

    Attributes
    ----------
    tables : dict of (str, str) to GapTable
        By data set and split.
    trials : dict of (str, str) to int
        How many trials each holds.
    digest : str
        SHA-256 over the files that were read: two runs with the same one saw the same data.
    notes : tuple of str
    """

    tables: dict[tuple[str, str], GapTable]
    trials: dict[tuple[str, str], int]
    digest: str
    notes: tuple[str, ...] = field(default=())


def find_trials(
    folder: Path, datasets: Sequence[str], splits: Sequence[str], most: int | None = None
) -> tuple[list[BenchmarkTrial], list[str]]:
    """The trials that are there, and a sentence on each data set that is not.

    Parameters
    ----------
    folder : Path
        Holds one folder per data set.
    datasets, splits : sequence of str
        What is wanted.
    most : int, optional
        Most trials of a data set's split, spread over them.

    Raises
    ------
    UnoccludeError
        There are none.
    """
    found: list[BenchmarkTrial] = []
    notes = []
    for key in datasets:
        own = list(DATASETS[key].find(folder / key)) if (folder / key).is_dir() else []
        if not own:
            notes.append(f"{DATASETS[key].title} is not there: no {DATASETS[key].layout} in {folder}.")
        for split in splits:
            here = [trial for trial in own if trial.split == split]
            if most is not None and len(here) > most:
                here = [here[int(at)] for at in np.linspace(0, len(here) - 1, most).round()]
            found += here
    if not found:
        raise UnoccludeError(
            f"{folder} has no trial of {', '.join(datasets)}; expected are "
            + "; ".join(DATASETS[key].layout for key in datasets)
        )
    return found, notes


def run_benchmark(
    folder: Path, trials: Sequence[BenchmarkTrial], options: BenchmarkOptions, progress: Progress
) -> BenchmarkRun:
    """Hide, recover and score.

    Parameters
    ----------
    folder : Path
        Of the data sets.
    trials : sequence of BenchmarkTrial
    options : BenchmarkOptions
    progress : callable
        Called with (part done, what is being done).

    Returns
    -------
    run : BenchmarkRun
    """
    tasks = [task for trial in trials for task in _tasks(trial)]
    with Pool(options.processes, _MANY_FRAMES) as pool:
        progress(0.0, "calibrating")
        calibrations = {} if options.tasks else _calibrations(folder, trials, pool)
        job = partial(_collected, options=options, calibrations=calibrations)
        answers = []
        for number, (task, answer) in enumerate(zip(tasks, pool.map(job, tasks), strict=True)):
            progress(number / len(tasks), task.trial.key)
            answers.append(answer)
    progress(1.0, "done")
    tables = {}
    for dataset, split in dict.fromkeys((trial.dataset, trial.split) for trial in trials):
        own = [
            answer
            for task, answer in zip(tasks, answers, strict=True)
            if (task.trial.dataset, task.trial.split) == (dataset, split)
        ]
        # lengths in their order, whichever trial came first
        table = pooled([table_of(each.rows, each.hidden, each.notes) for each in own])
        tables[dataset, split] = GapTable(
            {length: table.lengths[length] for length in sorted(table.lengths)},
            table.rows,
            table.notes,
            table.errors,
        )
    counts = {key: len({row.recording for row in table.rows}) for key, table in tables.items()}
    return BenchmarkRun(tables, counts, _digest(trials))


def _tasks(trial: BenchmarkTrial) -> list[BenchmarkTask]:
    """The copies of a trial."""
    data = DATASETS[trial.dataset]
    if data.together:
        return [BenchmarkTask(trial, data.lengths_s)]
    return [BenchmarkTask(trial, (length_s,)) for length_s in data.lengths_s]


def _calibrations(folder: Path, trials: Sequence[BenchmarkTrial], pool: Pool) -> dict[str, ArmCalibration]:
    """By data set and group, from the recordings that are not scored."""
    wanted = sorted({(trial.dataset, trial.calibrated_on) for trial in trials if trial.calibrated_on})
    groups = []
    for dataset, group in wanted:
        own = DATASETS[dataset].calibrations(folder / dataset).get(group, [])
        if own:
            groups.append((f"{dataset}/{group}", own))
    return {
        name: calibration
        for (name, _), calibration in zip(groups, pool.map(_calibration, groups), strict=True)
        if calibration is not None
    }


def _calibration(group: tuple[str, list[BenchmarkTrial]]) -> ArmCalibration | None:
    from calib.motion.motion_calibration import calibrate_motion

    recordings = [DATASETS[trial.dataset].open(trial) for trial in group[1]]
    try:
        return calibrate_motion(recordings, None, Config.model_validate(_CONFIG)).calibration
    except UnoccludeError:
        return None


def _collected(
    task: BenchmarkTask, options: BenchmarkOptions, calibrations: dict[str, ArmCalibration]
) -> Collected:
    """One task by all methods."""
    trial, data, collected = task.trial, DATASETS[task.trial.dataset], Collected()
    try:
        recording = replace(data.open(trial), name=trial.name)
        gaps = placed_gaps(task, recording, options.seed)
    except UnoccludeError as error:
        collected.notes.append(f"{trial.key} could not be opened: {error}")
        return collected
    missing = [f"{length_s:g}" for length_s in task.lengths_s if length_s not in {each for each, _ in gaps}]
    if missing:
        words = " and ".join(missing)
        collected.notes.append(f"{trial.key} shows no arm for long enough to hide it for {words} s.")
    if not gaps:
        return collected
    if options.tasks is not None:
        write_task(options.tasks, trial, recording, task.lengths_s, gaps)
        return collected
    calibration = calibrations.get(f"{trial.dataset}/{trial.calibrated_on}")
    lengths = {gap: length_s for length_s, gap in gaps}
    copy = GapCopy(task.lengths_s[0], 0, list(lengths))
    methods = make_methods([GRAPH, *options.methods], calibration, Config.model_validate(_CONFIG))
    found = try_methods(copy, recording, methods, one_noise=True)
    wanted = [row.method in options.methods for row in found.rows]
    collected.rows += [row for row, kept in zip(found.rows, wanted, strict=True) if kept]
    collected.hidden += [each for each, kept in zip(found.hidden, wanted, strict=True) if kept]
    collected.notes += [f"{trial.key}: {note}" for note in found.notes]
    graph = methods[GRAPH]
    assert isinstance(graph, SharedGraph)
    for answers in options.answers:
        collected.add(_scored(answers, task, copy, recording, graph))
    collected.rows = [replace(row, length_s=lengths[row.gap]) for row in collected.rows]
    return collected


def placed_gaps(task: BenchmarkTask, recording: Recording, seed: int) -> list[tuple[float, HiddenGap]]:
    """The gaps of a copy with their lengths, s, in order of time.

    The longest are placed first, each length by a generator of its own.
    """
    placed: list[tuple[float, HiddenGap]] = []
    for length_s in sorted(task.lengths_s, reverse=True):
        rng = np.random.default_rng([task.trial.seed(seed), round(1000 * length_s)])
        seen = replace(hide(recording, [gap for _, gap in placed]), truth=recording.truth)
        gaps = place_gaps(seen, length_s, rng, count=DATASETS[task.trial.dataset].gaps)
        placed += [(length_s, gap) for gap in gaps]
    return sorted(placed, key=lambda each: each[1].start_s)


def _scored(
    answers: Answers, task: BenchmarkTask, copy: GapCopy, recording: Recording, graph: SharedGraph
) -> Collected:
    """What another method answered to a task."""
    collected = Collected()
    read = answers.read(task_name(*task))
    try:
        noise_of = graph.last()
    except UnoccludeError:
        noise_of = None
    for gap in copy.gaps:
        errors, failure = GapErrors.empty(), "no answer to this task"
        if read is not None:
            errors = score_points(recording, *read, gap, noise_of)
            failure = "" if np.isfinite(errors.distance_m).any() else "no answer inside the gap"
        collected.rows.append(row_of(copy, answers.method, gap, errors, failure, recording.name))
        collected.hidden.append(errors)
    return collected


def _digest(trials: Sequence[BenchmarkTrial]) -> str:
    """SHA-256 over names and contents of the files of the trials."""
    total = hashlib.sha256()
    for trial in trials:
        total.update(trial.key.encode())
        for path in trial.files:
            try:
                total.update(hashlib.sha256(path.read_bytes()).digest())
            except OSError as error:
                raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    return total.hexdigest()
