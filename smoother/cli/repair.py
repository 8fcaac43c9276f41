"""`unocclude repair`: what is still in a damaged recording, as a whole one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import Force, Json
from .output import check_mcap, check_outputs, print_notes, print_table, say, say_written, write_json

if TYPE_CHECKING:
    from ..io.mcap.repair_container import RepairReport

Broken = Annotated[
    Path,
    typer.Argument(metavar="BROKEN.mcap", help="The damaged file; it is not changed.", show_default=False),
]
Whole = Annotated[
    Path, typer.Option("-o", "--output", metavar="WHOLE.mcap", help="Where to write.", show_default=False)
]


def repair(broken_file: Broken, output: Whole, json_file: Json = None, force: Force = False) -> None:
    """Write every complete message of a damaged MCAP file into a whole one, and list what was lost where.

    Messages stand in the order of their log times, behind a new index. Messages of chunks that fail their
    checksum are kept; the new file says so, and every command that reads it repeats it.
    """
    from ..io.mcap.repair_container import repair_container

    check_mcap(output)
    check_outputs(force, [output, json_file], [broken_file])
    report = repair_container(broken_file, output, force)
    print_losses(report)
    write_json(json_file, report.to_dict(), force)
    print_notes(report.notes)
    if report.attachments:
        say(f"note: {report.attachments} attachments were not carried over.")
    say_written(output, json_file)


def print_losses(report: RepairReport) -> None:
    """Print what was written by topic, and what was lost where."""
    from ..io.mcap.messages import plain_name

    rows = [
        (plain_name(name), report.messages.get(name, 0), report.missing.get(name, 0))
        for name in sorted({*report.messages, *report.missing})
    ]
    print_table(f"{report.source}: messages", ("topic", "written", "missing by its own count"), rows)
    if not report.losses:
        say("no message before the end is lost" if report.notes else "nothing damaged was met")
        return
    start = min((loss.first_ns for loss in report.losses if loss.first_ns is not None), default=0)
    lines = [
        (
            f"{loss.start} .. {loss.stop}",
            "-" if loss.first_ns is None else f"{(loss.first_ns - start) / 1e9:.3f}",
            "-" if loss.last_ns is None else f"{(loss.last_ns - start) / 1e9:.3f}",
            sum(loss.counts.values()) if loss.counts else "-",
            loss.what,
        )
        for loss in report.losses
    ]
    columns = ("bytes", "from, s", "to, s", "messages", "what")
    print_table("What is damaged (s after the first damage)", columns, lines[:MOST_ROWS])
    if len(lines) > MOST_ROWS:
        say(f".. and {len(lines) - MOST_ROWS} places more; --json has them all")


#: A table longer than this helps nobody on a terminal.
MOST_ROWS = 25
