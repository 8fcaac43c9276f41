"""Whose a recording of a study is, and of which session: by its folders, or by a table of the user's."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from ..errors import UnoccludeError
from .inputs import ENDING

#: Headings of the user's table.
_HEADINGS = ("file", "person", "session", "date", "task")
_EXPECTED = "expected the columns file, person, and session or date (and perhaps task)"


@dataclass(frozen=True)
class SessionEntry:
    """A recording as one of a person's sessions.

    Attributes
    ----------
    recording : str
        Its name in the study.
    person, session : str
        Whose, and what the session is called.
    task : str
        What was done in it, where a session has several recordings; "" otherwise.
    day : float, d
        When, from a day that is the same for all of a person; nan where that is not known.
    """

    recording: str
    person: str
    session: str
    task: str = ""
    day: float = math.nan


def by_folders(name: str, day: float) -> SessionEntry | None:
    """A recording's session by its name in the study.

    `PERSON/SESSION.mcap`, or `PERSON/SESSION/TASK.mcap` where a session has several recordings.

    Parameters
    ----------
    name : str
        With its ending.
    day : float, d
        When it was recorded; nan where that is not known.

    Returns
    -------
    SessionEntry or None
        None where the recording lies in no folder.
    """
    person, *rest = name.removesuffix(ENDING).split("/")
    if not rest:
        return None
    return SessionEntry(name, person, rest[0], "/".join(rest[1:]), day)


def read_sessions(
    path: Path, recordings: Iterable[str], known_as: Callable[[str], str]
) -> dict[str, SessionEntry]:
    """The sessions of a table: CSV with the columns `file`, `person`, `session` or `date`, perhaps `task`.

    Parameters
    ----------
    path : Path
        The table. `file` is a recording's name below the folder that was given to `batch`; a date is
        YYYY-MM-DD, perhaps with a time.
    recordings : iterable of str
        The names in the study.
    known_as : callable
        What the study calls a recording of that name: the same, or a hash.

    Returns
    -------
    sessions : dict of str to SessionEntry
        By the recordings' names in the study.

    Raises
    ------
    UnoccludeError
        The table cannot be used: names the line and what is wrong with it.
    """
    names, sessions = set(recordings), dict[str, SessionEntry]()
    for line, row in _rows(path):
        where = f"{path}, line {line}"
        file, person = row.get("file", ""), row.get("person", "")
        file = file if file.endswith(ENDING) or not file else f"{file}{ENDING}"
        if not file or not person:
            raise UnoccludeError(f"{where}: there is no {'person' if file else 'file'}; {_EXPECTED}")
        name = next((each for each in (file, known_as(file)) if each in names), None)
        if name is None:
            examples = ", ".join(sorted(names)[:3])
            raise UnoccludeError(
                f"{where}: {file} is no recording of this study; its names are as {examples}"
            )
        if name in sessions:
            raise UnoccludeError(f"{where}: {file} stands there twice; a recording is of one session")
        session, date = row.get("session", ""), row.get("date", "")
        if not session and not date:
            raise UnoccludeError(f"{where}: there is neither session nor date; {_EXPECTED}")
        day = _day(date, where) if date else math.nan
        sessions[name] = SessionEntry(name, person, session or date, row.get("task", ""), day)
    if not sessions:
        raise UnoccludeError(f"{path} names no recording; {_EXPECTED}")
    return sessions


def in_order(attendances: Iterable[SessionEntry]) -> list[list[SessionEntry]]:
    """A person's sessions in the order of time, each with its recordings.

    By the days where all are known, else by the sessions' names, numbers in them as numbers.
    """
    sessions: dict[str, list[SessionEntry]] = {}
    for attendance in attendances:
        sessions.setdefault(attendance.session, []).append(attendance)
    days = {name: min(each.day for each in rows) for name, rows in sessions.items()}
    if all(math.isfinite(day) for day in days.values()):
        return [sessions[name] for name in sorted(sessions, key=lambda name: (days[name], _natural(name)))]
    return [sessions[name] for name in sorted(sessions, key=_natural)]


def _rows(path: Path) -> Iterable[tuple[int, dict[str, str]]]:
    """Line and cells by heading of every row that is not empty."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}; name a CSV table of sessions") from error
    except UnicodeDecodeError as error:
        raise UnoccludeError(f"{path} is no table: it is not text in UTF-8; save it as CSV") from error
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)  # spreadsheets of some countries write semicolons
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    try:
        headings = [heading.strip().lower() for heading in next(reader, [])]
        missing = [name for name in ("file", "person") if name not in headings]
        if missing or not {"session", "date"} & set(headings):
            raise UnoccludeError(f"{path}: its columns are {', '.join(headings) or 'none'}; {_EXPECTED}")
        for cells in reader:
            if any(cell.strip() for cell in cells):
                row = dict(zip(headings, (cell.strip() for cell in cells), strict=False))
                yield reader.line_num, {name: row.get(name, "") for name in _HEADINGS}
    except csv.Error as error:
        raise UnoccludeError(f"{path}, line {reader.line_num}: {error}; save it as plain CSV") from error


def _day(text: str, where: str) -> float:
    try:
        date = datetime.fromisoformat(text).replace(tzinfo=None)
    except ValueError as error:
        raise UnoccludeError(
            f"{where}: '{text}' is no date; write it as 2026-03-31, or give a column session with numbers"
        ) from error
    return (date - datetime(1970, 1, 1)).total_seconds() / 86_400


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """By which "s10" comes after "s9"."""
    parts = re.split(r"(\d+)", name)
    return tuple((1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts)
