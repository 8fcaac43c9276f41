"""`unocclude measures`: what a recovered motion measures, each with its interval."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..table import Table, percent
from . import options as o
from .arm_output import arms_figures, say_arm
from .load import damage, load_recoveries
from .output import (
    check_outputs,
    part_of,
    print_notes,
    progress_bar,
    say,
    say_written,
    show,
    write_csv,
    write_json,
)

if TYPE_CHECKING:
    from ..measures import BothArms, Measure, Measures, MeasureSettings
    from ..result import Recovery


def csv_rows(rows: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[Sequence[object]]:
    """One row per measure: recording, side, body, then the fields of a measure."""
    from ..measures import Measure

    names = [each.name for each in fields(Measure)]
    yield ["recording", "side", "body", *names]
    sources = [(one.name, one.side, one.body, one.rows) for one in rows]
    sources += [(both.left.name, "both", both.left.body, both.rows) for both in pairs]
    for name, side, body, own in sources:
        yield from ([name, side, body, *(getattr(row, each) for each in names)] for row in own)


def _table(title: str, first: str, rows: Sequence[Measure]) -> Table:
    """Measures that are known, with their intervals, as pages write them."""
    from ..evaluation.words import worded

    cells = []
    for row in rows:
        if not row.is_known:
            continue
        recovered = percent(row.recovered_share) or "-"
        if row.note:
            recovered += f" ({percent(row.untrusted_share)} not trusted)"
        cells.append((row.name, worded(row.key, row.value, row.unit), _interval(row), recovered))
    return Table(title, (first, "value", "95 % interval", "recovered"), cells)


def _interval(row: Measure) -> str:
    from ..evaluation.words import interval, worded

    if not row.has_interval:
        return "-"
    low, high = (worded(row.key, end, row.unit) for end in (row.low, row.high))
    if low == high:
        return low
    return f"{low} to {high}" if row.key.endswith("_reached") else interval(row.low, row.high, row.unit)


def measures(
    result: o.Result,
    config_file: Annotated[o.File, o.value("M.toml", "Thresholds (docs/measures.md).", "--config")] = None,
    csv: Annotated[Path | None, o.value("FILE", "Also write every measure as a row.")] = None,
    report: o.Report = None,
    json_file: o.Json = None,
    force: o.Force = False,
    side: o.Side = None,
    body: o.Body = None,
    processes: o.Processes = None,
) -> None:
    """Measure range of motion, reach, speed, smoothness.

    For the session, each hand movement and each repetition of an exercise, with intervals from the motions
    that `unocclude smooth` drew; with both arms also their symmetry. No diagnosis: the numbers describe a
    motion.

    Example: unocclude measures out.mcap --csv measures.csv --json measures.json
    """
    from ..measures import MeasureSettings
    from .config import read_settings

    check_outputs(force, [csv, report, json_file], [result, config_file])
    settings = read_settings(config_file, MeasureSettings)
    recoveries = load_recoveries(result, side, body)
    rows, pairs = measured(recoveries, settings, processes or 0)
    if report is not None:
        from ..report.measures import measures_page

        measures_page(rows, pairs).write(report, force)
    write_csv(csv, csv_rows(rows, pairs), force)
    figures = arms_figures(recoveries, [one.as_dict() for one in rows])
    if pairs:
        figures["symmetry"] = [{"body": both.left.body, "measures": both.as_dict()} for both in pairs]
    write_json(json_file, figures, force)
    for recovery, one in zip(recoveries, rows, strict=True):
        say_arm(recovery, len(recoveries))
        print_arm(one, damage(recovery.notes))
    for both in pairs:
        of = "" if both.left.body is None else f" of body {both.left.body}"
        title = f"Right arm{of} against left: 0 = alike, above it the right has more"
        show(_table(title, "symmetry", both.rows))
    say_written(csv, report, json_file)


def measured(
    recoveries: list[Recovery], settings: MeasureSettings, processes: int
) -> tuple[list[Measures], list[BothArms]]:
    """The measures of each arm, and the comparison of each person's two arms."""
    from ..measures.measuring import Measuring, measures_of
    from ..measures.symmetry import both_arms

    done: list[Measuring] = []
    with progress_bar("measuring") as progress:
        for number, recovery in enumerate(recoveries):
            of_arm = part_of(progress, number, len(recoveries))
            done.append(Measuring.of(recovery, settings, processes, of_arm))
        progress(1.0, "done")
    pairs = []
    for body in dict.fromkeys(one.recovery.body for one in done):
        arms = [one for one in done if one.recovery.body == body]
        by_side = {one.recovery.side: one for one in arms}
        if len(arms) == 2 and by_side.keys() == {"left", "right"}:
            pairs.append(both_arms(by_side["left"], by_side["right"]))
    return [measures_of(one) for one in done], pairs


def print_arm(one: Measures, damaged: list[str]) -> None:
    """An arm's verdict, table and notes; what is not to be trusted is said first.

    Zones of angles are left to `--csv` and `--json`.
    """
    if one.trusted is False:
        say(f"{one.verdict} The measures below are those of an answer that is not to be trusted.")
    shown = [row for row in one.session if "_zone_" not in row.key]
    show(_table(f"{one.name}, {one.arm_label}: the session", "measure", shown))
    reasons: dict[str, dict[str, None]] = {}
    for row in one.session:
        if not row.is_known and row.note:
            reasons.setdefault(row.note, {})[row.name.partition(",")[0]] = None
    for reason, names in reasons.items():
        say(f"not measured: {', '.join(names)}. {reason}")
    say(f"{len(one.movements)} movements, {len(one.repetitions)} repetitions: --csv, --json and the report")
    print_notes([*damaged, *one.notes])
