"""`unocclude import describe`: a recording.toml for any table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Force, Json
from .output import check_outputs, say, write_json


def describe(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="Any table of text.", show_default=False)],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Of the IMU in recording.toml.")
    ] = "forearm_right",
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Look at a table and print a recording.toml for `import csv`: a guess, its reasons, what is unsure."""
    from ..errors import RecordingError
    from ..io.devices.describe_table import guess_of, toml_of
    from ..io.devices.registry import recognise
    from ..io.tables.file_head import first_rows, read_head
    from ..io.tables.text_table import read_sheet

    check_outputs(force, [json_file], [path])
    head = read_head(path)
    importer = recognise(head)
    if importer is not None:
        option = "--skeleton" if importer.kind == "skeleton" else "--imu"
        say(f"# {path.name} is recognised as {importer.title}: unocclude import files {option} {path} ..")
    try:
        sheet = read_sheet(path)
    except RecordingError:
        if importer is None:
            raise
        write_json(json_file, {"format": importer.key, "recording_toml": None, "unsure": []}, force)
        return
    guess = guess_of(sheet)
    if not guess.kind:
        raise RecordingError(
            f"{path} holds {sheet.layout.width} columns and {len(sheet)} rows, and none of them look like an"
            f" accelerometer's, a gyroscope's or a joint's; it begins: {first_rows(head)}."
        )
    text = toml_of(path, guess, name)
    say(f"# {len(sheet):,} rows, {sheet.layout.width} columns, parted by {sheet.layout.separator!r}")
    for sentence in guess.unsure:
        say(f"# unsure: {sentence}")
    say(text)
    figures = {
        "format": None if importer is None else importer.key,
        "kind": guess.kind,
        "recording_toml": text,
        "columns": guess.columns,
        "keys": guess.keys,
        "reasons": guess.reasons,
        "unsure": guess.unsure,
    }
    write_json(json_file, figures, force)
