"""`unocclude progress`: a person's measures over the sessions of a study."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ..errors import UnoccludeError
from . import options as o
from .output import check_outputs, print_notes, say, say_written, show, write_csv, write_json

if TYPE_CHECKING:
    from ..evaluation.progress import PersonProgress

NO_DIAGNOSIS = (
    "This is not a diagnosis: a clear change is one that the measurement error does not explain; a person"
    " also varies from day to day."
)


def progress(
    study: Annotated[Path, o.argument("STUDY", "The folder that `unocclude batch` wrote.")],
    person: Annotated[str | None, o.value("NAME", "Only this person.")] = None,
    sessions: Annotated[
        Path | None,
        o.value(
            "FILE.csv",
            "Person and date of each recording: file, person, session or date [, task]; without it"
            " they are taken from folders: PERSON/SESSION.mcap or PERSON/SESSION/TASK.mcap.",
        ),
    ] = None,
    mdc: Annotated[
        Path | None,
        o.value(
            "FILE",
            "Minimal detectable changes: what `validate --json` or `progress --reliability --json`"
            " wrote, or a .toml with [mdc95].",
        ),
    ] = None,
    reliability: Annotated[bool, o.option("No true change: print ICC, SEM, MDC.", "--reliability")] = False,
    measure: Annotated[o.Texts, o.value("KEY", "Only this measure; may be repeated.")] = None,
    report: o.Report = None,
    json_file: o.Json = None,
    csv: Annotated[Path | None, o.value("FILE", "Also write all values as a table.")] = None,
    force: o.Force = False,
) -> None:
    """Show how a person's measures changed over sessions.

    A change is clear where it is larger than the 95 % interval of the difference and, with --mdc, than the
    minimal detectable change. The study comes from `batch --measures`.

    Example: unocclude progress recovered --person p12 --report p12.html
    """
    from ..evaluation.measure_agreement import read_detectable
    from ..evaluation.progress import CSV_COLUMNS, FEWEST_PERSONS, reliability_of, reliability_table
    from ..report.progress import progress_page
    from ..study.progress import progress_of, read_rows, sessions_of

    if not study.is_dir():
        raise UnoccludeError(f"{study} is not a folder; name the one that `unocclude batch` wrote")
    check_outputs(force, [report, json_file, csv], [sessions, mdc])
    detectable = None if mdc is None else read_detectable(mdc)
    rows = read_rows(study)
    attendances, left_out = sessions_of(study, rows, sessions)
    persons = progress_of(rows, attendances, detectable)
    if person is not None:
        has = ", ".join(each.person for each in persons[:20])
        persons = [each for each in persons if each.person == person]
        if not persons:
            raise UnoccludeError(f"the study has no person {person}; it has: {has}")
    known = {series.key for each in persons for series in each.series}
    if unknown := ", ".join(sorted({*(measure or ())} - known)) if known else "":
        examples = ", ".join(series.key for series in persons[0].main[:5])
        raise UnoccludeError(f"the study has no measure {unknown}; measures are as {examples}")
    if measure:
        persons = [
            replace(each, series=tuple(one for one in each.series if one.key in measure)) for each in persons
        ]
    if report is not None:
        if len(persons) > 1:
            names = ", ".join(each.person for each in persons[:20])
            raise UnoccludeError(f"a page is of one person; choose one with --person: {names}")
        progress_page(persons[0]).write(report, force)
    repeated = reliability_of(persons) if reliability else []
    if reliability and not repeated:
        raise UnoccludeError(
            f"--reliability needs {FEWEST_PERSONS} persons with two sessions each; no measure has them"
        )
    figures: dict[str, object] = {"persons": [each.to_dict() for each in persons], "left_out": left_out}
    if reliability:
        figures["reliability"] = repeated
    write_json(json_file, figures, force)
    write_csv(csv, (CSV_COLUMNS, *(row for each in persons for row in each.csv_rows())), force)
    for each in persons:
        _print(each)
    if reliability:
        show(reliability_table(repeated))
    print_notes(left_out)
    say(NO_DIAGNOSIS)
    say_written(report, json_file, csv)


def _print(progress: PersonProgress) -> None:
    """Print a person's table, and what takes no part."""
    say(f"--- {progress.person}: {len(progress.sessions)} sessions ({', '.join(progress.sessions)}) ---")
    if len(progress.sessions) > 1:
        show(
            progress.table(
                f"Last session ({progress.sessions[-1]}) against the first ({progress.sessions[0]})"
            )
        )
        say(_counted(progress))
    elif progress.sessions:
        say("One session only: nothing can be compared.")
    print_notes([*progress.notes, *progress.limits, *progress.left_out])


def _counted(progress: PersonProgress) -> str:
    compared, clear = len(progress.compared), len(progress.clear)
    text = f"{clear} of {compared} measures changed clearly"
    if compared >= 5:
        together = sum(each.change.p_together < 0.05 for each in progress.clear if each.change is not None)
        text += (
            f"; about {0.05 * compared:.1f} would be called so by chance without any change, and"
            f" {together} of them remain clear after correction for their number (Holm)"
        )
    return f"{text}."
