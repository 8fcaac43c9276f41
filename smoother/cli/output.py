"""What commands print and write: tables, notes, figures as JSON, outputs checked beforehand."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from ..runtime.plain_values import plain
from ..runtime.printable import printable


def check_outputs(force: bool, outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Refuse outputs that could not be written in the end, before any work is done for them.

    Raises
    ------
    UnoccludeError
        An output exists and `--force` is not given, two are one file, one is an input (under this name or
        another: a link), or an input is no file.
    """
    from ..runtime.atomic import check_output
    from ..runtime.inputs import check_input
    from ..runtime.leftovers import sweep
    from ..runtime.stream_output import is_stream

    read: set[object] = set()
    for path in (path for path in inputs if path is not None):
        check_input(path)
        read |= _identity(path)
    written: set[object] = set()
    for path in (path for path in outputs if path is not None):
        if is_stream(path):
            continue
        keys = _identity(path)
        if keys & read:
            raise UnoccludeError(f"{path} is read by this command; give another name to write to")
        if keys & written:
            raise UnoccludeError(f"{path} is named for two outputs; give each a name of its own")
        written |= keys
        check_output(path, force)
        sweep(path.resolve().parent)


def _identity(path: Path) -> set[object]:
    """By what two names show to be one file: where links lead, and the file itself if it is there."""
    try:
        about = path.stat()
    except (OSError, ValueError):
        return {os.path.realpath(path)}
    return (
        {os.path.realpath(path), (about.st_dev, about.st_ino)} if about.st_ino else {os.path.realpath(path)}
    )


def write_json(path: Path | None, figures: dict[str, Any], force: bool) -> None:
    """Write figures as JSON; numbers that are not finite become null."""
    if path is None:
        return
    from ..runtime.atomic import writing

    with writing(path, force) as temporary:
        temporary.write_text(json.dumps(plain(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table; columns of numbers stand to the right."""
    from rich.table import Table
    from rich.text import Text

    cells = [[printable(cell(value), lines=True) for value in row] for row in rows]
    # texts, not strings: a name in brackets is no markup
    table = Table(title=Text(printable(title)), title_justify="left", title_style="bold")
    for place, column in enumerate(columns):
        numbers = all(_is_number(row[place]) for row in cells)
        header = Text(printable(column))
        table.add_column(header, justify="right" if numbers else "left", overflow="fold")
    for row in cells:
        table.add_row(*[Text(text) for text in row])
    console().print(table)


def _is_number(text: str) -> bool:
    try:
        float(text.strip("-+ ") or 0)
    except ValueError:
        return False
    return True


def print_notes(notes: Iterable[str]) -> None:
    """Print what the user must know, a line each, none twice."""
    for note in dict.fromkeys(notes):
        say(f"note: {note}")


def say(text: str) -> None:
    """Print a line on stdout, or several; nothing of it acts on the terminal."""
    print(printable(text, lines=True))


def say_written(*paths: Path | None) -> None:
    """Print what was written, if anything."""
    if files := [str(path) for path in paths if path is not None]:
        say(f"written: {', '.join(files)}")


def console() -> Any:
    """Rich's console on stdout; wide enough for a table where stdout is no terminal."""
    from rich.console import Console

    usual = Console()
    return usual if usual.is_terminal else Console(width=120)


def cell(value: object) -> str:
    """A value as a table shows it; "-" where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def centimetres(metres: float | None) -> str:
    """A length for a table, in cm."""
    return "-" if metres is None or not math.isfinite(metres) else f"{100 * metres:.2f}"
