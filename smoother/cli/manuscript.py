"""`unocclude methods`: the methods section of a paper, from what a result states of itself."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from .arm_output import warn
from .load import load_recoveries
from .options import Body, Force, Json, Result, Side, one_side
from .output import check_outputs, say_written, write_json

MARKUPS = ("text", "markdown", "latex")
#: By the ending of the file that is written.
_BY_ENDING = {".md": "markdown", ".tex": "latex", ".txt": "text"}


def methods(
    result: Result,
    markup: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="|".join(MARKUPS),
            help="Markup.  [default: by the ending of -o, else text]",
            show_default=False,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="What to write, instead of printing it."),
    ] = None,
    side: Side = None,
    body: Body = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Write the methods section of a paper: text, table, references.

    It states only what the file contains: sensors and rates, method and version, calibration,
    clocks, gaps, uncertainty, self-check, settings that are not the defaults. What the ISB's recommendations
    on reporting IMUs require beyond that is listed for you to fill in.
    """
    from ..io.result.read import read_origin
    from ..manuscript import arm_facts, methods_document, rendered
    from ..runtime.outputs import writing

    if markup is not None and markup not in MARKUPS:
        raise typer.BadParameter(f"--format is one of {', '.join(MARKUPS)}, not '{markup}'")
    chosen = markup or _BY_ENDING.get("" if output is None else output.suffix.lower(), "text")
    check_outputs(force, [output, json_file], [result])
    recoveries = load_recoveries(result, one_side(side), body)
    origin = read_origin(result)
    title = origin.title if origin.is_simulated else ""
    facts = [arm_facts(recovery, origin.version, title) for recovery in recoveries]
    document = methods_document(facts)
    text = rendered(document, chosen)
    if output is None:
        print(text, end="")
    else:
        with writing(output, force) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    figures = {
        "arms": [asdict(one) for one in facts],
        "to_fill_in": list(document.to_fill_in),
        "references": [asdict(each) for each in document.references],
        "text": text,
    }
    write_json(json_file, figures, force)
    warn(recoveries)
    if output is not None:
        say_written(output, json_file)
