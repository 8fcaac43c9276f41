"""A study from its recordings to its results: by processes of this machine, or a Dask scheduler's workers.

What was done before is not done again. On this machine a process does one recording at a time; one that takes
too long, or dies, stops no other.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import __version__
from ..config import Config
from ..errors import (
    RecordingError,
    UnoccludeError,
    debugging,
    sentence_of,
)
from ..io.recording.choose import Selection
from ..result import is_of_arm
from ..runtime.inputs import check_input
from ..runtime.pool import check_allowance, end_workers, prepare_worker, starting_processes
from .folder import DONE, FAILED, Row, StudyFolder, figures_of_arms, measure_rows, text_hash
from .inputs import Entry, config_hash, file_hash, relative_day, with_sessions, without_places

if TYPE_CHECKING:
    import pyarrow as pa
    from distributed import Client


@dataclass(frozen=True)
class StudySettings:
    """How the recordings of a study are recovered."""

    config: Config = field(default_factory=Config)  # Its number of processes does not matter
    selection: Selection = field(default_factory=Selection)  # What to take of recordings with several of it
    calibration: str = ""  # File for all recordings that have none of their own; "" without one
    again: bool = False  # Compute everything anew
    time_limit_s: float = 0.0  # What one recording may take on this machine; 0 = no limit
    measures: bool = False  # Measure what is recovered: rows contain it
    draws: int = 0  # Motions to draw for the intervals of the measures


@dataclass(frozen=True)
class Job:
    """All that a worker needs to know; plain values, so that it travels between machines."""

    name: str  # Of the recording in the study, with its ending; the output has the same
    source: str  # Path of the recording, absolute
    folder: str  # The study's folder, absolute
    word: str  # The study's word, by which the worker checks that it sees the same folder
    settings: StudySettings  # Of the study
    config_hash: str  # Of what of them counts
    calibration: str = ""  # Path of the calibration file, absolute, or ""
    calibration_hash: str = ""  # SHA-256 of that file, or ""
    version: str = __version__  # Of the program that started the study

    @property
    def hashes(self) -> tuple[str, str, str]:
        """What a result depends on besides the recording."""
        return self.config_hash, self.calibration_hash, self.version

    def row(self, status: str, input_hash: str = "", **more: object) -> Row:
        """A row of the results about this recording."""
        row: Row = {
            "id": text_hash(self.name, input_hash, *self.hashes)[:32],
            "recording": self.name,
            "status": status,
            "input_hash": input_hash,
            "config_hash": self.config_hash,
            "calibration": Path(self.calibration).name,
            "calibration_hash": self.calibration_hash,
            "version": self.version,
            "finished": datetime.now(UTC).replace(tzinfo=None),
            **more,
        }
        # no paths: the name in the study, "." for the study's folder, else the last name
        names = {self.source: self.name, self.folder: ".", str(Path(self.source).parent): ""}
        if self.calibration:
            calibration = Path(self.calibration)
            names = {str(calibration.parent): "", **names, self.calibration: calibration.name}
        for column in ("error", "verdict", "note_texts", "damage"):
            text = row.get(column)
            if isinstance(text, str):
                row[column] = without_places(text, names)
            elif text:
                row[column] = [without_places(each, names) for each in text]
        return row

    def failed(self, sentence: str) -> Row:
        """The row of a recording that failed."""
        return self.row(FAILED, error=sentence)


def run_job(job: Job) -> Row:
    """Recover a recording and put result and row into the study's folder; never raises an error.

    The row of a failure is left to the caller: this machine may not see the folder.
    """
    began = time.perf_counter()
    input_hash, folder = "", StudyFolder(Path(job.folder))
    try:
        _check_machine(job, folder)
        input_hash = file_hash(job.source)
        return _same(job, folder, input_hash) or _recover(job, folder, input_hash, began)
    except Exception as error:
        if debugging():
            raise
        seconds = time.perf_counter() - began
        return job.row(FAILED, input_hash, error=sentence_of(error), seconds=seconds)


def _check_machine(job: Job, folder: StudyFolder) -> None:
    """Refuse work that this machine could not do, or whose result could not be found."""
    host, output = socket.gethostname(), folder.output(job.name)
    if job.version == __version__ and folder.word() == job.word:
        check_input(job.source, RecordingError)
        if os.path.isdir(job.source):
            raise RecordingError(f"{job.source} is a folder; name the recordings in it")
    wrong = {
        f"{host} has unocclude {__version__} and the study was started with {job.version};"
        " install the same version on all machines": job.version != __version__,
        f"{host} does not see the study's folder {folder.path}; share it with all workers under this path": (
            folder.word() != job.word
        ),
        f"{host} does not see {job.source}; share the recordings with all workers under the same path": (
            not os.path.isfile(job.source)
        ),
        f"{host} does not see the calibration {job.calibration}; share it under the same path": (
            job.calibration and not os.path.isfile(job.calibration)
        ),
        f"{output} is the recording itself (a link); give -o another folder": (
            output.exists() and os.path.exists(job.source) and os.path.samefile(output, job.source)
        ),
    }
    for sentence in (sentence for sentence, is_so in wrong.items() if is_so):
        raise UnoccludeError(sentence)


def _same(job: Job, folder: StudyFolder, input_hash: str) -> Row | None:
    """The earlier row of this very content, whose output is as it was written; None without one."""
    row = None if job.settings.again else folder.row(job.name)
    if row is None or row["status"] != DONE or row["id"] != job.row(DONE, input_hash)["id"]:
        return None
    output = folder.output(job.name)
    return row if output.is_file() and file_hash(output) == row["output_hash"] else None


def _recover(job: Job, folder: StudyFolder, input_hash: str, began: float) -> Row:
    from calib.motion import with_given

    from ..io import write_recovery
    from ..io.recording.read import read_arms
    from ..measures import measure
    from ..several_arms import smooth_arms

    if job.calibration and file_hash(job.calibration) != job.calibration_hash:
        raise UnoccludeError(f"{job.calibration} was changed while the study ran; start it again")
    settings, output = job.settings, folder.output(job.name)
    windows = settings.config.windows.model_copy(update={"processes": 1})  # a recording a process
    config = settings.config.model_copy(update={"windows": windows})
    arms = read_arms(job.source, job.calibration or None, truth=False, **settings.selection)
    recordings, calibrations = [arm[0] for arm in arms], [arm[1] for arm in arms]
    results = []
    for recovery in smooth_arms(recordings, calibrations, config, draws=settings.draws):
        recording, calibration = next(arm for arm in arms if is_of_arm(recovery, arm[0]))
        results.append((recording, with_given(recovery, calibration)))
    answers = [recovery for _, recovery in results]
    measured = [measure(recovery) for recovery in answers] if settings.measures else None
    # the result is that of `smooth --draws 0`
    answers = [replace(recovery, draws=None) for recovery in answers]
    output.parent.mkdir(parents=True, exist_ok=True)
    write_recovery(answers, output, source=job.source, force=True)
    row = job.row(
        DONE,
        input_hash,
        input_bytes=os.stat(job.source).st_size,
        output=job.name,
        output_hash=file_hash(output),
        output_bytes=os.stat(output).st_size,
        **figures_of_arms(results),
        measures=None if measured is None else measure_rows(measured),
        recorded_day=relative_day(
            job.word, job.name.rpartition("/")[0].partition("/")[0], answers[0].origin_ns
        ),
        seconds=time.perf_counter() - began,
    )
    folder.write_row(row)
    return row


#: How long a scheduler may take to answer, and how long to wait for its first worker, s.
CONNECT_S, FIRST_WORKER_S = 10.0, 120.0
_TICK_S = 0.5
_LATE = "it took longer than a recording may; give more time (--time-limit), or cut it"
_DIED = (
    "the processes that worked on it died one after the other; perhaps there is not enough memory: use fewer"
    " of them a machine (--processes)"
)

#: What does jobs, by which function, and how many of them it can take.
Workers = tuple[Executor, Callable[[Job], Row | None], Callable[[], int]]
_own = threading.local()
_starting = threading.Lock()
_started: list[ProcessPoolExecutor] = []
_ended = threading.Event()


def _prepare() -> None:
    """Prepare a process of a study: what a library prints is not for the terminal."""
    prepare_worker()
    if not debugging():
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)


def run_apart(job: Job) -> Row | None:
    """Do a job in this thread's own process; None where that died."""
    try:
        with _starting, starting_processes():
            if _ended.is_set():
                return None
            if getattr(_own, "process", None) is None:
                context = multiprocessing.get_context("spawn")
                _own.process = ProcessPoolExecutor(1, context, _prepare)
                _started.append(_own.process)
            future = _own.process.submit(run_job, job)
        return future.result(job.settings.time_limit_s or None)
    except (BrokenProcessPool, TimeoutError) as error:
        end_workers(_own.process)
        _own.process = None
        return job.failed(_LATE) if isinstance(error, TimeoutError) else None


