"""A study of many recordings on the workers of two Dask schedulers: `python -m tools.study_in_fact`.

Simulates the recordings, gives half of them to `unocclude batch` with each scheduler, kills a worker of the
first on the way, and ends the command of the second by Ctrl-C and gives it again. Prints what became of the
recordings, and what the study cost.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import duckdb

from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm
from tools.faults.kills import COMMAND, children

#: Sessions of one person.
SESSIONS = 20
#: Longest wait for something to happen, s.
PATIENCE_S = 7200.0
HALVES = ("first", "second")
ENVIRONMENT = os.environ | {"OMP_NUM_THREADS": "1"}


def simulate(folder: Path, duration_s: float, seed: int) -> None:
    """One recording: a session of a person."""
    arm = ArmSimulation.preset(
        "white",
        protocol="random",
        duration_s=duration_s,
        imu_rate_hz=80.0,
        frame_rate_hz=30.0,
        occlusion_lengths_s=(1.0,),
        occlusion_every_s=8.0,
    )
    half = folder / HALVES[seed // SESSIONS % 2] / f"person{seed // SESSIONS:04d}"
    half.mkdir(parents=True, exist_ok=True)
    write_recording(simulate_arm(arm, seed).recording, half / f"session{seed % SESSIONS:02d}.mcap")


@contextmanager
def scheduler() -> Iterator[tuple[str, int]]:
    """A Dask scheduler with one worker on this machine: its address, and the nanny of its worker."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    workers = ["worker", address, "--nthreads", "1", "--nworkers", "1", "--no-dashboard"]
    started = [_dask(*words), _dask(*workers)]
    try:
        yield address, started[1].pid
    finally:
        for program in reversed(started):
            program.send_signal(signal.SIGINT)
            program.wait(60)


def _dask(*words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *words], env=ENVIRONMENT, stderr=subprocess.DEVNULL
    )


def batch(folder: Path, half: str, address: str) -> subprocess.Popen[bytes]:
    """The command on half of the recordings."""
    words = ["batch", str(folder / half), "-o", str(folder / f"{half}-results"), "--scheduler", address]
    return subprocess.Popen([*COMMAND, *words], env=ENVIRONMENT, stdout=subprocess.DEVNULL)


def rows(folder: Path, half: str = "*") -> int:
    """How many rows are among the results."""
    files = [str(path) for path in folder.glob(f"{half}-results/results/*.parquet")]
    if not files:
        return 0
    return int(duckdb.sql(f"SELECT count(*) FROM read_parquet({files})").fetchall()[0][0])


def until(condition: Callable[[], bool], program: subprocess.Popen[bytes]) -> None:
    """Wait for something that a command does while it runs."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        if program.poll() is not None or time.monotonic() > end:
            raise SystemExit(f"the command ended before (exit {program.returncode})")
        time.sleep(0.2)


def processor_s() -> float:
    """Processor time of all processes that this one has started and that have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def study(folder: Path, count: int) -> None:
    """The whole study, and the same commands once more, which have nothing to do."""
    first, second = HALVES
    few = count // 8
    before_s, began = processor_s(), time.monotonic()
    with scheduler() as (one, nanny), scheduler() as (two, _):
        working = [batch(folder, first, one), batch(folder, second, two)]
        until(lambda: rows(folder, first) >= few, working[0])
        os.kill(children(nanny)[-1], signal.SIGKILL)  # the first one is Python's resource tracker
        until(lambda: rows(folder, second) >= 2 * few, working[1])
        working[1].send_signal(signal.SIGINT)
        working[1].wait(60)
        kept = rows(folder, second)
        working[1] = batch(folder, second, two)
        codes = [program.wait(PATIENCE_S) for program in working]
        took_s = time.monotonic() - began
        again = time.monotonic()
        codes += [
            batch(folder, half, address).wait(PATIENCE_S) for half, address in ((first, one), (second, two))
        ]
        again_s = time.monotonic() - again
    used_s = processor_s() - before_s
    print(f"exit codes {codes}; a worker killed after {few} rows, a command ended with {kept} rows kept")
    table = f"read_parquet('{folder}/*-results/results/*.parquet')"
    facts = "status, count(*), count(DISTINCT recording), sum(duration_s) / 60, sum(seconds)"
    for status, number, different, minutes, seconds in duckdb.sql(
        f"SELECT {facts} FROM {table} GROUP BY status"
    ).fetchall():
        print(
            f"{status}: {number} rows of {different} recordings, {minutes:.0f} min,"
            f" worked on for {seconds:.0f} s"
        )
    print(f"{took_s:.0f} s in all, {used_s:.0f} s of a processor: {used_s / count:.2f} s a recording")
    print(f"the same commands again, one after the other: {again_s:.1f} s, {rows(folder)} rows")


def main() -> None:
    """Simulate, study and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=1000)
    parser.add_argument("--duration-s", type=float, default=20.0, help="length of each")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with ProcessPoolExecutor() as pool:
            list(pool.map(partial(simulate, folder, options.duration_s), range(options.recordings)))
        study(folder, options.recordings)


if __name__ == "__main__":
    main()
