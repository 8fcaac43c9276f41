"""`unocclude measures`: what a recovered motion measures, each with its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..table import percent
from .arm_output import arms_figures, say_arm
from .load import damage, load_recoveries
from .options import NO_FILES, Body, Outputs, Processes, Result, Side, one_side
from .output import check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from ..measures import BothArms, Measure, Measures, MeasureSettings, Movement, Scope
    from ..result import Recovery


#: What the table of movements and repetitions shows, and its heads; `--csv` and `--json` have all.
HEADS = {
    "elbow_flexion_range_deg": "elbow's range",
    "hand_path_length_m": "path",
    "hand_peak_speed_m_s": "peak speed",
    "sparc": "SPARC",
    "velocity_peaks": "peaks",
}
#: More movements than this are not printed.
_MOST_ROWS = 30


def print_session(one: Measures) -> None:
    """The session's measures; zones of angles are left to `--csv` and `--json`."""
    rows = [_cells(row) for row in one.session if "_zone_" not in row.key and row.is_known]
    columns = ("measure", "value", "95 % interval", "recovered")
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
        columns = ("symmetry", "value", "95 % interval", "recovered")
        print_table(f"Right arm{of} against left: 0 = alike, above it the right has more", columns, rows)


def write_csv(path: Path, rows: Sequence[Measures], pairs: Sequence[BothArms], force: bool) -> None:
    """One row per measure: recording, side, body, then the fields of a measure; empty where there is none."""
    from ..measures import Measure
    from ..runtime.csv_rows import write_rows
    from ..runtime.outputs import writing

    names = [each.name for each in fields(Measure)]
    sources = [(one.name, one.side, one.body, one.rows) for one in rows]
    sources += [(both.left.name, "both", both.left.body, both.rows) for both in pairs]
    with writing(path, force) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        write_rows(file, [["recording", "side", "body", *names]])
        for name, side, body, own in sources:
            write_rows(
                file, ([name, side, *map(_csv_cell, (body, *(getattr(r, n) for n in names)))] for r in own)
            )


def _cells(row: Measure) -> tuple[str, ...]:
    rests = percent(row.recovered_share) or "-"
    if row.is_known and row.note:
        rests += f" ({percent(row.untrusted_share)} not trusted)"
    return row.name, _text(row, row.value), _interval_text(row) or "-", rests


def _value_text(row: Measure | None) -> str:
    """A value and its interval as one cell."""
    if row is None or not row.is_known:
        return "-"
    between = _interval_text(row)
    value = _text(row, row.value)
    return f"{value} ({between})" if between and between != value else value


def _interval_text(row: Measure) -> str:
    from ..evaluation.progress import interval

    if not row.has_interval:
        return ""
    low, high = _text(row, row.low), _text(row, row.high)
    if low == high:
        return low
    return f"{low} to {high}" if row.key.endswith("_reached") else interval(row.low, row.high, row.unit)


def _text(row: Measure, value: float) -> str:
    """As pages write it, with the unit; yes or no for what is reached."""
    from ..evaluation.progress import worded

    return worded(row.key, value, row.unit)


def _csv_cell(value: object) -> object:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return repr(round(value, 9)) if isinstance(value, float) else value


def measures(
    result: Result,
    config_file: Annotated[
        Path | None,
        typer.Option("--config", metavar="M.toml", help="Thresholds and sizes; docs/measures.md lists them."),
    ] = None,
    side: Side = None,
    body: Body = None,
    csv_file: Annotated[
        Path | None,
        typer.Option("--csv", metavar="FILE", help="Also write every measure as a row of a table."),
    ] = None,
    processes: Processes = None,
    to: Outputs = NO_FILES,
) -> None:
    """Measure range of motion, reach, speed, smoothness.

    For the session, each hand movement and each repetition of an exercise, with intervals from the motions
    that `unocclude smooth` drew; with both arms also their symmetry. No diagnosis: the numbers describe a
    motion.
    """
    from ..measures import MeasureSettings
    from .config import read_settings

    check_outputs(to.force, [csv_file, to.report, to.json_file], [result, config_file])
    settings = read_settings(config_file, MeasureSettings)
    recoveries = load_recoveries(result, one_side(side), body)
    rows, pairs = measured(recoveries, settings, processes or 0)
    if to.report is not None:
        from ..report.measures import measures_page

        measures_page(rows, pairs).write(to.report, to.force)
    if csv_file is not None:
        write_csv(csv_file, rows, pairs, to.force)
    figures = arms_figures(recoveries, [one.as_dict() for one in rows])
    if pairs:
        figures["symmetry"] = [{"body": both.left.body, "measures": both.as_dict()} for both in pairs]
    write_json(to.json_file, figures, to.force)
    for recovery, one in zip(recoveries, rows, strict=True):
        say_arm(recovery, len(recoveries))
        print_arm(one, damage(recovery.notes))
    for both in pairs:
        print_symmetry(both)
    say_written(csv_file, to.report, to.json_file)


def measured(
    recoveries: list[Recovery], settings: MeasureSettings, processes: int
) -> tuple[list[Measures], list[BothArms]]:
    """The measures of each arm, and the comparison of each person's two arms."""
    from ..measures.measuring import Measuring, measures_of
    from ..measures.symmetry import both_arms
    from .output import progress_bar

    done: list[Measuring] = []
    with progress_bar("measuring") as progress:
        for number, recovery in enumerate(recoveries):

            def advanced(share: float, text: str, before: int = number) -> None:
                progress((before + share) / len(recoveries), text)

            done.append(Measuring.of(recovery, settings, processes, advanced))
        progress(1.0, "done")
    pairs = []
    for body in dict.fromkeys(one.recovery.body for one in done):
        arms = [one for one in done if one.recovery.body == body]
        by_side = {one.recovery.side: one for one in arms}
        if len(arms) == 2 and by_side.keys() == {"left", "right"}:
            pairs.append(both_arms(by_side["left"], by_side["right"]))
    return [measures_of(one) for one in done], pairs


def print_arm(one: Measures, damaged: list[str]) -> None:
    """An arm's verdict, tables and notes; what is not to be trusted is said first."""
    if one.trusted is False:
        say(f"{one.verdict} The measures below are those of an answer that is not to be trusted.")
    print_session(one)
    print_places("Movements of the hand", one.movements, "movement", one)
    print_places("Repetitions", one.repetitions, "repetition", one)
    print_notes([*damaged, *one.notes])
