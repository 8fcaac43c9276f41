"""End to end: `unocclude smooth`, file to file, program start included; its time and its memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from . import memory

#: How often the memory is looked at, s.
LOOK_S = 0.05
COMMAND = "from smoother.cli import main; main()"


@dataclass(frozen=True)
class Run:
    """One run of the command.

    Attributes
    ----------
    seconds : from start to end of the program.
    cpu_s : of all its processes.
    main_mb, worker_mb : peak (VmHWM) of the main process and of the largest worker, MB; 0 where unknown.
    workers : processes that it started, at most so many at a time.
    """

    seconds: float
    cpu_s: float
    main_mb: float
    worker_mb: float
    workers: int


def end_to_end(source: Path, result: Path, processes: int) -> Run:
    """Run `unocclude smooth SOURCE -o RESULT`.

    Raises
    ------
    RuntimeError
        It failed; the text is what it said.
    """
    arguments = ["smooth", str(source), "-o", str(result), "--force"]
    if processes:
        arguments += ["--processes", str(processes)]
    main_mb, most = 0.0, 0
    workers: dict[int, float] = {}
    with tempfile.TemporaryFile() as said:
        began = time.perf_counter()
        command = subprocess.Popen(
            [sys.executable, "-c", COMMAND, *arguments], stdout=subprocess.DEVNULL, stderr=said
        )
        while True:
            pid, status, usage = os.wait4(command.pid, os.WNOHANG)
            if pid:
                break
            main_mb = max(main_mb, memory.peak_mb(command.pid))
            running = memory.workers_of(command.pid)
            most = max(most, len(running))
            for worker in running:
                workers[worker] = max(workers.get(worker, 0.0), memory.peak_mb(worker))
            time.sleep(LOOK_S)
        seconds = time.perf_counter() - began
        command.returncode = os.waitstatus_to_exitcode(status)
        if command.returncode:
            said.seek(0)
            raise RuntimeError(f"unocclude smooth {source}: {said.read().decode(errors='replace').strip()}")
    return Run(seconds, usage.ru_utime + usage.ru_stime, main_mb, max(workers.values(), default=0.0), most)


def help_seconds(runs: int = 3) -> float:
    """The shortest of some runs of `unocclude --help`, s."""
    spent = []
    for _ in range(runs):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", COMMAND, "--help"], check=True, stdout=subprocess.DEVNULL)
        spent.append(time.perf_counter() - began)
    return min(spent)
