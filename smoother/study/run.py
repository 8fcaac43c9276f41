"""A study from its recordings to its results; what was done before is not done again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from ..errors import UnoccludeError
from .folder import DONE, FAILED, Row, StudyFolder
from .inputs import Entry, config_hash, file_hash, hashed_name, text_hash
from .job import SAME, Job, StudySettings
from .ledger import Ledger

if TYPE_CHECKING:
    import pyarrow as pa

Work = Callable[[Iterator[Job]], Generator[Row | None, None, None]]


@dataclass
class Tally:
    """How far a study is."""

    total: int  # Recordings of the study
    before: int = 0  # Those that an earlier run has done, or tried
    computed: int = 0  # Those that this run has done, and those that failed in it
    failed: int = 0  # Those that this run has done, and those that failed in it
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
    work: Work,
    progress: Callable[[Tally, Row | None], None],
    force: bool = False,
) -> tuple[Tally, pa.Table]:
    """Recover the recordings that are not done yet."""
    calibrations = {
        path: _checked(path)
        for path in {entry.calibration or settings.calibration for entry in entries} - {""}
    }
    word = folder.open(force)
    if settings.hash_names:
        hashed = [replace(entry, name=hashed_name(word, entry.name)) for entry in entries]
        entries = sorted(hashed, key=lambda entry: entry.name)
    with folder.alone():
        plan = _Plan(folder, word, settings, calibrations)
        try:
            return _work_off(entries, plan, work, progress)
        finally:
            folder.remove_stale_tempfiles()  # of processes that were ended in the middle of an output


def _work_off(
    entries: Sequence[Entry], plan: _Plan, work: Work, progress: Callable[[Tally, Row | None], None]
) -> tuple[Tally, pa.Table]:
    tally = Tally(len(entries))

    def todo() -> Iterator[Job]:
        for entry in entries:
            job = plan.job(entry)
            if job is None:
                tally.before += 1
            else:
                yield job

    rows = work(todo())
    try:
        for row in rows:
            if row is None:
                plan.ledger.tick()
            else:
                plan.ids[row["recording"]] = row["id"]
                _count(tally, row)
                if row["status"] != SAME:
                    plan.ledger.add(row)
            progress(tally, row)
    finally:
        plan.ledger.flush()
        rows.close()
    tables = plan.ledger.rows(plan.ids.values())
    tally.notes += plan.ledger.damaged
    return tally, tables


def _count(tally: Tally, row: Row) -> None:
    if row["status"] == DONE:
        tally.computed += 1
        tally.recorded_s += row["duration_s"]
    elif row["status"] == FAILED:
        tally.failed += 1
    else:
        tally.before += 1


class _Plan:
    """What is to be done of a study."""

    def __init__(
        self, folder: StudyFolder, word: str, settings: StudySettings, calibrations: dict[str, str]
    ) -> None:
        self._folder, self._word, self._settings = folder, word, settings
        self._calibrations = calibrations
        self._config_hash = config_hash(settings.config, settings.choice)
        if settings.measures:
            self._config_hash = text_hash(self._config_hash, "measures", str(settings.draws))
        self.ledger = Ledger(folder)
        self.ids: dict[str, str] = {}

    def job(self, entry: Entry) -> Job | None:
        """The job for a recording, None if it is done."""
        settings = self._settings
        calibration = entry.calibration or settings.calibration
        calibration_hash = self._calibrations.get(calibration, "")
        hashes = (self._config_hash, calibration_hash, __version__)
        done, known = self.ledger.find(entry.name, entry.path, hashes, settings.retry_failed)
        if done and not settings.again:
            self.ids[entry.name] = done
            return None
        return Job(
            name=entry.name,
            source=entry.path,
            folder=str(self._folder.path),
            word=self._word,
            settings=settings,
            config_hash=self._config_hash,
            calibration=calibration,
            calibration_hash=calibration_hash,
            known=() if settings.again else known,
        )


def _checked(path: str) -> str:
    """The hash of a calibration that can be read."""
    from calib.file import read_calibration

    read_calibration(path)
    try:
        return file_hash(path)
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error


def study_folder(path: Path) -> StudyFolder:
    """The folder of a study, by its absolute name."""
    return StudyFolder(Path(os.path.abspath(path)))