@contextmanager
def local(processes: int = 0) -> Iterator[Workers]:
    """Processes of this machine."""
    check_allowance()
    count = processes or os.cpu_count() or 1
    _ended.clear()
    with ThreadPoolExecutor(count) as threads:
        try:
            yield threads, run_apart, lambda: count
        finally:  # after an error or Ctrl-C in the middle of what they are doing
            threads.shutdown(wait=False, cancel_futures=True)
            with _starting:
                _ended.set()
                for process in _started:
                    end_workers(process)
                _started.clear()


@contextmanager
def cluster(scheduler: str) -> Iterator[Workers]:
    """The workers of a Dask scheduler."""
    client = _connect(scheduler)

    def slots() -> int:
        if client.status == "running":
            with suppress(OSError, TimeoutError):
                return 2 * max(1, sum(client.nthreads().values()))
        raise UnoccludeError(
            f"the scheduler at {scheduler} went away; the same command continues when it is back"
        )

    try:
        yield client.get_executor(pure=False), run_job, slots
    finally:
        client.close(timeout=CONNECT_S)


def _connect(scheduler: str) -> Client:
    from distributed import Client

    if not debugging():  # what matters of Dask's messages is said in our words
        for name in list(logging.root.manager.loggerDict):
            if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UnoccludeError(
            f"no Dask scheduler responds at {scheduler}; start one with `dask scheduler` and give its"
            " address, such as tcp://10.0.0.1:8786"
        ) from error
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError as error:
        client.close(timeout=CONNECT_S)
        raise UnoccludeError(
            f"the scheduler at {scheduler} has no worker; start some with `dask worker {scheduler}`"
        ) from error
    return client


