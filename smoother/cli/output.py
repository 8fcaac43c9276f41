"""What commands print and write: tables, notes, figures as JSON, of several arms too; outputs; progress."""

from __future__ import annotations

import io
import json
import math
import os
import shlex
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from ..errors import UnoccludeError
from ..runtime.printable import plain, printable
from ..table import cell_text
from . import options as o
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from ..recording import Recording
    from ..result import Recovery
    from ..runtime.pool import Progress
    from ..table import Table


@contextmanager
def progress_bar(text: str) -> Iterator[Progress]:
    """Yield a function (part done 0 to 1, what is being done) that moves the bar.

    Where the environment names a file in `UNOCCLUDE_PROGRESS`, it is written there instead.
    """
    if file := os.environ.get("UNOCCLUDE_PROGRESS"):
        yield _into_file(Path(file))
        return
    if not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    shown = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
    )
    # of itself it would take a thread, and worker processes start fastest without
    how: dict[str, Any] = {"transient": True, "auto_refresh": False}
    with Bar(*shown, TimeElapsedColumn(), console=Console(stderr=True), **how) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda fraction, text: bar.update(
            task, completed=fraction, description=printable(text), refresh=True
        )


#: Shortest time between two updates of that file, s.
_PROGRESS_STEP_S = 0.1


def _into_file(path: Path) -> Progress:
    """Progress as JSON in a file; one that cannot be written is not a reason to end the command."""
    written_s = -math.inf

    def show(share: float, text: str) -> None:
        nonlocal written_s
        if time.monotonic() - written_s < _PROGRESS_STEP_S and share < 1.0:
            return
        written_s = time.monotonic()
        beside = path.with_name(path.name + ".new")
        with suppress(OSError):
            beside.write_text(json.dumps({"share": round(share, 4), "text": text}), encoding="utf-8")
            os.replace(beside, path)

    return show


def part_of(progress: Progress, number: int, count: int) -> Progress:
    """Progress of one of several jobs as that of all."""
    return lambda share, text: progress((number + share) / count, text)


#: Files of a command; some may not be given.
Paths = Iterable[Path | None]


def check_outputs(force: bool, outputs: Paths, inputs: Paths = ()) -> None:
    """Refuse outputs that could not be written in the end, before any work is done for them."""
    from ..runtime.inputs import check_input
    from ..runtime.outputs import check_output, is_stream, remove_stale_tempfiles

    read: set[object] = set()
    for path in filter(None, inputs):
        check_input(path)
        read |= _identity(path)
    written: set[object] = set()
    for path in (path for path in outputs if path is not None and not is_stream(path)):
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
    keys: set[object] = {os.path.realpath(path)}
    with suppress(OSError, ValueError):
        about = path.stat()
        keys |= {(about.st_dev, about.st_ino)} if about.st_ino else set()
    return keys


def write_text(path: Path | None, text: str, force: bool) -> None:
    """Write a text, whole or not at all, where a file is named."""
    if path is not None:
        from ..runtime.outputs import writing

        with writing(path, force) as temporary:
            temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def write_json(path: Path | None, figures: dict[str, Any], force: bool) -> None:
    """Write figures as JSON; numbers that are not finite become null."""
    if path is not None:
        write_text(path, json.dumps(plain(figures), indent=2, allow_nan=False) + "\n", force)


def write_csv(path: Path | None, rows: Iterable[Sequence[object]], force: bool) -> None:
    """Write rows as CSV, the first with the columns' names, where a file is named."""
    if path is not None:
        from ..runtime.csv_rows import write_rows

        text = io.StringIO()
        write_rows(text, (map(_csv_cell, row) for row in rows))
        write_text(path, text.getvalue(), force)


def _csv_cell(value: object) -> object:
    if isinstance(value, float):
        return repr(round(value, 9)) if math.isfinite(value) else ""
    return "" if value is None else value


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        float(text.strip("-+% ") or 0)
        return True
    return False


#: Tables with more columns do without space beside their cells where words would be broken.
_MANY_COLUMNS = 10


def show(table: Table, most: int | None = None, rest: str = "rows more; --json has them all") -> None:
    """Print the first `most` rows of a table at the terminal's width; nothing without rows.

    Columns of numbers are right-aligned.
    """
    if not table.rows:
        return
    from rich.table import Table as Grid
    from rich.text import Text

    cells = [[printable(cell_text(value), lines=True) for value in row] for row in table.rows[:most]]
    screen = console()
    texts = [(printable(name), *own) for name, *own in zip(table.columns, *cells, strict=True)]
    words = sum(max((len(word) for text in own for word in text.split()), default=0) for own in texts)
    pad = int(len(texts) <= _MANY_COLUMNS or words + 3 * len(texts) + 1 <= screen.width)
    fits = words + (2 * pad + 1) * len(texts) + 1 <= screen.width  # else words are broken, none is cut off
    grid = Grid(padding=(0, pad))
    for name, *own in texts:
        side: Any = "right" if all(map(_is_number, own)) else "left"
        whole = fits and not any(" " in text for text in (name, *own))
        grid.add_column(Text(name, style="bold"), justify=side, overflow="fold", no_wrap=whole)
    for row in cells:
        grid.add_row(*map(Text, row))
    screen.print(Text(printable(table.title), style="bold"))
    screen.print(grid)
    say_more(len(table.rows), most, rest)


def console() -> Any:
    """Rich's console on stdout; wide enough for a table where stdout is not a terminal."""
    from rich.console import Console

    usual = Console()
    return usual if usual.is_terminal else Console(width=120)


