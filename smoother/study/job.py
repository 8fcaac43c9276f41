"""One recording of a study, file to file: what a worker does."""

from __future__ import annotations

import os
import socket
import time
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from .. import __version__
from ..config import Config
from ..errors import (
    CalibrationError,
    RecordingError,
    SolveError,
    UnoccludeError,
    debugging,
    is_out_of_memory,
    sentence_of,
)
from ..io.recording.choose import Selection
from ..result import is_of_arm
from ..runtime.inputs import check_input
from .folder import DONE, FAILED, Row, StudyFolder, figures_of_arms, measure_rows, text_hash
from .inputs import file_hash, relative_day, without_places


@dataclass(frozen=True)
class StudySettings:
    """How the recordings of a study are recovered."""

    config: Config = field(default_factory=Config)  # Its number of processes does not matter
    selection: Selection = field(default_factory=Selection)  # What to take of recordings with several of it
    calibration: str = ""  # File for all recordings that have none of their own; "" without one
    again: bool = False  # Compute everything anew
    retry_failed: bool = False  # Try again what failed before by the recording itself
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
            "retry": False,
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
        """The row of a recording that failed by its surroundings."""
        return self.row(FAILED, error=sentence, retry=True)


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
        more = {"error": sentence_of(error), "retry": _may_pass(error)}
        return job.row(FAILED, input_hash, **more, seconds=time.perf_counter() - began)


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
        raise _Surroundings(sentence)


def _same(job: Job, folder: StudyFolder, input_hash: str) -> Row | None:
    """The earlier row of this very content, whose output is as it was written; None without one."""
    row = None if job.settings.again else folder.row(job.name)
    if row is None or row["id"] != job.row(DONE, input_hash)["id"]:
        return None
    if row["status"] != DONE:
        return None if row["retry"] or job.settings.retry_failed else row
    output = folder.output(job.name)
    return row if output.is_file() and file_hash(output) == row["output_hash"] else None


def _recover(job: Job, folder: StudyFolder, input_hash: str, began: float) -> Row:
    from calib.motion import with_given

    from ..io import write_recovery
    from ..io.recording.read import read_arms
    from ..measures import measure
    from ..several_arms import smooth_arms

    if job.calibration and file_hash(job.calibration) != job.calibration_hash:
        raise _Surroundings(f"{job.calibration} was changed while the study ran; start it again")
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


class _Surroundings(UnoccludeError):
    """The machine or its folders are at fault, not the recording."""


def _may_pass(error: Exception) -> bool:
    """Whether the surroundings of a recording are at fault, so that its failure may pass."""
    if isinstance(error, UnoccludeError):
        return not isinstance(error, RecordingError | CalibrationError | SolveError)
    return isinstance(error, OSError) or is_out_of_memory(error)
