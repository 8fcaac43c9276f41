"""A study's measures over each person's sessions, and of all persons: what changed, and what limits it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from ..evaluation.progress import (
    Change,
    PersonProgress,
    Series,
    SessionValue,
    change_between,
    together,
    without_like_movements,
)
from ..evaluation.words import is_main
from ..measures.definitions import BY_MOVEMENT
from .folder import DONE, Row, StudyFolder
from .inputs import SessionEntry, by_folders, in_order, read_sessions

_READ = (
    *("recording", "status", "error", "finished", "config_hash", "calibration_hash", "version"),
    *("trusted", "gaps", "gaps_untrusted", "recorded_day", "measures"),
)
_AGAIN = "run `unocclude batch` again with --measures"
#: A measure of one session: arm, task, key.
_Key = tuple[str, str, str]


def read_rows(folder: Path) -> list[Row]:
    """The latest row of each recording of a study."""
    study = StudyFolder(folder)
    if not study.mark.exists() or not any(study.results.glob("*.parquet")):
        raise UnoccludeError(
            f"{folder} is not a study with results; name the folder that `unocclude batch` wrote"
        )
    rows: list[Row] = study.rows(_READ).to_pylist()
    return rows


def sessions_of(
    folder: Path, rows: Sequence[Row], table: Path | None = None
) -> tuple[dict[str, SessionEntry], list[str]]:
    """Whose each recording is, and of which session."""
    names = [row["recording"] for row in rows]
    if table is not None:
        sessions = read_sessions(table, names)
        rest = [name for name in names if name not in sessions]
        return sessions, [f"{name}: {table.name} does not name it" for name in rest]
    found = {row["recording"]: by_folders(row["recording"], _number(row["recorded_day"])) for row in rows}
    sessions = {name: entry for name, entry in found.items() if entry is not None}
    if not sessions:
        raise UnoccludeError(
            f"{folder}: its recordings are not in folders, so their persons are unknown; name files"
            " PERSON/SESSION.mcap, or list them in a table (--sessions FILE.csv with file, person,"
            " session)"
        )
    return sessions, [f"{name}: it is not in a person's folder" for name in names if name not in sessions]


def progress_of(
    rows: Sequence[Row], sessions: Mapping[str, SessionEntry], mdc95: Mapping[str, float] | None = None
) -> list[PersonProgress]:
    """The measures of every person over the sessions."""
    if not any(row["measures"] is not None for row in rows):
        raise UnoccludeError(f"the study has no measures; {_AGAIN}")
    by_name = {row["recording"]: row for row in rows}
    persons: dict[str, list[SessionEntry]] = {}
    for name, attendance in sessions.items():
        if name in by_name:
            persons.setdefault(attendance.person, []).append(attendance)
    return [_progress(person, persons[person], by_name, mdc95 or {}) for person in sorted(persons)]


def _progress(
    person: str, attendances: Sequence[SessionEntry], rows: Mapping[str, Row], mdc95: Mapping[str, float]
) -> PersonProgress:
    """One person: the sessions' values by measure, then their changes, then what limits them."""
    left_out: list[str] = []
    values: dict[_Key, list[SessionValue]] = {}
    about: dict[_Key, tuple[str, str]] = {}
    days: dict[str, float] = {}
    taken: dict[tuple[str, str], str] = {}
    for session in in_order(attendances):
        day = min(each.day for each in session)
        for each in session:
            other = taken.setdefault((each.session, each.task), each.recording)
            if other != each.recording:
                raise UnoccludeError(
                    f"{other} and {each.recording} are both session {each.session} of {each.person};"
                    " distinguish them by a column task in the table (--sessions), or by another session"
                )
            usable, why = _usable(rows[each.recording])
            left_out += [f"session {each.session} ({each.recording}): {reason}" for reason in why]
            for entry in usable:
                key = (entry["side"] or "", each.task, entry["key"])
                days.setdefault(each.session, day)
                about[key] = entry["name"], entry["unit"] or ""
                value = SessionValue(
                    session=each.session,
                    day=day - next(iter(days.values())),
                    **{name: _number(entry[name]) for name in _NUMBERS},
                    n_draws=entry["n_draws"] or 0,
                    note=entry["note"] or "",
                    recording=each.recording,
                )
                values.setdefault(key, []).append(value)
    changes: dict[_Key, list[Change]] = {}
    for key, found in values.items():
        known = mdc95.get(key[2], math.nan)
        changes[key] = [change_between(found[0], later, known) for later in found[1:]]
        if key[2] in BY_MOVEMENT:  # means over movements, only where the sessions have like movements
            counts = {each.session: each for each in values.get((*key[:2], "movement_count"), ())}
            changes[key] = [
                without_like_movements(each, counts.get(each.first.session), counts.get(each.last.session))
                for each in changes[key]
            ]
    last = {key: own[-1] for key, own in changes.items() if own and is_main(key[2])}
    for key, p in zip(last, together(list(last.values())), strict=True):
        changes[key][-1] = replace(last[key], p_together=p)
    series = [
        Series(person, *key, *about[key], tuple(values[key]), tuple(own)) for key, own in changes.items()
    ]
    return PersonProgress(
        person=person,
        sessions=tuple(days),
        days=tuple(day - next(iter(days.values())) for day in days.values()),
        series=tuple(series),
        left_out=tuple(left_out),
        notes=tuple(_notes([(each, rows[each.recording]) for each in attendances], days)),
    )


_NUMBERS = ("value", "low", "high", "sigma", "recovered_share")


def _usable(row: Row) -> tuple[list[dict[str, Any]], list[str]]:
    """The measures of a row that are used, and why others are not."""
    if row["status"] != DONE:
        return [], [f"it failed: {row['error']}"]
    if row["measures"] is None:
        return [], [f"it was recovered without measures; {_AGAIN}"]
    usable, why = [], []
    for side in dict.fromkeys(entry["side"] for entry in row["measures"]):
        mine = [entry for entry in row["measures"] if entry["side"] == side]
        arm = f"the {side} arm's" if side else "its"
        if any(entry["trusted"] is False for entry in mine):
            why.append(f"{arm} result is not to be trusted")
        elif len({entry["body"] for entry in mine}) > 1:
            why.append(f"it contains several persons' {side} arms; recover one with --body")
        else:
            usable += mine
    return usable, why


def _notes(attended: Sequence[tuple[SessionEntry, Row]], used: Mapping[str, float]) -> Iterator[str]:
    """What limits the statements on a person."""
    for each, row in attended:
        if row["status"] == DONE and row["trusted"] is not False and row["gaps_untrusted"]:
            yield (
                f"session {each.session} ({each.recording}): {row['gaps_untrusted']} of {row['gaps']} gaps"
                " are not to be trusted; what was measured in them may be wrong"
            )
    done = [row for _, row in attended if row["measures"]]
    if len({(row["config_hash"], row["version"]) for row in done}) > 1:
        yield (
            "The sessions were recovered with different settings or versions, which can change measures:"
            " run `unocclude batch` again on all of them."
        )
    if len({row["calibration_hash"] for row in done}) > 1:
        yield "The sessions have different calibration files."
    if not all(math.isfinite(day) for day in used.values()):
        yield "The days of the sessions are unknown: they are ordered by name."


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
