"""What the tests of studies share."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import duckdb

from smoother.cli.run import run
from smoother.study.run import _recover

NAMES = ("day1/a.mcap", "day1/b.mcap", "day2/c.mcap", "day2/d.mcap")
BROKEN = "day2/broken.mcap"


def batch(*arguments: object) -> int:
    """The command in this process; its exit code."""
    return run(["batch", *map(str, arguments)])


def start_batch(*arguments: object, stop_after: int = 0) -> subprocess.Popen:
    """The command in a process of its own, in a group of its own as a terminal has for each command.

    With `stop_after`, it stops itself (as by Ctrl-Z) as soon as so many rows are among the results.
    """
    program = STOP if stop_after else "from smoother.cli import main; main()"
    command = [sys.executable, "-c", program.format(stop_after), "batch", *map(str, arguments)]
    # started in the background, a shell's children ignore Ctrl-C: the tests are about those that do not
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL) if os.name == "posix" else None
    return subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=heed,
        start_new_session=True,
        env=os.environ | {"PYTHONFAULTHANDLER": "1"},  # `ended` asks where it hangs
    )


def ended(client: subprocess.Popen, seconds: float = 60.0) -> str:
    """What a client of `start_batch` printed once it has ended; where it does not, what it waits for."""
    try:
        return client.communicate(timeout=seconds)[0]
    except subprocess.TimeoutExpired:
        client.send_signal(signal.SIGABRT)
        said, _ = client.communicate()
        raise AssertionError(f"it did not end within {seconds:.0f} s: {said}") from None


STOP = """
import os, signal
from smoother.study import run
take, taken = run._take, 0
def take_and_stop(*arguments):
    global taken
    take(*arguments)
    taken += 1
    if taken >= {}:
        os.kill(os.getpid(), signal.SIGSTOP)
run._take = take_and_stop
from smoother.cli import main
main()
"""


def until_stopped(client: subprocess.Popen) -> None:
    """Wait until a client of `start_batch` has stopped itself."""
    _, status = os.waitpid(client.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status), "it ended before"


def children(process: int) -> list[int]:
    """The workers that a process has started, in whichever of its threads."""
    found = [path.read_text().split() for path in Path(f"/proc/{process}/task").glob("*/children")]
    started = [int(child) for children in found for child in children]
    return [each for each in started if b"resource_tracker" not in Path(f"/proc/{each}/cmdline").read_bytes()]


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


@dataclass(frozen=True)
class Instead:
    """`run_job` of a study in which the recordings of a name do something else."""

    name: str
    what: str

    def __call__(self, mine: Any) -> Any:
        from smoother.study.run import run_job

        with patch("smoother.study.run._recover", self.instead):
            return run_job(mine)

    def instead(self, mine: Any, *rest: Any) -> Any:
        if mine.name == self.name:
            eval(self.what, {"os": os, "signal": signal, "time": time})
        return _recover(mine, *rest)
