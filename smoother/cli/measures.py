"""`unocclude measures`, `progress`: what a recovered motion measures, and how that changes over sessions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..errors import UnoccludeError
from . import options as o
from .load import ResultInput
from .output import Out, print_notes, progress_bar, say, show, write_csv

if TYPE_CHECKING:
    from ..evaluation.progress import PersonProgress
    from ..measures import BothArms, Measures


def csv_rows(rows: Sequence[Measures], pairs: Sequence[BothArms]) -> Iterator[Sequence[object]]:
    """One row per measure: recording, side, body, then the fields of a measure."""
    from ..measures import Measure

    names = [each.name for each in fields(Measure)]
    yield ["recording", "side", "body", *names]
    sources = [(one.name, one.side, one.body, one.rows) for one in rows]
    sources += [(both.left.name, "both", both.left.body, both.rows) for both in pairs]
    for name, side, body, own in sources:
        yield from ([name, side, body, *(getattr(row, each) for each in names)] for row in own)


def measures(
    result: o.Result,
    arms: ResultInput,
    out: Out,
    config_file: Annotated[o.File, o.value("M.toml", "Thresholds (docs/measures.md).", "--config")] = None,
    csv: o.Csv = None,
    report: o.Report = None,
    processes: o.Processes = None,
) -> None:
    """Measure range of motion, reach, speed, smoothness.

    For the session, each hand movement and each repetition of an exercise, with intervals from the motions
    that `unocclude smooth` drew; with both arms also their symmetry. No diagnosis: the numbers describe a
    motion.

    Example: unocclude measures out.mcap --csv measures.csv --json measures.json
    """
    from ..evaluation.words import measure_table
    from ..io.mcap.messages import damage
    from ..measures import MeasureSettings
    from ..measures.symmetry import measure_arms
    from .config import read_settings

    settings = read_settings(config_file, MeasureSettings)
    recoveries = arms.load(result)
    with progress_bar("measuring") as progress:
        rows, pairs = measure_arms(recoveries, settings, processes or 0, progress)
    if report is not None:
        from ..report.measures import measures_page

        measures_page(rows, pairs).write(report, out.force)
    write_csv(csv, csv_rows(rows, pairs), out.force)
    symmetry = [{"body": both.left.body, "measures": both.as_dict()} for both in pairs]
    out.arms(
        recoveries,
        [one.as_dict() for one in rows],
        lambda number: print_arm(rows[number], damage(recoveries[number].notes)),
        **({"symmetry": symmetry} if pairs else {}),
    )
    for both in pairs:
        of = "" if both.left.body is None else f" of body {both.left.body}"
        title = f"Right arm{of} against left: 0 = alike, above it the right has more"
        show(measure_table(title, "symmetry", both.rows))
    out.end(csv, report)


def print_arm(one: Measures, damaged: list[str]) -> None:
    """An arm's verdict, table and notes; what is not to be trusted is said first.

    Zones of angles are left to `--csv` and `--json`.
    """
    from ..evaluation.words import measure_table

    if one.trusted is False:
        say(f"{one.verdict} The measures below are those of an answer that is not to be trusted.")
    shown = [row for row in one.session if "_zone_" not in row.key]
    show(measure_table(f"{one.name}, {one.arm_label}: the session", "measure", shown))
    unknown = [row for row in one.session if not row.is_known and row.note]
    for reason in dict.fromkeys(row.note for row in unknown):
        names = dict.fromkeys(row.name.partition(",")[0] for row in unknown if row.note == reason)
        say(f"not measured: {', '.join(names)}. {reason}")
    say(f"{len(one.movements)} movements, {len(one.repetitions)} repetitions: --csv, --json and the report")
    print_notes([*damaged, *one.notes])


_sessions = (
    "Person and date of each recording: file, person, session or date [, task]; without it they are taken"
    " from folders: PERSON/SESSION.mcap or PERSON/SESSION/TASK.mcap."
)
_changes = (
    "Minimal detectable changes: what `validate --json` or `progress --reliability --json` wrote, or a .toml"
    " with [mdc95]."
)


def progress(
    study: Annotated[Path, o.argument("STUDY", "The folder that `unocclude batch` wrote.")],
    out: Out,
    person: Annotated[o.Text, o.value("NAME", "Only this person.")] = None,
    sessions: Annotated[o.File, o.value("FILE.csv", _sessions)] = None,
    mdc: Annotated[o.File, o.value("FILE", _changes)] = None,
    reliability: Annotated[bool, o.option("No true change: print ICC, SEM, MDC.", "--reliability")] = False,
    measure: Annotated[o.Texts, o.value("KEY", "Only this measure; may be repeated.")] = None,
    report: o.Report = None,
    csv: o.Csv = None,
) -> None:
    """Show how a person's measures changed over sessions.

    A change is clear where it is larger than the 95 % interval of the difference and, with --mdc, than the
    minimal detectable change. The study comes from `batch --measures`.

    Example: unocclude progress recovered --person p12 --report p12.html
    """
    from ..evaluation.measure_agreement import read_detectable
    from ..evaluation.progress import (
        CSV_COLUMNS,
        FEWEST_PERSONS,
        SESSIONS_VARY,
        reliability_of,
        reliability_table,
    )
    from ..report.progress import progress_page
    from ..study.progress import progress_of, read_rows, sessions_of

    if not study.is_dir():
        raise UnoccludeError(f"{study} is not a folder; name the one that `unocclude batch` wrote")
    detectable = None if mdc is None else read_detectable(mdc)
    rows = read_rows(study)
    attendances, left_out = sessions_of(study, rows, sessions)
    persons = progress_of(rows, attendances, detectable)
    names = ", ".join(each.person for each in persons[:20])
    persons = [each for each in persons if person in (None, each.person)]
    if person is not None and not persons:
        raise UnoccludeError(f"the study has no person {person}; it has: {names}")
    known = {series.key for each in persons for series in each.series}
    wanted = set(measure or known)
    if known and (unknown := ", ".join(sorted(wanted - known))):
        examples = ", ".join(series.key for series in persons[0].main[:5])
        raise UnoccludeError(f"the study has no measure {unknown}; measures are as {examples}")
    persons = [replace(p, series=tuple(one for one in p.series if one.key in wanted)) for p in persons]
    if report is not None and len(persons) > 1:
        raise UnoccludeError(f"a page is of one person; choose one with --person: {names}")
    if report is not None:
        progress_page(persons[0]).write(report, out.force)
    repeated = reliability_of(persons) if reliability else []
    if reliability and not repeated:
        raise UnoccludeError(
            f"--reliability needs {FEWEST_PERSONS} persons with two sessions each; no measure has them"
        )
    figures: dict[str, object] = {"persons": [each.to_dict() for each in persons], "left_out": left_out}
    if reliability:
        figures["reliability"] = repeated
    write_csv(csv, (CSV_COLUMNS, *(row for each in persons for row in each.csv_rows())), out.force)
    out.json(figures)
    for each in persons:
        print_person(each)
    if reliability:
        show(reliability_table(repeated))
    print_notes(left_out)
    say(f"This is not a diagnosis. {SESSIONS_VARY}.")
    out.end(report, csv)


def print_person(progress: PersonProgress) -> None:
    """Print a person's table, and what takes no part."""
    say(f"--- {progress.person}: {len(progress.sessions)} sessions ({', '.join(progress.sessions)}) ---")
    if len(progress.sessions) > 1:
        first, *_, last = progress.sessions
        show(progress.table(f"Last session ({last}) against the first ({first})"))
    for sentence in progress.sentences():
        say(f"{sentence}.")
    print_notes([*progress.notes, *progress.limits, *progress.left_out])