def say_more(count: int, most: int | None, rest: str) -> None:
    """Print how many were not printed."""
    if most is not None and count > most:
        say(f".. and {count - most} {rest}")


def print_notes(notes: Iterable[str], imported: bool = False) -> None:
    """Print what the user must know, a line each, none twice.

    Notes that the recording's import has said already are left to `info` and --verbose (`imported`).
    """
    for note in dict.fromkeys(notes):
        if imported or not is_imported(note):
            say(f"note: {note}")


def is_imported(note: str) -> bool:
    """Whether a note is in the recording's file, whose import said it."""
    from ..recording import ImportNote

    return isinstance(note, ImportNote)


def say(text: str) -> None:
    """Print a line on stdout, or several; on a terminal they are broken between words, in a pipe they stay.

    Nothing of it acts on the terminal.
    """
    text = printable(text, lines=True)
    if sys.stdout.isatty():
        wrapper = textwrap.TextWrapper(
            shutil.get_terminal_size().columns,
            subsequent_indent="  ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        text = "\n".join(map(wrapper.fill, text.splitlines()))
    print(text)


def say_command(*words: object) -> None:
    """Print the command to try next, on one line, so that it can be copied."""
    print(f"try: {shlex.join(['unocclude', *map(str, words)])}")


def say_written(*paths: Path | None) -> None:
    """Print what was written, if anything."""
    if files := [str(path) for path in paths if path is not None]:
        say(f"written: {', '.join(files)}")


@dataclass(frozen=True)
class Out:
    """Where a command's figures go, and whether its outputs may be replaced."""

    json_file: o.Json = None
    force: o.Force = False

    def check_files(self, written: Paths, added_to: Paths, read: Paths, shared: Paths) -> None:
        """Refuse files that could not be read or written in the end; what is added to is read as well."""
        check_outputs(self.force, written, [*read, *shared, *added_to])
        check_outputs(True, added_to, read)

    def check(self, outputs: Paths, inputs: Paths = ()) -> None:
        """Refuse further outputs, whose names follow from others."""
        check_outputs(self.force, [*outputs, self.json_file], inputs)

    def json(self, figures: dict[str, Any]) -> None:
        """Write the figures, if they are wanted: before anything is printed, which nobody may read."""
        write_json(self.json_file, figures, self.force)

    def arms(
        self,
        arms: Sequence[Any],
        figures: Sequence[dict[str, Any]],
        tell: Callable[[int], None],
        **more: object,
    ) -> dict[str, Any]:
        """Write the figures of all arms, then tell of each by its number; the figures that were written."""
        together = arms_figures(arms, figures) | more
        self.json(together)
        for number, arm in enumerate(arms):
            say_arm(arm, len(arms))
            tell(number)
        return together

    def end(self, *written: Path | None) -> None:
        """Print what was written."""
        say_written(*written, self.json_file)


def arms_figures(arms: Sequence[Any], figures: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one arm as they are; of several those of the first, and `arms` with all of them.

    With several, `trusted`, `verdict` and `reasons` at the top are those of all arms together, and `pairing`
    is that of the arm whose is proved least.
    """
    if len(figures) == 1:
        return figures[0]
    each = [{"side": arm.side, "body": arm.body, **mine} for arm, mine in zip(arms, figures, strict=True)]
    together = {**each[0], "arms": each}
    if "trusted" not in together:
        return together
    trusted = {mine["trusted"] for mine in each}
    together["trusted"] = next((word for word in (False, None) if word in trusted), True)
    labelled = [(arm.arm_label, mine) for arm, mine in zip(arms, each, strict=True)]
    together["reasons"] = [f"{label}: {why}" for label, mine in labelled for why in mine.get("reasons", ())]
    if "verdict" in together:
        together["verdict"] = " ".join(f"{label.capitalize()}: {mine['verdict']}" for label, mine in labelled)
    if pairings := [mine["pairing"] for mine in each if mine.get("pairing")]:
        together["pairing"] = max(pairings, key=lambda one: (not one["proved"], one["chance"] or 0.0))
    return together


Answer = TypeVar("Answer")


def each_arm(
    text: str, recordings: Sequence[Recording], work: Callable[[int, Progress], Answer]
) -> tuple[list[tuple[Recording, Answer]], list[str]]:
    """Some work on every arm; one of several that cannot be worked on is left out, and said."""
    answers, left_out, errors = [], [], []
    with progress_bar(text) as progress:
        for number, recording in enumerate(recordings):
            try:
                answers.append((recording, work(number, part_of(progress, number, len(recordings)))))
            except UnoccludeError as error:
                errors.append(error)
                left_out.append(f"The {recording.arm_label} was left out: {str(error).rstrip('.')}.")
    if not answers:
        raise errors[0]
    return answers, left_out


def say_arm(arm: Any, count: int) -> None:
    """Say whose tables follow, where there are several arms."""
    if count > 1:
        say(f"--- {arm.arm_label} ---")


def warn(recoveries: Sequence[Recovery]) -> None:
    """A line on stderr for each result that is not to be trusted everywhere; of several it names the arm."""
    from ..result.untrusted import standing

    for recovery in recoveries:
        if recovery.has_verdict and not recovery.trusted.all():
            of = f"{recovery.arm_label}: " if len(recoveries) > 1 else ""
            line = printable(" ".join(f"{of}{standing(recovery)}".split()))
            print(f"unocclude: warning: {line}", file=sys.stderr)


def end_strictly(verdicts: Iterable[bool | None]) -> None:
    """End with the exit code of results that are not to be trusted, where one is not, or was not judged."""
    if not all(trusted is True for trusted in verdicts):
        raise typer.Exit(NOT_TRUSTED)
