"""The recordings of a study: those of a folder, of a pattern, or of a list; and whose sessions they are.

What a result depends on, as hashes, and what rows record about the machine: nothing, unless asked for.

Trials of one session are what one folder holds: short recordings of one person and strap, whose camera and
IMU have clocks of their own. Alone they hardly prove that they belong together (`selfcal.session`).
"""

from __future__ import annotations

import csv
import glob
import hashlib
import io
import itertools
import json
import math
import os
import re
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..config import Config
from ..errors import CalibrationError, UnoccludeError
from ..io.recording.choose import Selection
from ..recording import Recording
from ..runtime.csv_rows import read_cell
from ..runtime.inputs import check_input
from ..runtime.outputs import writing
from ..runtime.pool import Pool, check_allowance
from .folder import StudyFolder, text_hash

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..io.recording.choose import Selection


def file_hash(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits; refuses what is not a file."""
    check_input(path)
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def config_hash(config: Config, selection: Selection) -> str:
    """SHA-256 of all settings that a result depends on; the number of processes is none of them."""
    settings: dict[str, Any] = config.model_dump(
        mode="json", exclude={"windows": {"processes"}}, exclude_none=True
    )
    chosen = {name: selection.get(name) for name in ("imu", "skeleton", "side", "body")}
    return text_hash(json.dumps([settings, chosen], sort_keys=True))


_DAY_NS = 86_400 * 10**9
#: Stamps before 2000 are those of a clock that does not know the date.
EARLIEST_NS = 10_957 * _DAY_NS
#: Days of a person are shifted by up to this many.
MOST_DAYS = 3650.0


def relative_day(word: str, person: str, origin_ns: int) -> float | None:
    """When a recording was made, in days from a time that only the study knows."""
    if origin_ns < EARLIEST_NS:
        return None
    shift = int(text_hash("day", word, person)[:13], 16) / 16**13 * MOST_DAYS
    return origin_ns / _DAY_NS - shift


def without_places(text: str, names: Mapping[str, str]) -> str:
    """A sentence without the folders and the name of this machine."""
    import socket

    places = dict(names)
    for folder in (tempfile.gettempdir(), os.getcwd(), os.path.expanduser("~")):
        places.setdefault(folder, f"[{'temporary' if folder == tempfile.gettempdir() else 'own'} folder]")
    for path in sorted(places, key=len, reverse=True):  # the longest first: folders are in folders
        if path and path.strip("/\\"):
            text = text.replace(path, places[path])
    host = socket.gethostname()
    return text.replace(host, "a machine") if len(host) > 3 else text


ENDING = ".mcap"


@dataclass(frozen=True)
class Entry:
    """One recording of a study."""

    name: str  # What it is called in the results: its path below the study's common folder, with slashes
    path: str  # The recording, absolute
    calibration: str = ""  # A calibration of its own, absolute; "" where the study's is taken


def find_entries(source: str, output: Path) -> list[Entry]:
    """The recordings that a folder, a pattern or a list names, sorted by name."""
    path = Path(source)
    if path.is_dir():
        base, files = path, [(file, "") for file in _below(path)]
    elif glob.has_magic(source) and not path.exists():
        fixed = itertools.takewhile(lambda part: not glob.has_magic(part), path.parts[:-1])
        base = Path(*fixed)  # names count from the first wildcard
        files = [(Path(file), "") for file in glob.iglob(source, recursive=True) if file.endswith(ENDING)]
    elif path.suffix == ENDING:
        base, files = path.parent, [(path, "")]
    else:
        base, files = _listed(path)
    recordings = [(file, calibration) for file, calibration in files if not _inside(file, output)]
    if files and not recordings:
        raise UnoccludeError(f"{source} is in {output}, where results go; give -o another folder")
    if not recordings:
        raise UnoccludeError(f"{source}: there is no recording ({ENDING}) here; name a folder that has some")
    entries = {}
    for file, calibration in recordings:
        place = _absolute(file)
        entries[place] = Entry(Path(place).relative_to(_absolute(base)).as_posix(), place, calibration)
    named: dict[str, Entry] = {}  # names that are text, none twice
    for entry in sorted(entries.values(), key=lambda entry: (entry.name != _as_text(entry.name), entry.name)):
        name = _as_text(entry.name)
        if name in named:
            name = f"{name.removesuffix(ENDING)}-{text_hash(entry.path)[:8]}{ENDING}"
        named[name] = replace(entry, name=name)
    return [named[name] for name in sorted(named)]


def _as_text(name: str) -> str:
    """A name with `%FF` for every byte that is not UTF-8, and for every control character."""
    raw = re.sub(r"[\udc80-\udcff]", lambda byte: f"%{ord(byte[0]) - 0xDC00:02X}", name)
    return re.sub(r"[\x00-\x1f\x7f]", lambda control: f"%{ord(control[0]):02X}", raw)


def _below(folder: Path) -> Iterator[Path]:
    """Recordings below a folder; not those of hidden folders, nor the outputs of other studies."""
    for place, folders, names in os.walk(folder):
        here = Path(place)
        folders[:] = [
            each
            for each in folders
            if not each.startswith(".") and not StudyFolder(here / each).mark.exists()
        ]
        yield from (here / name for name in names if name.endswith(ENDING) and not name.startswith("."))


def _listed(path: Path) -> tuple[Path, list[tuple[Path, str]]]:
    """Folder that the names count from, and the recordings of a list with their own calibrations."""
    if path.absolute().parent != Path("/dev/fd"):  # what a shell makes of <(...) has its writer
        check_input(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise UnoccludeError(
            f"{path}: {error.strerror or error}; name a folder, a pattern in quotation marks, or a list"
        ) from error
    except UnicodeDecodeError as error:
        raise UnoccludeError(f"{path} is not a list: it is not text with one recording a line") from error
    files: list[tuple[Path, str]] = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        recording, *more = [part.strip() for part in line.split("\t")]
        if not recording.endswith(ENDING) or len(more) > 1:
            raise UnoccludeError(
                f"{path}, line {number}: expected a recording ({ENDING}), perhaps a tab and a calibration"
            )
        calibration = _absolute(path.parent / more[0]) if more and more[0] else ""
        files.append((path.parent / recording, calibration))
    inside = all(_inside(file, path.parent) for file, _ in files)
    if inside or not files:
        return path.parent, files
    try:
        return Path(os.path.commonpath([_absolute(file.parent) for file, _ in files])), files
    except ValueError as error:  # Windows: several drives
        raise UnoccludeError(
            f"{path}: the recordings are on several drives; make a list for each of them"
        ) from error


def _inside(file: Path, folder: Path) -> bool:
    return Path(_absolute(file)).is_relative_to(_absolute(folder))


def _absolute(path: str | os.PathLike[str]) -> str:
    """An absolute path; POSIX lets two slashes at its begin stand, which would be another root."""
    plain = os.path.abspath(path)
    return plain[1:] if os.sep == "/" and plain.startswith("//") else plain


#: Headings of the user's table.
_HEADINGS = ("file", "person", "session", "date", "task")
_EXPECTED = "expected the columns file, person, and session or date (and perhaps task)"


@dataclass(frozen=True)
class SessionEntry:
    """A recording as one of a person's sessions."""

    recording: str  # Its name in the study
    person: str
    session: str  # What it is called
    task: str = ""  # What was done in it, where a session has several recordings; "" otherwise
    day: float = math.nan  # When, from a day that is the same for all of a person


def by_folders(name: str, day: float) -> SessionEntry | None:
    """A recording's session by its name in the study."""
    person, *rest = name.removesuffix(ENDING).split("/")
    if not rest:
        return None
    return SessionEntry(name, person, rest[0], "/".join(rest[1:]), day)


def read_sessions(path: Path, recordings: Iterable[str]) -> dict[str, SessionEntry]:
    """The sessions of a table: CSV with the columns `file`, `person`, `session` or `date`, perhaps `task`."""
    names, sessions = set(recordings), dict[str, SessionEntry]()
    for line, row in _rows(path):
        where = f"{path}, line {line}"
        file, person, session, date, task = (row[name] for name in _HEADINGS)
        file = file if file.endswith(ENDING) or not file else f"{file}{ENDING}"
        wrong = {
            f"there is no {'person' if file else 'file'}; {_EXPECTED}": not file or not person,
            f"{file} is not a recording of this study; its names are as {', '.join(sorted(names)[:3])}": (
                file not in names
            ),
            f"{file} is there twice; a recording is of one session": file in sessions,
            f"there is neither session nor date; {_EXPECTED}": not session and not date,
        }
        for sentence in (sentence for sentence, is_so in wrong.items() if is_so):
            raise UnoccludeError(f"{where}: {sentence}")
        day = _day(date, where) if date else math.nan
        sessions[file] = SessionEntry(file, person, session or date, task, day)
    if not sessions:
        raise UnoccludeError(f"{path} names no recording; {_EXPECTED}")
    return sessions


def in_order(attendances: Iterable[SessionEntry]) -> list[list[SessionEntry]]:
    """A person's sessions in the order of time, or by name where a day is not known; each with its rows."""
    sessions: dict[str, list[SessionEntry]] = {}
    for attendance in attendances:
        sessions.setdefault(attendance.session, []).append(attendance)
    days = {name: min(each.day for each in rows) for name, rows in sessions.items()}
    known = all(math.isfinite(day) for day in days.values())
    order = sorted(sessions, key=lambda name: (days[name] if known else 0.0, _natural(name)))
    return [sessions[name] for name in order]


def _rows(path: Path) -> Iterable[tuple[int, dict[str, str]]]:
    """Line and cells by heading of every row that is not empty."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}; name a CSV table of sessions") from error
    except UnicodeDecodeError as error:
        raise UnoccludeError(f"{path} is not a table: it is not text in UTF-8; save it as CSV") from error
    # spreadsheets of some countries write semicolons
    reader = csv.DictReader(io.StringIO(text), delimiter=max(",;\t", key=text.partition("\n")[0].count))
    try:
        headings = [heading.strip().lower() for heading in reader.fieldnames or ()]
        if not {"file", "person"} <= set(headings) or not {"session", "date"} & set(headings):
            raise UnoccludeError(f"{path}: its columns are {', '.join(headings) or 'none'}; {_EXPECTED}")
        reader.fieldnames = headings
        for row in reader:
            cells = {name: read_cell((row.get(name) or "").strip()) for name in _HEADINGS}
            if any(cells.values()):
                yield reader.line_num, cells
    except csv.Error as error:
        raise UnoccludeError(f"{path}, line {reader.line_num}: {error}; save it as plain CSV") from error


def _day(text: str, where: str) -> float:
    try:
        date = datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError as error:
        raise UnoccludeError(
            f"{where}: '{text}' is not a date; write it as 2026-03-31, or give a column session with numbers"
        ) from error
    return (date - datetime(1970, 1, 1)).total_seconds() / 86_400


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """By which "s10" comes after "s9"."""
    parts = re.split(r"(\d+)", name)
    return tuple((1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts)


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
