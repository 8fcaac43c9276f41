"""The public benchmark: every trial, length of gap and method; the same input gives the same digits."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..errors import RecordingError, UnoccludeError
from ..recording import Recording
from ..runtime.pool import Pool
from ..table import Table, cell_text, centimetres, percent
from .datasets import DATASETS, VERSION, BenchmarkTrial
from .gap_table import GapRow, GapTable, pooled, spread_by_length
from .gaps import GapCopy, hide, try_methods
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
    digest: str  # SHA-256 over the files that were read: two runs with the same one saw the same data


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
    tasks = [
        BenchmarkTask(trial, lengths_s)
        for trial in trials
        for data in [DATASETS[trial.dataset]]
        for lengths_s in ([data.lengths_s] if data.together else [(each,) for each in data.lengths_s])
    ]
    answers: dict[tuple[str, str], list[GapTable]] = {}
    with Pool(processes, _MANY_FRAMES) as pool:
        progress(0.0, "calibrating")
        calibrations = _calibrations(folder, trials, pool)
        job = partial(_tried, methods=tuple(methods), seed=seed, calibrations=calibrations)
        for number, (task, answer) in enumerate(zip(tasks, pool.map(job, tasks), strict=True)):
            progress(number / len(tasks), task.trial.key)
            answers.setdefault((task.trial.dataset, task.trial.split), []).append(answer)
    progress(1.0, "done")
    return BenchmarkRun({key: pooled(tables) for key, tables in answers.items()}, _digest(trials))


def _calibrations(folder: Path, trials: Sequence[BenchmarkTrial], pool: Pool) -> dict[str, ArmCalibration]:
    """By data set and group, from the recordings that are not scored."""
    wanted = sorted({(trial.dataset, trial.calibrated_on) for trial in trials if trial.calibrated_on})
    groups = {
        f"{dataset}/{group}": own
        for dataset, group in wanted
        if (own := DATASETS[dataset].calibrations(folder / dataset).get(group))
    }
    made = zip(groups, pool.map(_calibration, groups.values()), strict=True)
    return {name: calibration for name, calibration in made if calibration is not None}


def _calibration(group: list[BenchmarkTrial]) -> ArmCalibration | None:
    from calib.motion import calibrate_motion

    recordings = [DATASETS[trial.dataset].open(trial) for trial in group]
    try:
        return calibrate_motion(recordings, None, Config.model_validate(_CONFIG)).calibration
    except UnoccludeError:
        return None


def _tried(
    task: BenchmarkTask, methods: tuple[str, ...], seed: int, calibrations: dict[str, ArmCalibration]
) -> GapTable:
    """One task by all methods."""
    trial = task.trial
    try:
        recording = replace(DATASETS[trial.dataset].open(trial), name=trial.name)
        gaps = placed_gaps(task, recording, seed)
    except UnoccludeError as error:
        return GapTable((), (f"{trial.key} could not be opened: {error}",))
    lengths = {gap: length_s for length_s, gap in gaps}
    missing = [f"{length_s:g}" for length_s in task.lengths_s if length_s not in lengths.values()]
    notes = []
    if missing:
        words = " and ".join(missing)
        notes.append(f"{trial.key} shows no arm for long enough to hide it for {words} s.")
    if not gaps:
        return GapTable((), tuple(notes))
    calibration = calibrations.get(f"{trial.dataset}/{trial.calibrated_on}")
    made = make_methods([GRAPH, *methods], calibration, Config.model_validate(_CONFIG))
    found = try_methods(GapCopy(task.lengths_s[0], 0, list(lengths)), recording, made, one_noise=True)
    notes += [f"{trial.key}: {note}" for note in found.notes]
    rows = [replace(row, length_s=lengths[row.gap]) for row in found.rows if row.method in methods]
    return GapTable(tuple(rows), tuple(notes))


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


def _method(name: str, rows: Sequence[GapRow]) -> dict[str, Any]:
    """A method over one data set and split: by length median over the gaps, rms over the samples."""
    lengths = GapTable(tuple(rows)).lengths
    rms = {length: lengths[length][name].figures.position_rms_m for length in sorted(lengths)}
    return {
        "method": name,
        "median_m": {f"{length:g}": by[name].median_m for length, by in spread_by_length(rows).items()},
        "rms_m": {f"{length:g}": value for length, value in rms.items()},
        "inside_95": GapErrors.pooled([row.errors for row in rows]).figures().coverage_95,
        "gaps": len(rows),
        "failed": sum(bool(row.failure) for row in rows),
    }


def plain(run: BenchmarkRun, seed: int, version: str) -> dict[str, Any]:
    """Plain values by name, as `benchmark.json` holds them; nothing in it changes from run to run."""
    datasets = []
    for (dataset, split), table in run.tables.items():
        names = dict.fromkeys(row.method for row in table.rows)
        methods = [_method(name, [row for row in table.rows if row.method == name]) for name in names]
        lengths = [
            {
                "length_s": length,
                "methods": {
                    name: {key: value for key, value in each.to_dict().items() if not key.endswith("_cm")}
                    for name, each in by.items()
                },
            }
            for length, by in sorted(table.lengths.items())
        ]
        counted = len({row.recording for row in table.rows})
        about = {"dataset": dataset, "split": split, "trials": counted, "lengths": lengths}
        datasets.append(about | {"methods": sorted(methods, key=_rank)})
    head = {"benchmark": VERSION, "version": version, "seed": seed, "data_sha256": run.digest}
    return head | {"datasets": datasets, "notes": all_notes(run)}


def _rank(row: dict[str, Any]) -> tuple[int, float]:
    """Methods by the sum of their medians, those without an answer last."""
    known = [value for value in row["median_m"].values() if value is not None]
    return len(row["median_m"]) - len(known), sum(known)


def all_notes(run: BenchmarkRun) -> list[str]:
    """What a reader must know, one sentence each, none twice."""
    return list(dict.fromkeys(note for table in run.tables.values() for note in table.notes))


def summary(run: BenchmarkRun, dataset: str, split: str) -> Table:
    """The table of a data set: by method median / rms in cm by length, the share inside, the gaps."""
    only = BenchmarkRun({(dataset, split): run.tables[dataset, split]}, "")
    (figures,) = plain(only, 0, "")["datasets"]
    lengths = [f"{each['length_s']:g}" for each in figures["lengths"]]
    rows = [
        (
            row["method"],
            *(
                " / ".join(cell_text(centimetres(row[what].get(length))) for what in ("median_m", "rms_m"))
                for length in lengths
            ),
            percent(row["inside_95"]),
            f"{row['gaps']} ({row['failed']} failed)" if row["failed"] else f"{row['gaps']}",
        )
        for row in figures["methods"]
    ]
    trials = figures["trials"]
    title = f"{DATASETS[dataset].title}, {split}: {trials} trial{'' if trials == 1 else 's'}"
    return Table(title, ("method", *(f"{length} s" for length in lengths), "inside 95 %", "gaps"), rows)


def markdown(run: BenchmarkRun) -> str:
    """The tables in Markdown."""
    tables = [summary(run, *key) for key in run.tables]
    return "\n".join(f"### {each.title}\n\n{each.markdown()}" for each in tables)


def gap_rows(run: BenchmarkRun) -> Iterable[Sequence[str]]:
    """One row per gap, as in `gaps.csv`; the header first."""
    yield CSV_COLUMNS
    for (dataset, split), table in run.tables.items():
        for row in table.rows:
            numbers = (row.figures.position_rms_m, row.figures.position_max_m, row.errors.sigma_max_m)
            cells = [dataset, split, row.recording, f"{row.length_s:g}", row.method]
            cells += [repr(float(row.gap.start_s)), repr(float(row.gap.end_s)), str(row.figures.samples)]
            cells += ["" if value is None else repr(float(value)) for value in numbers]
            yield [*cells, row.failure or ""]
