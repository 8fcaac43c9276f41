"""A study from its recordings to its results; what was done before is not done again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from .folder import FAILED, Row, StudyFolder, text_hash
from .inputs import Entry, config_hash, file_hash
from .job import Job, StudySettings
from .sessions import with_sessions
from .workers import Workers, rows_of

if TYPE_CHECKING:
    import pyarrow as pa


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
