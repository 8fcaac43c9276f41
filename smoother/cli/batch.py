"""`unocclude batch`: many recordings, on this machine or a Dask cluster."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..table import tabulated
from . import options as o
from .load import Which
from .output import (
    check_outputs,
    end_strictly,
    print_notes,
    progress_bar,
    say,
    say_more,
    say_written,
    show,
    write_json,
)

if TYPE_CHECKING:
    import pyarrow as pa

    from ..study.folder import Row
    from ..study.run import Tally


#: Rows of the tables that are printed at the end.
MOST_WORST, MOST_FAILURES = 10, 25
#: Rows that `--json` holds at most; all of them are among the results.
MOST_JSON = 10_000
#: Hours of recording take minutes; what takes half a day hangs.
TIME_LIMIT_MINUTES = 720.0
#: What the first lines of a study's page, and of its figures, hold.
_PAGE_MARKS = b'content="unocclude', b"<title>Study</title>"
_FIGURES_MARKS = b'"recordings"', b'"done_before"'


#: `--report` alone: the page is in the study's folder.
ALONE = {"--report": ""}
_source = (
    "A folder of .mcap files, a pattern in quotation marks, or a text file with one recording per line"
    " (optionally a tab and its calibration)."
)


def batch(
    source: Annotated[str, o.argument("FOLDER|PATTERN|LIST", _source)],
    output: o.FolderOutput,
    which: Which,
    calibration_file: o.Calibration = None,
    report: Annotated[
        o.Text, o.value("[OUT.html]", "Also write the study's page, in FOLDER if alone.")
    ] = None,
    measures: Annotated[bool, o.option("Also measure each arm, for `progress`.", "--measures")] = False,
    strict: o.Strict = False,
    json_file: o.Json = None,
    force: Annotated[bool, o.option("Use a folder with other files; recompute all.", "--force")] = False,
    config_file: o.ConfigFile = None,
    scheduler: Annotated[
        o.Text, o.rare_value("tcp://HOST:PORT", "Use this Dask scheduler's workers.")
    ] = None,
    processes: o.Processes = None,
    time_limit: Annotated[
        float, o.rare_value("MINUTES", "Longer ones fail here; 0 = no limit.", min=0)
    ] = TIME_LIMIT_MINUTES,
    draws: o.Draws = None,
) -> None:
    """Recover many recordings; run again to continue.

    Results are written to FOLDER under the recordings' names, with one row of figures each in
    FOLDER/results/*.parquet.
    One failing recording does not stop the others; the exit code is 1 then. With --strict it is 3 if all
    were recovered and a result is not to be trusted.

    Example: unocclude batch sessions -o recovered --calibration arm.toml --report
    """
    from ..measures.definitions import FEWEST_DRAWS
    from ..result.draws import USUAL_DRAWS
    from ..study.inputs import find_entries
    from ..study.run import StudySettings, cluster, local, run_study, study_folder
    from .config import read_config

    too_few = 0 < (draws or 0) < FEWEST_DRAWS
    o.refuse(
        {
            "--processes is for this machine; the workers of --scheduler decide": scheduler
            and processes is not None,
            "--draws is for the intervals of the measures; give --measures too": draws is not None
            and not measures,
            f"--draws {draws} are too few for the intervals of the measures: {FEWEST_DRAWS} are needed, 64"
            " are usual, 0 = no intervals": too_few,
        }
    )
    folder = study_folder(output)
    page = None if report is None else Path(report) if report else folder.path / "report.html"
    settings = StudySettings(
        config=read_config(config_file),
        selection=which.chosen,
        calibration="" if calibration_file is None else str(calibration_file.absolute()),
        again=force,
        time_limit_s=60 * time_limit,
        measures=measures,
        draws=0 if not measures else USUAL_DRAWS if draws is None else draws,
    )
    entries = find_entries(source, folder.path)
    inside = page is not None and page.resolve().is_relative_to(folder.path.resolve())
    recordings = (Path(entry.path) for entry in entries if page or json_file)
    # what is not a file, such as a pipe, fails by itself and stops no other
    inputs = [calibration_file, config_file, *(path for path in recordings if os.path.isfile(path))]
    check_outputs(True, [None if inside else page, json_file], inputs)
    _refuse_others(page, _PAGE_MARKS, force)
    _refuse_others(json_file, _FIGURES_MARKS, force)
    workers = local(processes or 0) if scheduler is None else cluster(scheduler)
    try:
        with progress_bar("recovering") as bar:

            def progress(tally: Tally, row: Row | None) -> None:
                now = "" if row is None or row["status"] != "failed" else f"; {row['recording']} failed"
                text = f"{tally.ended} of {tally.total}, {tally.failed} failed{now}"
                bar(tally.ended / max(tally.total, 1), text)

            tally, rows = run_study(entries, folder, settings, workers, progress, force)
    except KeyboardInterrupt:
        typer.echo("unocclude: interrupted; the same command continues where this one stopped", err=True)
        raise typer.Exit(1) from None
    if page is not None:
        from ..report.pages import write_study

        write_study(rows, page, folder.path, force=True)
    figures = study_figures(rows, tally)
    figures |= {"folder": folder.path.name, "rows": rows.slice(0, MOST_JSON).to_pylist()}
    write_json(json_file, figures, True)
    _print(rows, tally, figures)
    print_notes(tally.notes)
    say_written(folder.path, page, json_file)
    if figures["failed"]:
        raise typer.Exit(1)
    if strict:
        end_strictly(rows["trusted"].to_pylist())


def _refuse_others(path: Path | None, marks: Sequence[bytes], force: bool) -> None:
    """Refuse to replace another program's file; what an earlier run wrote has these marks, and is renewed."""
    from ..runtime.outputs import check_output

    if path is not None and path.is_file():
        with open(path, "rb") as file:
            start = file.read(1000)
        check_output(path, force or all(mark in start for mark in marks))


def study_figures(rows: pa.Table, tally: Tally) -> dict[str, Any]:
    """The figures of a study as plain values."""
    import pyarrow.compute as pc

    failed = rows.filter(pc.equal(rows["status"], "failed"))
    distrusted = rows.filter(pc.equal(rows["trusted"], False))  # failed ones have none
    partly = rows.filter(pc.and_(pc.equal(rows["trusted"], True), pc.greater(rows["gaps_untrusted"], 0)))
    return {
        "recordings": tally.total,
        "done": len(rows) - len(failed),
        "failed": len(failed),
        "not_trusted": len(distrusted),
        "partly_trusted": len(partly),
        "computed": tally.computed,
        "done_before": tally.before,
        "seconds": tally.seconds,
        "computed_s": tally.recorded_s,
        "duration_s": pc.sum(rows["duration_s"]).as_py() or 0.0,
        "occluded_s": pc.sum(rows["occluded_s"]).as_py() or 0.0,
        "untrusted": distrusted.select(["recording", "verdict"]).slice(0, MOST_JSON).to_pylist(),
        "failures": failed.select(["recording", "error"]).slice(0, MOST_JSON).to_pylist(),
    }


def _print(rows: pa.Table, tally: Tally, figures: dict[str, Any]) -> None:
    """Print what came of a study, the worst recordings first."""
    import pyarrow.compute as pc

    from ..evaluation.summary import trust_word, worst_of

    times = tally.recorded_s / tally.seconds if tally.computed else 0.0
    speed = f", {times:.1f} times real time by all processes together" if tally.computed else ""
    say(
        f"{tally.total} recordings: {tally.computed} recovered now in {tally.seconds:.0f} s{speed};"
        f" {tally.before} were dealt with before; {figures['failed']} failed in all"
    )
    keys = "recording trusted sigma_max_m gaps gap_longest_s occluded_s duration_s notes"
    done = rows.filter(pc.equal(rows["status"], "done"))
    worst = worst_of(done.select([*keys.split(), "gaps_untrusted"]), MOST_WORST).to_pylist()
    for row in worst:
        row["trusted"] = trust_word(row["trusted"], row["gaps"], row["gaps_untrusted"])
    title = "Recordings that are not to be trusted, then the least certain (sigma = one standard deviation)"
    show(tabulated(title, worst, keys))
    rest = "more; the results have them all"
    title = f"{figures['not_trusted']} of {figures['done']} results are not to be trusted"
    show(tabulated(title, figures["untrusted"], "recording verdict"), MOST_FAILURES, rest)
    damaged = [note for each in done["damage"].to_pylist() for note in each or []]
    print_notes(damaged[:MOST_FAILURES])
    say_more(len(damaged), MOST_FAILURES, f"damaged files {rest}")
    show(tabulated("Failed", figures["failures"], "recording error=why"), MOST_FAILURES, f"failures {rest}")
