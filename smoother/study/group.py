"""Whose the recordings of a study are, and its measures in long format."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..evaluation.group import LONG
from .folder import DONE, Row
from .inputs import SessionEntry, by_folders, in_order


def entries_of(rows: Sequence[Row]) -> dict[str, SessionEntry]:
    """Whose each recording is, by its folders; one that is in none is a person of its own."""
    entries = {}
    for row in rows:
        name, day = row["recording"], row.get("recorded_day")
        entry = by_folders(name, math.nan if day is None else float(day))
        entries[name] = entry or SessionEntry(name, Path(name).stem, "1")
    return entries


def persons_of(rows: Sequence[Row]) -> dict[str, str]:
    """The person of each recording that is in a person's folder."""
    return {name: entry.person for name, entry in entries_of(rows).items() if "/" in name}


def long_rows(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """One row per measure of a session, as R, SPSS and others take them.

    Parameters
    ----------
    rows : sequence of dict
        Of a study; what failed, and what has no measures, has none here.

    Returns
    -------
    rows : list of dict
        By the names in `LONG`; what is not to be trusted is there, with `trusted` 0. Days count from the
        person's first session.
    """
    entries = entries_of(rows)
    numbers, days = _sessions(list(entries.values()))
    found = []
    for row in rows:
        if row["status"] != DONE or row["measures"] is None:
            continue
        entry = entries[row["recording"]]
        day = entry.day - days[entry.person]
        about = {
            "person": entry.person,
            "session": entry.session,
            "session_number": numbers[entry.person, entry.session],
            "day": round(day, 3) if math.isfinite(day) else None,
            "task": entry.task,
            "recording": row["recording"],
        }
        for each in row["measures"]:
            taken = {name: each[name] for name in LONG[9:]}
            found.append(
                about
                | {"side": each["side"] or "", "trusted": int(each["trusted"] is not False)}
                | {"measure": each["key"]}
                | taken
            )
    return found


def _sessions(entries: Sequence[SessionEntry]) -> tuple[dict[tuple[str, str], int], dict[str, float]]:
    """Number of each session of a person, from 1, and the day of the person's first."""
    persons: dict[str, list[SessionEntry]] = {}
    for entry in entries:
        persons.setdefault(entry.person, []).append(entry)
    numbers = {
        (person, session[0].session): number
        for person, mine in persons.items()
        for number, session in enumerate(in_order(mine), start=1)
    }
    return numbers, {person: min(each.day for each in mine) for person, mine in persons.items()}
