"""What commands print and write: tables, notes, figures as JSON, outputs checked beforehand."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from ..runtime.printable import plain, printable

_TRUTH = "Simulated: what the calibration of these files should find."


def check_outputs(force: bool, outputs: Iterable[Path | None], inputs: Iterable[Path | None] = ()) -> None:
    """Refuse outputs that could not be written in the end, before any work is done for them.

    Raises
    ------
    UnoccludeError
        An output exists and `--force` is not given, two are one file, one is an input (under this name or
        another: a link), or an input is no file.
    """
    from ..runtime.inputs import check_input
    from ..runtime.outputs import check_output, is_stream, remove_stale_tempfiles

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
        remove_stale_tempfiles(path.resolve().parent)


def _identity(path: Path) -> set[object]:
    """By what two names show to be one file: where links lead, and the file itself if it is there."""
    try:
        about = path.stat()
    except (OSError, ValueError):
        return {os.path.realpath(path)}
    return (
        {os.path.realpath(path), (about.st_dev, about.st_ino)} if about.st_ino else {os.path.realpath(path)}
    )


#: Endings that say that a file is something else than MCAP; those of `unocclude export` first.
_OTHER_ENDINGS = ("csv", "trc", "mot", "c3d", "parquet")
_NO_RESULT = ("html", "json", "toml", "txt", "xlsx", "mat", "bag", "rrd", "sto", "osim", "npz")


def check_mcap(path: Path, exports: bool = False) -> None:
    """Refuse to write MCAP to a file whose ending says something else.

    `exports`: what is written is a result, which `unocclude export` writes in other formats.

    Raises
    ------
    UnoccludeError
        In one sentence, with the command that writes what the ending says.
    """
    ending = path.suffix.lower().removeprefix(".")
    if exports and ending in _OTHER_ENDINGS:
        mcap = path.with_suffix(".mcap")
        command = shlex.join(["unocclude", "export", str(mcap), "--format", ending, "-o", str(path)])
        raise UnoccludeError(f"{path}: the result is MCAP; write it to {mcap}, then `{command}`")
    if ending in (*_OTHER_ENDINGS, *_NO_RESULT):
        raise UnoccludeError(f"{path}: what is written is MCAP; name it {path.with_suffix('.mcap')}")


def write_json(path: Path | None, figures: dict[str, Any], force: bool) -> None:
    """Write figures as JSON; numbers that are not finite become null."""
    if path is None:
        return
    from ..runtime.outputs import writing

    with writing(path, force) as temporary:
        temporary.write_text(json.dumps(plain(figures), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def write_truth(path: Path, tables: dict[str, Any], force: bool) -> None:
    """Write what a calibration of simulated files should find, in the form of a calibration file."""
    from ..runtime.outputs import writing

    with writing(path, force) as temporary:
        temporary.write_text(truth_text(tables), encoding="utf-8")


def truth_text(tables: dict[str, Any]) -> str:
    """The same as text."""
    from calib.file import FORMAT, VERSION, to_toml

    return f"# {_TRUTH}\n" + to_toml({"format": FORMAT, "version": VERSION} | tables)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table that fits into the terminal; columns of numbers stand to the right."""
    from .table_layout import laid_out

    screen = console()
    cells = [[printable(cell(value), lines=True) for value in row] for row in rows]
    titles = [printable(column) for column in columns]
    screen.print(laid_out(printable(title), titles, cells, screen.width))


def print_notes(notes: Iterable[str]) -> None:
    """Print what the user must know, a line each, none twice."""
    for note in dict.fromkeys(notes):
        say(f"note: {note}")


def say(text: str) -> None:
    """Print a line on stdout, or several; on a terminal they are broken between words, in a pipe they stay.

    Nothing of it acts on the terminal.
    """
    text = printable(text, lines=True)
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns
        text = "\n".join(_wrapped(line, width) for line in text.splitlines())
    print(text)


def _wrapped(line: str, width: int) -> str:
    return textwrap.fill(line, width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)


def say_command(*words: object) -> None:
    """Print the command to try next, on one line, so that it can be copied."""
    print(f"try: {shlex.join(['unocclude', *map(str, words)])}")


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


def percent(share: float | None) -> str:
    """A share for a table, in percent."""
    return "-" if share is None or not math.isfinite(share) else f"{100 * share:.0f} %"


def centimetres(metres: float | None) -> str:
    """A length for a table, in cm."""
    return "-" if metres is None or not math.isfinite(metres) else f"{100 * metres:.2f}"
