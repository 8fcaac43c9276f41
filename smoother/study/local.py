"""A study on this machine: processes that each work on one recording at a time."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from ..runtime.pool import blank_main, one_thread_each
from .columns import Row
from .job import Job, run_job

#: How often a recording is given to another process after the first one died of it.
ANOTHER_TRY = 1
_TICK_S = 0.5


def run_local(jobs: Iterator[Job], processes: int = 0) -> Generator[Row | None, None, None]:
    """Do the jobs on this machine.

    A process that dies (out of memory, killed) is replaced, and its recording is tried once more. Processes
    end by themselves when this one is gone, however it went.

    Parameters
    ----------
    processes : how many; 0 = one a core.

    Yields
    ------
    A row as soon as a recording is done, None now and then while nothing is.
    """
    crew: list[_Worker] = []
    again: deque[tuple[Job, int]] = deque()
    try:
        with one_thread_each():
            while True:
                _fill(crew, jobs, again, processes or os.cpu_count() or 1)
                if not crew:
                    return
                ready = connection.wait([worker.pipe for worker in crew], timeout=_TICK_S)
                if not ready:
                    yield None
                for worker in [worker for worker in crew if worker.pipe in ready]:
                    try:
                        row = worker.pipe.recv()
                        worker.job = None
                    except (EOFError, OSError):
                        row = _died(worker, again)
                        crew.remove(worker)
                    if row is not None:
                        yield row
    finally:
        for worker in crew:
            worker.process.kill()
        for worker in crew:
            worker.process.join()


@dataclass
class _Worker:
    """A process, the pipe to it, and the job that it has."""

    process: BaseProcess
    pipe: Connection
    job: Job | None = None
    tried: int = 0


def _fill(crew: list[_Worker], jobs: Iterator[Job], again: deque[tuple[Job, int]], count: int) -> None:
    """Give every process a job; let those go for which there is none."""
    idle = [worker for worker in crew if worker.job is None]
    while idle or len(crew) < count:
        job, tried = again.popleft() if again else (next(jobs, None), 0)
        if job is None:
            break
        worker = idle.pop() if idle else _start()
        if worker not in crew:
            crew.append(worker)
        worker.job, worker.tried = job, tried
        with suppress(OSError):  # a dead one is noticed where answers are read
            worker.pipe.send(job)
    for worker in idle:
        crew.remove(worker)
        worker.pipe.close()
        worker.process.join()


def _start() -> _Worker:
    # spawn: GTSAM's threads do not survive a fork, and macOS and Windows have no other way
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True)
    with blank_main():
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _died(worker: _Worker, again: deque[tuple[Job, int]]) -> Row | None:
    """Another try for the job of a process that died; its row when there were enough."""
    worker.process.join()
    job = worker.job
    if job is None:
        return None
    if worker.tried < ANOTHER_TRY:
        again.append((job, worker.tried + 1))
        return None
    code = worker.process.exitcode or 0
    how = f"signal {-code}" if code < 0 else f"exit code {code}"
    return job.lost(
        f"the process that worked on it died {worker.tried + 1} times ({how});"
        " perhaps the memory does not suffice: try with fewer --processes"
    )


def _serve(pipe: Connection) -> None:
    """Work until no more jobs come."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent ends its processes
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        pipe.send(run_job(job))


def _leave_with_parent() -> None:
    """End this process when its parent was killed: nobody would hear of its work."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
