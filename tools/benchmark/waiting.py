"""What a person waits for: the commands of a session, one by one, and which show how far they are."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from smoother.cli.output import PROGRESS_FILE
from tools.benchmark.whole import COMMAND, Made

#: Longest time without a display of progress, s.
PATIENCE_S = 3.0
#: After this a command is given up, s.
LIMIT_S = 1800.0
EXPORTS = ("csv", "xlsx", "parquet", "trc", "mot", "c3d", "sto")


@dataclass(frozen=True)
class Waited:
    """One command.

    Attributes
    ----------
    name : str
        What was called.
    seconds : float, s
        From start to end.
    shows_progress : bool
        Whether it shows progress.
    """

    name: str
    seconds: float
    shows_progress: bool


def commands(made: Made, folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and arguments of the commands, in an order in which each finds what it reads."""
    source, result = str(made.path), str(folder / "waited.mcap")
    yield "info", ["info", source]
    yield "check", ["check", source]
    yield "match", ["match", source]
    yield "smooth", ["smooth", source, "-o", result]
    report = str(folder / "waited.html")
    yield "smooth --report", ["smooth", source, "-o", result, "--report", report, "--force"]
    yield "measures", ["measures", result]
    yield "validate", ["validate", result, "--truth", source]
    yield "methods", ["methods", result]
    for kind in EXPORTS:
        yield f"export --format {kind}", ["export", result, "--format", kind, "-o", f"{folder}/waited.{kind}"]
    yield "gaps", ["gaps", source]
    yield "compare", ["compare", source]


def waited(made: Made, folder: Path) -> list[Waited]:
    """Run every command on one recording, each in a process of its own.

    Parameters
    ----------
    made : Made
        With the truth inside.
    folder : Path
        Where the results may lie.

    Raises
    ------
    RuntimeError
        One failed; the text is what it said. 3, not to be trusted, is not a failure.
    """
    return [_run(name, arguments, folder) for name, arguments in commands(made, folder)]


def _run(name: str, arguments: list[str], folder: Path) -> Waited:
    with tempfile.TemporaryDirectory(dir=folder) as own:
        progress = Path(own) / "progress.json"
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-P", "-c", COMMAND, *arguments],
            env=os.environ | {PROGRESS_FILE: str(progress)},
            capture_output=True,
            timeout=LIMIT_S,
        )
        seconds = time.perf_counter() - began
        if done.returncode not in (0, 3):
            raise RuntimeError(f"unocclude {' '.join(arguments)}: {done.stderr.decode(errors='replace')}")
        return Waited(name, seconds, progress.exists())
