"""Measures as tables of the terminal and as CSV."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from .output import percent, print_table, say

if TYPE_CHECKING:
    from ..measures import BothArms, Measure, Measures, Movement, Scope

#: What the table of movements and repetitions shows, and its heads; `--csv` and `--json` have all.
HEADS = {
    "elbow_flexion_range_deg": "elbow's range, deg",
    "hand_path_length_m": "path, m",
    "hand_peak_speed_m_s": "peak speed, m/s",
    "sparc": "SPARC",
    "velocity_peaks": "peaks",
}
#: More movements than this are not printed.
_MOST_ROWS = 30


def print_session(one: Measures) -> None:
    """The session's measures; zones of angles are left to `--csv` and `--json`."""
    rows = [_cells(row) for row in one.session if "_zone_" not in row.key and row.is_known]
    columns = ("measure", "value", "95 % interval", "unit", "recovered")
    print_table(f"{one.name}, {one.arm_label}: the session", columns, rows)
    reasons: dict[str, list[str]] = {}
    for row in one.session:
        if not row.is_known and row.note:
            reasons.setdefault(row.note, []).append(row.name.partition(",")[0])
    for reason, names in reasons.items():
        say(f"not measured: {', '.join(dict.fromkeys(names))}. {reason}")


def print_places(title: str, places: Sequence[Movement], scope: Scope, one: Measures) -> None:
    """A row for each movement or repetition."""
    if not places:
        return
    some = [one.of(scope, number) for number in range(min(len(places), _MOST_ROWS))]
    shown = [key for key in HEADS if any(key in row and row[key].is_known for row in some)]
    rows = [
        (
            f"{number + 1}",
            f"{place.start_s:.2f}",
            f"{place.length_s:.2f}",
            *[_value_text(row.get(key)) for key in shown],
        )
        for number, (place, row) in enumerate(zip(places, some, strict=False))
    ]
    more = len(places) - len(rows)
    columns = ("", "from, s", "length, s", *(HEADS[key] for key in shown))
    print_table(f"{title}: value (95 % interval)", columns, rows)
    if more > 0:
        say(f".. and {more} more: --csv and --json have them all")


def print_symmetry(both: BothArms) -> None:
    """The symmetry indices of a person's two arms."""
    rows = [_cells(row) for row in both.rows if row.is_known]
    of = "" if both.left.body is None else f" of body {both.left.body}"
    if rows:
        columns = ("symmetry", "value", "95 % interval", "unit", "recovered")
        print_table(f"Right arm{of} against left: 0 = alike, above it the right has more", columns, rows)


def write_csv(path: Path, rows: Sequence[Measures], pairs: Sequence[BothArms], force: bool) -> None:
    """One row a measure: recording, side, body, then the fields of a measure; empty where there is none."""
    import csv

    from ..measures import Measure
    from ..runtime.outputs import writing

    names = [each.name for each in fields(Measure)]
    with writing(path, force) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["recording", "side", "body", *names])
        for one in rows:
            for row in one.rows:
                writer.writerow(
                    [one.name, one.side, _csv_cell(one.body), *[_csv_cell(getattr(row, n)) for n in names]]
                )
        for both in pairs:
            for row in both.rows:
                cells = [_csv_cell(getattr(row, name)) for name in names]
                writer.writerow([both.left.name, "both", _csv_cell(both.left.body), *cells])


def _cells(row: Measure) -> tuple[str, ...]:
    rests = percent(row.recovered_share)
    if row.is_known and row.note:
        rests += f" ({percent(row.untrusted_share)} not trusted)"
    return row.name, _text(row, row.value), _interval_text(row) or "-", row.unit, rests


def _value_text(row: Measure | None) -> str:
    """A value and its interval as one cell."""
    if row is None or not row.is_known:
        return "-"
    between = _interval_text(row)
    value = _text(row, row.value)
    return f"{value} ({between})" if between and between != value else value


def _interval_text(row: Measure) -> str:
    if not row.has_interval:
        return ""
    low, high = _text(row, row.low), _text(row, row.high)
    return low if low == high else f"{low} to {high}"


def _text(row: Measure, value: float) -> str:
    """Three digits that count, never an exponent; yes or no for what is reached."""
    if not math.isfinite(value):
        return "-"
    if row.key.endswith("_reached"):
        return "yes" if value > 0.5 else "no"
    if row.unit == "" and value == round(value) and value >= 0.0:
        return f"{value:.0f}"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:.{digits}f}"


def _csv_cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return repr(round(value, 9)) if isinstance(value, float) else value
