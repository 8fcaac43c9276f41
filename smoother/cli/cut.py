"""`unocclude cut`: parts of a recording, by time or by a table of trials."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from .options import ANY_ARM, ArmSelection, Force, Json, RecordingPath
from .output import check_mcap, check_outputs, print_notes, print_table, say, write_json

Start = Annotated[
    float | None,
    typer.Option("--from", metavar="S", help="Start of the part, s.  [default: the recording's start]"),
]
End = Annotated[
    float | None,
    typer.Option("--to", metavar="S", help="End of the part, s.  [default: the recording's end]"),
]
Trials = Annotated[
    Path | None,
    typer.Option("--trials", metavar="TRIALS.csv", help="Table of parts: name, start_s, end_s [, label]."),
]
Labels = Annotated[
    list[str] | None,
    typer.Option("--label", metavar="TEXT", help="Only parts of --trials with this label; may be repeated."),
]
Part = Annotated[
    Path,
    typer.Option(
        "-o", "--output", metavar="FILE", help="The part; a folder with --trials.", show_default=False
    ),
]
#: More parts than this are not listed.
MOST_ROWS = 25


def cut(
    recording_file: RecordingPath,
    output: Part,
    from_s: Start = None,
    to_s: End = None,
    trials_file: Trials = None,
    labels: Labels = None,
    arm: ArmSelection = ANY_ARM,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Cut a recording by time, or into the trials of a table.

    Times are seconds of the recording, as `smooth` prints them for gaps. All topics are copied unchanged,
    images too; camera calibrations and transforms that were recorded once are copied into every part.
    Leave some seconds of visible arm before and after each gap: a part is recovered without the rest.
    """
    from ..io.recording.cut_file import Part as PartOfFile
    from ..io.recording.cut_file import cut_file, read_trials

    if trials_file is None:
        if from_s is None and to_s is None:
            raise typer.BadParameter("choose a part: --from S, --to S, or --trials TRIALS.csv")
        if labels:
            raise typer.BadParameter("--label chooses among --trials; give the table too")
        check_mcap(output)
        start_s, end_s = from_s or 0.0, math.inf if to_s is None else to_s
        if not start_s < end_s:
            raise typer.BadParameter(f"--to {end_s:g} is not after --from {start_s:g}")
        parts = [PartOfFile(output.stem, output, start_s, end_s)]
    else:
        if from_s is not None or to_s is not None:
            raise typer.BadParameter(
                "--from and --to are for one part; the table of --trials has its own times"
            )
        trials = read_trials(trials_file, labels or ())
        parts = [PartOfFile(t.name, output / f"{t.name}.mcap", t.start_s, t.end_s) for t in trials]
        if output.exists() and not output.is_dir():
            raise typer.BadParameter(f"{output} is a file; with --trials name a folder")
        output.mkdir(parents=True, exist_ok=True)
    check_outputs(force, [*(part.path for part in parts), json_file], [recording_file, trials_file])
    written, notes = cut_file(recording_file, parts, force=force, **arm.reading())
    write_json(json_file, {"parts": written, "notes": notes}, force)
    rows = [
        (
            each["name"],
            f"{part.from_s:.2f}",
            "the end" if part.to_s == math.inf else f"{part.to_s:.2f}",
            sum(each["messages"].values()),  # type: ignore[attr-defined]
            each["file"],
        )
        for part, each in zip(parts, written, strict=True)
    ]
    print_table(
        f"Parts of {recording_file}", ("name", "from, s", "to, s", "messages", "file"), rows[:MOST_ROWS]
    )
    if len(rows) > MOST_ROWS:
        say(f".. and {len(rows) - MOST_ROWS} parts more; --json has them all")
    print_notes(notes)
