"""The public benchmark: every trial, length of gap and method; the same input gives the same digits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import RecordingError, UnoccludeError
from ..recording import Recording
from ..runtime.pool import Pool
from ..table import Table, cell_text, centimetres, percent
from .datasets import DATASETS, VERSION, BenchmarkTrial
from .gap_table import GapFigures, GapTable, pooled, spread_by_length, table_of
from .gaps import Collected, GapCopy, hide, try_methods
from .hidden_gaps import GapErrors, HiddenGap, place_gaps
from .methods import GRAPH, make_methods

#: The methods are as they come: their settings by default, on one process.
_CONFIG = {"windows": {"processes": 1}}
#: Frames that the pool counts: a trial is always worth a process.
_MANY_FRAMES = 1_000_000
Progress = Callable[[float, str], None]
CSV_COLUMNS = (
    *("dataset", "split", "trial", "length_s", "method", "start_s", "end_s", "samples", "rms_m", "max_m"),
    *("sigma_max_m", "failure"),
)


class BenchmarkTask(NamedTuple):
    """One copy of one trial, with gaps of one length or of several."""

    trial: BenchmarkTrial
    lengths_s: tuple[float, ...]


@dataclass(frozen=True)
class BenchmarkRun:
    """What came out."""

    tables: dict[tuple[str, str], GapTable]  # By data set and split
    trials: dict[tuple[str, str], int]  # How many trials each holds
    digest: str  # SHA-256 over the files that were read: two runs with the same one saw the same data
    notes: tuple[str, ...] = field(default=())


def find_trials(
    folder: Path, datasets: Sequence[str], splits: Sequence[str], most: int | None = None
) -> tuple[list[BenchmarkTrial], list[str]]:
    """The trials that are there, and a sentence on each data set that is not."""
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
    folder: Path,
    trials: Sequence[BenchmarkTrial],
    methods: Sequence[str],
    progress: Progress,
    seed: int = 0,
    processes: int = 0,
) -> BenchmarkRun:
    """Hide, recover and score; seed 0 is the published benchmark, 0 processes are one per core."""
    tasks = [task for trial in trials for task in _tasks(trial)]
    with Pool(processes, _MANY_FRAMES) as pool:
        progress(0.0, "calibrating")
        calibrations = _calibrations(folder, trials, pool)
        job = partial(_collected, methods=tuple(methods), seed=seed, calibrations=calibrations)
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
    from calib.motion import calibrate_motion

    recordings = [DATASETS[trial.dataset].open(trial) for trial in group[1]]
    try:
        return calibrate_motion(recordings, None, Config.model_validate(_CONFIG)).calibration
    except UnoccludeError:
        return None


def _collected(
    task: BenchmarkTask, methods: tuple[str, ...], seed: int, calibrations: dict[str, ArmCalibration]
) -> Collected:
    """One task by all methods."""
    trial, data, collected = task.trial, DATASETS[task.trial.dataset], Collected()
    try:
        recording = replace(data.open(trial), name=trial.name)
        gaps = placed_gaps(task, recording, seed)
    except UnoccludeError as error:
        collected.notes.append(f"{trial.key} could not be opened: {error}")
        return collected
    missing = [f"{length_s:g}" for length_s in task.lengths_s if length_s not in {each for each, _ in gaps}]
    if missing:
        words = " and ".join(missing)
        collected.notes.append(f"{trial.key} shows no arm for long enough to hide it for {words} s.")
    if not gaps:
        return collected
    calibration = calibrations.get(f"{trial.dataset}/{trial.calibrated_on}")
    lengths = {gap: length_s for length_s, gap in gaps}
    copy = GapCopy(task.lengths_s[0], 0, list(lengths))
    made = make_methods([GRAPH, *methods], calibration, Config.model_validate(_CONFIG))
    found = try_methods(copy, recording, made, one_noise=True)
    wanted = [row.method in methods for row in found.rows]
    collected.rows += [row for row, kept in zip(found.rows, wanted, strict=True) if kept]
    collected.hidden += [each for each, kept in zip(found.hidden, wanted, strict=True) if kept]
    collected.notes += [f"{trial.key}: {note}" for note in found.notes]
    collected.rows = [replace(row, length_s=lengths[row.gap]) for row in collected.rows]
    return collected


def placed_gaps(task: BenchmarkTask, recording: Recording, seed: int) -> list[tuple[float, HiddenGap]]:
    """The gaps of a copy with their lengths, s, in order of time."""
    placed: list[tuple[float, HiddenGap]] = []
    for length_s in sorted(task.lengths_s, reverse=True):
        rng = np.random.default_rng([task.trial.seed(seed), round(1000 * length_s)])
        seen = replace(hide(recording, [gap for _, gap in placed]), truth=recording.truth)
        gaps = place_gaps(seen, length_s, rng, count=DATASETS[task.trial.dataset].gaps)
        placed += [(length_s, gap) for gap in gaps]
    return sorted(placed, key=lambda each: each[1].start_s)


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


@dataclass(frozen=True)
class MethodRow:
    """A method over one data set and split."""

    method: str
    median_m: dict[float, float | None]  # By length: the median over the gaps of their rms
    rms_m: dict[float, float | None]  # By length: over all samples
    inside_95: float | None  # Share of all samples inside the stated 95 % region, over all lengths
    gaps: int  # That were tried, and those of them without an answer
    failed: int  # That were tried, and those of them without an answer


def method_rows(table: GapTable) -> list[MethodRow]:
    """The methods of a data set, by the sum of their medians, those without an answer last."""
    spreads = spread_by_length(table.rows)
    methods = dict.fromkeys(row.method for row in table.rows)
    rows = []
    for name in methods:
        median = {length: by[name].median_m for length, by in spreads.items() if name in by}
        rms = {length: by[name].figures.position_rms_m for length, by in table.lengths.items() if name in by}
        own = [errors for row, errors in zip(table.rows, table.errors, strict=True) if row.method == name]
        together = GapErrors.pooled(own).figures()
        failed = sum(bool(row.failure) for row in table.rows if row.method == name)
        rows.append(MethodRow(name, median, rms, together.coverage_95, len(own), failed))
    return sorted(rows, key=_rank)


def _rank(row: MethodRow) -> tuple[int, float]:
    known = [value for value in row.median_m.values() if value is not None]
    return len(row.median_m) - len(known), sum(known)


def plain(run: BenchmarkRun, seed: int, version: str) -> dict[str, object]:
    """Plain values by name, as `benchmark.json` holds them; nothing in it changes from run to run."""
    return {
        "benchmark": VERSION,
        "version": version,
        "seed": seed,
        "data_sha256": run.digest,
        "datasets": [
            {
                "dataset": dataset,
                "split": split,
                "trials": run.trials[dataset, split],
                "lengths": [
                    {"length_s": length, "methods": {name: _figures(each) for name, each in by.items()}}
                    for length, by in table.lengths.items()
                ],
                "methods": [
                    {
                        "method": row.method,
                        "median_m": {f"{length:g}": value for length, value in row.median_m.items()},
                        "rms_m": {f"{length:g}": value for length, value in row.rms_m.items()},
                        "inside_95": row.inside_95,
                        "gaps": row.gaps,
                        "failed": row.failed,
                    }
                    for row in method_rows(table)
                ],
            }
            for (dataset, split), table in run.tables.items()
        ],
        "notes": list(all_notes(run)),
    }


def _figures(figures: GapFigures) -> dict[str, object]:
    return {name: value for name, value in figures.to_dict().items() if not name.endswith("_cm")}


def all_notes(run: BenchmarkRun) -> Sequence[str]:
    """What a reader must know, one sentence each, none twice."""
    return list(dict.fromkeys([*run.notes, *(note for table in run.tables.values() for note in table.notes)]))


def summary(run: BenchmarkRun, dataset: str, split: str) -> Table:
    """The table of a data set: by method median / rms in cm by length, the share inside, the gaps."""
    table, trials = run.tables[dataset, split], run.trials[dataset, split]
    rows = [
        (
            row.method,
            *(
                f"{cell_text(centimetres(row.median_m.get(length)))}"
                f" / {cell_text(centimetres(row.rms_m.get(length)))}"
                for length in table.lengths
            ),
            percent(row.inside_95),
            f"{row.gaps} ({row.failed} failed)" if row.failed else f"{row.gaps}",
        )
        for row in method_rows(table)
    ]
    title = f"{DATASETS[dataset].title}, {split}: {trials} trial{'' if trials == 1 else 's'}"
    columns = ("method", *(f"{length:g} s" for length in table.lengths), "inside 95 %", "gaps")
    return Table(title, columns, rows)


def markdown(run: BenchmarkRun) -> str:
    """The tables in Markdown."""
    tables = [summary(run, *key) for key in run.tables]
    return "\n".join(f"### {each.title}\n\n{each.markdown()}" for each in tables)


def gap_rows(run: BenchmarkRun) -> Iterable[Sequence[str]]:
    """One row per gap, as in `gaps.csv`; the header first."""
    yield CSV_COLUMNS
    for (dataset, split), table in run.tables.items():
        for row in table.rows:
            numbers = (row.figures.position_rms_m, row.figures.position_max_m, row.sigma_max_m)
            cells = [dataset, split, row.recording, f"{row.length_s:g}", row.method]
            cells += [repr(float(row.gap.start_s)), repr(float(row.gap.end_s)), str(row.figures.samples)]
            cells += ["" if value is None else repr(float(value)) for value in numbers]
            yield [*cells, row.failure or ""]
