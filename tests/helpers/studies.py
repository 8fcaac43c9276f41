"""What the tests of studies share."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import duckdb

from smoother.cli.run import run

NAMES = ("day1/a.mcap", "day1/b.mcap", "day2/c.mcap", "day2/d.mcap")
BROKEN = "day2/broken.mcap"


def batch(*arguments: object) -> int:
    """The command in this process; its exit code."""
    return run(["batch", *map(str, arguments)])


def start_batch(*arguments: object) -> subprocess.Popen:
    """The command in a process of its own."""
    command = [sys.executable, "-c", "from smoother.cli import main; main()", "batch", *map(str, arguments)]
    # started in the background, a shell's children ignore Ctrl-C: the tests are about those that do not
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL) if os.name == "posix" else None
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, preexec_fn=heed
    )


def query(folder: Path, what: str = "recording, status, id, finished") -> list[tuple]:
    """Rows of a study, as anyone may ask for them at any time."""
    if not any((folder / "results").glob("*.parquet")):
        return []
    return duckdb.sql(f"SELECT {what} FROM '{folder}/results/*.parquet' ORDER BY recording").fetchall()


def state(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Time and bytes of every output."""
    return {
        path.relative_to(folder).as_posix(): (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*.mcap")
        if ".unocclude" not in path.parts
    }


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for something to happen."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    # a process that has ended and that nobody has asked about yet
    status = Path(f"/proc/{process}/stat")
    return not (status.exists() and status.read_text().rsplit(")", 1)[1].split()[0] == "Z")
