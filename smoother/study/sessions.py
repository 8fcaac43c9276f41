"""Trials of one session: what they show of the strap together, as a calibration for each of them.

A session is what one folder holds: short recordings of one person and strap, whose camera and IMU have clocks
of their own. Alone they hardly prove that they belong together (`selfcal.session`).
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..config import Config
from ..errors import CalibrationError, UnoccludeError
from ..recording import Recording
from ..runtime.outputs import writing
from ..runtime.pool import Pool, check_allowance
from .folder import StudyFolder, text_hash
from .inputs import Entry, config_hash, file_hash, find_entries

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..io.recording.choose import Selection

#: A longer recording proves its clock by itself, s.
LONGEST_S = 60.0
#: A larger file holds no trial, bytes: it is not read to find out.
LARGEST_BYTES = 20e6
#: Fewer trials are no session.
FEWEST = 2


@dataclass(frozen=True)
class Session:
    """What the trials of a folder brought."""

    arms: dict[Path, tuple[ArmCalibration, ...]]  # By recording; of those that a strap fits
    trials: int  # That were looked at
    straps: int  # That were found, of all sides together

    @property
    def sentence(self) -> str:
        """What the session brought, in one sentence; "" where there is none."""
        if self.trials < FEWEST:
            return ""
        if not self.straps:
            return f"the session's {self.trials} trials do not show how the IMU sits: each stands for itself"
        straps = "one strap" if self.straps == 1 else f"{self.straps} straps, put on anew or of two persons"
        fit = f"{len(self.arms)} of {self.trials} trials"
        return f"the session shows {straps}: {fit} fit and share their calibration"


def calibrate_session(
    paths: Iterable[Path], selection: Selection, config: Config, processes: int = 1
) -> Session:
    """Calibrate the trials among some recordings, by arm and by strap; what cannot be read is left out."""
    check_allowance()
    from calib.motion import calibrate_motion

    from ..selfcal.session import find_straps

    by_side: dict[str, list[tuple[Path, Recording]]] = defaultdict(list)
    for path in paths:
        for recording in _trials(path, selection):
            by_side[recording.side].append((path, recording))
    arms: dict[Path, tuple[ArmCalibration, ...]] = {}
    straps = 0
    config = config.model_copy(update={"windows": config.windows.model_copy(update={"processes": processes})})
    for trials in by_side.values():
        with Pool(processes, sum(len(recording.arm) for _, recording in trials)) as workers:
            found = find_straps([recording for _, recording in trials], workers)
        for strap in found:
            members = [trials[number] for number in strap.members]
            with suppress(CalibrationError):  # then each stands for itself
                calibration = calibrate_motion(
                    [recording for _, recording in members], None, config
                ).calibration
                straps += 1
                for path, _ in members:
                    arms[path] = (*arms.get(path, ()), calibration)
    looked_at = {path for trials in by_side.values() for path, _ in trials}
    return Session(arms, len(looked_at), straps)


def trials_in(session: Path) -> list[Path]:
    """The recordings of a session: those of a folder, or of a list as `batch` takes it."""
    if session.is_dir():
        return [path.resolve() for path in sorted(session.glob("*.mcap"))]
    return [Path(entry.path) for entry in find_entries(str(session), session)]


def is_trial(path: Path, selection: Selection) -> bool:
    """Whether a recording is so short, and its clocks so unrelated, that a session helps it."""
    return next(_trials(path, selection), None) is not None


def _trials(path: Path, selection: Selection) -> Iterator[Recording]:
    """The arms of a recording that is a trial with clocks that have nothing in common."""
    from ..io.recording.read import read_arms

    with suppress(UnoccludeError, OSError):
        if path.stat().st_size > LARGEST_BYTES:
            return
        for recording, _ in read_arms(path, None, truth=False, **selection):
            t_s = recording.arm.t_s
            if recording.clocks_unrelated and len(t_s) > 1 and t_s[-1] - t_s[0] <= LONGEST_S:
                yield recording


def write_arms(path: Path, arms: Sequence[ArmCalibration]) -> None:
    """A calibration file of some arms."""
    from calib.file import CalibrationFile, write_calibration

    file = CalibrationFile()
    for arm in arms:
        file = file.with_arm(arm)
    write_calibration(path, file)


def with_sessions(
    entries: Sequence[Entry], folder: StudyFolder, selection: Selection, config: Config, version: str
) -> tuple[list[Entry], list[str]]:
    """The entries with the calibrations of their sessions, in the study's folder, and what these brought.

    A session that was calibrated before, of the same files, is not calibrated again.
    """
    notes, calibrated = [], list(entries)
    places: dict[Path, list[int]] = defaultdict(list)
    for number, entry in enumerate(entries):
        if not entry.calibration:
            places[Path(entry.path).parent].append(number)
    for place, numbers in places.items():
        hashes = {}
        for path in (Path(entries[number].path) for number in numbers):
            with suppress(UnoccludeError, OSError):  # what cannot be read fails later, by itself
                if path.stat().st_size <= LARGEST_BYTES:
                    hashes[path] = file_hash(path)
        if len(hashes) < FEWEST:
            continue
        key = text_hash(version, config_hash(config, selection), *hashes.values())[:16]
        index = folder.path / "sessions" / f"{key}.json"
        if not index.exists():
            session = calibrate_session(hashes, selection, config)
            index.parent.mkdir(parents=True, exist_ok=True)
            files: dict[tuple[int, ...], str] = {}
            for arms in session.arms.values():
                if (own := tuple(map(id, arms))) not in files:
                    files[own] = f"{index.stem}-{len(files) + 1}.toml"
                    write_arms(index.parent / files[own], arms)
            names = {hashes[path]: files[tuple(map(id, arms))] for path, arms in session.arms.items()}
            with writing(index, force=True) as temporary:
                values = {"sentence": session.sentence, "calibrations": names}
                temporary.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
        kept = json.loads(index.read_text(encoding="utf-8"))
        if kept["sentence"]:
            notes.append(f"{place.name}: {kept['sentence']}")
        for number in numbers:
            own_hash = hashes.get(Path(entries[number].path), "")
            if name := kept["calibrations"].get(own_hash):
                calibrated[number] = replace(entries[number], calibration=str(index.parent / name))
    return calibrated, notes