def rows_of(jobs: Iterator[Job], workers: Workers) -> Iterator[Row | None]:
    """The row of each job as it ends, None now and then meanwhile.

    A recording whose process died is tried once more, alone, after the others.
    """
    executor, work, slots = workers
    running: dict[Future[Row | None], Job] = {}
    again: list[Job] = []
    retried: set[str] = set()
    while True:
        while len(running) < slots() and (job := next(jobs, None)) is not None:
            running[executor.submit(work, job)] = job
        if not running:
            if not again:
                return
            job = again.pop(0)
            retried.add(job.name)
            running[executor.submit(work, job)] = job
        done, _ = wait(running, _TICK_S, FIRST_COMPLETED)
        if not done:
            yield None
        for future in done:
            job = running.pop(future)
            row = _row(future, job)
            if row is None and job.name not in retried:
                again.append(job)
            else:
                yield row or job.failed(_DIED)


def _row(future: Future[Any], job: Job) -> Row | None:
    """The row of a job that has ended; None where its process died, or went away."""
    error = None if future.cancelled() else future.exception()
    if future.cancelled() or type(error).__name__ == "KilledWorker":
        return None
    if isinstance(error, ImportError):
        return job.failed(f"a worker lacks a package ({error}); install the same unocclude on all machines")
    if error is not None:
        return job.failed(f"a worker could not do it: {type(error).__name__}: {' '.join(str(error).split())}")
    row: Row | None = future.result()
    return row


