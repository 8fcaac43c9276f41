"""End to end: `unocclude smooth`, file to file, program start included; its time and its memory."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from .memory import PrivatePeak
from .profile import smooth_arguments

COMMAND = "from smoother.cli import main; main()"


@dataclass(frozen=True)
class Run:
    """One run of the command.

    Attributes
    ----------
    seconds : float, s
        From start to end of the program.
    cpu_s : float, s
        Of all its processes.
    main_mb, worker_mb : float, MB
        Peak of the private memory (RssAnon) of the main process and of the largest worker; 0 where unknown.
    workers : int
        Processes that it started, at most so many at a time.
    """

    seconds: float
    cpu_s: float
    main_mb: float
    worker_mb: float
    workers: int


def end_to_end(source: Path, result: Path, processes: int, python: str = sys.executable) -> Run:
    """Run `unocclude smooth SOURCE -o RESULT`, that of another installation where its `python` is given.

    Raises
    ------
    RuntimeError
        It failed; the text is what it said.
    """
    with tempfile.TemporaryFile() as said:
        began = time.perf_counter()
        command = subprocess.Popen(
            # -P: not what lies in the folder where this runs
            [python, "-P", "-c", COMMAND, *smooth_arguments(source, result, processes)],
            stdout=subprocess.DEVNULL,
            stderr=said,
        )
        peak = PrivatePeak(command.pid)
        _, status, usage = os.wait4(command.pid, 0)
        seconds = time.perf_counter() - began
        command.returncode = os.waitstatus_to_exitcode(status)
        if command.returncode:
            said.seek(0)
            raise RuntimeError(f"unocclude smooth {source}: {said.read().decode(errors='replace').strip()}")
    return Run(seconds, usage.ru_utime + usage.ru_stime, peak.mb(), peak.worker_mb(), peak.workers)


def against(python: str, source: Path, result: Path, processes: int, runs: int) -> dict[str, float]:
    """Run the command of another installation and ours in turn on one recording.

    Parameters
    ----------
    python : str
        The other installation's interpreter.
    runs : int
        Of each.

    Returns
    -------
    ratios : dict
        Median of the others over median of ours, by the name in `Run`; above 1 we need less.
    """
    theirs, ours = [], []
    for _ in range(runs):
        theirs.append(end_to_end(source, result, processes, python))
        ours.append(end_to_end(source, result, processes))

    def middle(measured: list[Run], name: str) -> float:
        return statistics.median(getattr(run, name) for run in measured)

    names = ("seconds", "cpu_s", "main_mb", "worker_mb")
    return {name: middle(theirs, name) / (middle(ours, name) or float("nan")) for name in names}


def help_seconds(runs: int = 3) -> float:
    """The shortest of some runs of `unocclude --help`, s."""
    spent = []
    for _ in range(runs):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", COMMAND, "--help"], check=True, stdout=subprocess.DEVNULL)
        spent.append(time.perf_counter() - began)
    return min(spent)
