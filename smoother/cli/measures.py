"""`unocclude measures`: what a recovered motion measures, each with its interval."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .load import damage, load_recoveries
from .options import Body, Force, Json, Report, Result, Side, one_side
from .output import check_outputs, print_notes, say, say_written, write_json
from .several_figures import arms_figures, say_arm

if TYPE_CHECKING:
    from ..measures import BothArms, Measures, MeasureSettings
    from ..result import Recovery


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
    report: Report = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Measure a result: ranges of motion, reach, speed and smoothness, each with its 95 % interval.

    Of the session, of each movement of the hand, and of each repetition of an exercise. The intervals need
    drawn motions (`unocclude smooth --draws 64`). With both arms of a person also how alike they are. No
    diagnosis: the numbers describe a motion.
    """
    from ..measures import MeasureSettings
    from .config_file import read_settings

    check_outputs(force, [csv_file, report, json_file], [result, config_file])
    settings = read_settings(config_file, MeasureSettings)
    recoveries = load_recoveries(result, one_side(side), body)
    rows, pairs = measured(recoveries, settings)
    if report is not None:
        from ..report.measures import write_measures_page

        write_measures_page(report, rows, pairs, force=force)
    if csv_file is not None:
        from .measure_rows import write_csv

        write_csv(csv_file, rows, pairs, force)
    figures = arms_figures(recoveries, [one.as_dict() for one in rows])
    if pairs:
        figures["symmetry"] = [{"body": both.left.body, "measures": both.as_dict()} for both in pairs]
    write_json(json_file, figures, force)
    for recovery, one in zip(recoveries, rows, strict=True):
        say_arm(recovery, len(recoveries))
        print_arm(one, damage(recovery.notes))
    _print_symmetry(pairs)
    say_written(csv_file, report, json_file)


def measured(recoveries: list[Recovery], settings: MeasureSettings) -> tuple[list[Measures], list[BothArms]]:
    """The measures of each arm, and the comparison of each person's two arms."""
    from ..measures.measuring import Measuring, measures_of
    from ..measures.symmetry import both_arms
    from .progress import progress_bar

    done: list[Measuring] = []
    with progress_bar("measuring") as progress:
        for number, recovery in enumerate(recoveries):
            progress(number / len(recoveries), recovery.arm_label)
            done.append(Measuring.of(recovery, settings))
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
    from .measure_rows import print_places, print_session

    if one.trusted is False:
        say(f"{one.verdict} The measures below are those of an answer that is not to be trusted.")
    print_session(one)
    print_places("Movements of the hand", one.movements, "movement", one)
    print_places("Repetitions", one.repetitions, "repetition", one)
    print_notes([*damaged, *one.notes])


def _print_symmetry(pairs: list[BothArms]) -> None:
    from .measure_rows import print_symmetry

    for both in pairs:
        print_symmetry(both)