@dataclass
class Tally:
    """How far a study is."""

    total: int  # Recordings of the study
    before: int = 0  # Those that an earlier run has done, or tried
    computed: int = 0  # Those that this run has done
    failed: int = 0  # Those that failed in it
    recorded_s: float = 0.0  # Length of the recordings that this run has done, s
    began: float = field(default_factory=time.monotonic)  # s: `time.monotonic` at the start of the run
    notes: list[str] = field(default_factory=list)  # Notes for the user on the study itself

    @property
    def ended(self) -> int:
        """Recordings that need no more work."""
        return self.before + self.computed + self.failed

    @property
    def seconds(self) -> float:
        """Time since the start of the run, s."""
        return time.monotonic() - self.began


def run_study(
    entries: Sequence[Entry],
    folder: StudyFolder,
    settings: StudySettings,
    workers: AbstractContextManager[Workers],
    progress: Callable[[Tally, Row | None], None],
    force: bool = False,
) -> tuple[Tally, pa.Table]:
    """Recover the recordings that are not done yet; how far it came, and the rows of all."""
    calibrations = {
        path: _checked(path)
        for path in {entry.calibration or settings.calibration for entry in entries} - {""}
    }
    word = folder.open(force)
    hashed = config_hash(settings.config, settings.selection)
    if settings.measures:
        hashed = text_hash(hashed, "measures", str(settings.draws))
    tally = Tally(len(entries))
    names = {entry.name for entry in entries}
    with folder.alone():
        if not settings.calibration:
            entries, notes = with_sessions(entries, folder, settings.selection, settings.config, __version__)
            tally.notes += notes
            found = {entry.calibration for entry in entries} - calibrations.keys() - {""}
            calibrations |= {path: _checked(path) for path in found}
        before = {
            row["recording"]: row["finished"]
            for row in folder.rows(("recording", "finished"), tally.notes).to_pylist()
        }
        jobs = (
            Job(
                name=entry.name,
                source=entry.path,
                folder=str(folder.path),
                word=word,
                settings=settings,
                config_hash=hashed,
                calibration=(calibration := entry.calibration or settings.calibration),
                calibration_hash=calibrations.get(calibration, ""),
            )
            for entry in entries
        )
        try:
            with workers as ready:
                for row in rows_of(jobs, ready):
                    if row is not None:
                        _take(row, before.get(row["recording"]), tally, folder)
                    progress(tally, row)
        finally:
            folder.sweep(names)  # of processes that were ended in the middle of an output
        rows = folder.rows()
    return tally, rows.filter(np.array([name in names for name in rows["recording"].to_pylist()], bool))


def _take(row: Row, finished: datetime | None, tally: Tally, folder: StudyFolder) -> None:
    """Count a row, whose recording may have been `finished` before; a failure's is written here."""
    if row["finished"] == finished:
        tally.before += 1
    elif row["status"] == FAILED:
        tally.failed += 1
        folder.write_row(row)
    else:
        tally.computed += 1
        tally.recorded_s += row["duration_s"]


def _checked(path: str) -> str:
    """The hash of a calibration that can be read."""
    from calib.file import read_calibration

    read_calibration(path)
    return file_hash(path)


def study_folder(path: Path) -> StudyFolder:
    """The folder of a study, by its absolute name."""
    return StudyFolder(Path(os.path.abspath(path)))
