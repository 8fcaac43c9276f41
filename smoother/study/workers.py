"""Where a study's recordings are worked on: processes of this machine, or a Dask scheduler's workers.

On this machine a process does one recording at a time. One that takes too long, or dies, stops no other.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from ..errors import UnoccludeError, debugging
from ..runtime.pool import check_allowance, end_workers, prepare_worker, starting_processes
from .folder import Row
from .job import Job, run_job

if TYPE_CHECKING:
    from distributed import Client

#: How long a scheduler may take to answer, and how long to wait for its first worker, s.
CONNECT_S, FIRST_WORKER_S = 10.0, 120.0
_TICK_S = 0.5
_LATE = "it took longer than a recording may; give more time (--time-limit), or cut it"
_DIED = (
    "the processes that worked on it died one after the other; perhaps there is not enough memory: use fewer"
    " of them a machine (--processes)"
)

#: What does jobs, by which function, and how many of them it can take.
Workers = tuple[Executor, Callable[[Job], Row | None], Callable[[], int]]
_own = threading.local()
_starting = threading.Lock()
_started: list[ProcessPoolExecutor] = []
_ended = threading.Event()


def _prepare() -> None:
    """Prepare a process of a study: what a library prints is not for the terminal."""
    prepare_worker()
    if not debugging():
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)


def run_apart(job: Job) -> Row | None:
    """Do a job in this thread's own process; None where that died."""
    try:
        with _starting, starting_processes():
            if _ended.is_set():
                return None
            if getattr(_own, "process", None) is None:
                context = multiprocessing.get_context("spawn")
                _own.process = ProcessPoolExecutor(1, context, _prepare)
                _started.append(_own.process)
            future = _own.process.submit(run_job, job)
        return future.result(job.settings.time_limit_s or None)
    except (BrokenProcessPool, TimeoutError) as error:
        end_workers(_own.process)
        _own.process = None
        return job.failed(_LATE) if isinstance(error, TimeoutError) else None


@contextmanager
def local(processes: int = 0) -> Iterator[Workers]:
    """Processes of this machine."""
    check_allowance()
    count = processes or os.cpu_count() or 1
    _ended.clear()
    with ThreadPoolExecutor(count) as threads:
        try:
            yield threads, run_apart, lambda: count
        finally:  # after an error or Ctrl-C in the middle of what they are doing
            threads.shutdown(wait=False, cancel_futures=True)
            with _starting:
                _ended.set()
                for process in _started:
                    end_workers(process)
                _started.clear()


@contextmanager
def cluster(scheduler: str) -> Iterator[Workers]:
    """The workers of a Dask scheduler."""
    client = _connect(scheduler)

    def slots() -> int:
        if client.status == "running":
            with suppress(OSError, TimeoutError):
                return 2 * max(1, sum(client.nthreads().values()))
        raise UnoccludeError(
            f"the scheduler at {scheduler} went away; the same command continues when it is back"
        )

    try:
        yield client.get_executor(pure=False), run_job, slots
    finally:
        client.close(timeout=CONNECT_S)


def _connect(scheduler: str) -> Client:
    from distributed import Client

    if not debugging():  # what matters of Dask's messages is said in our words
        for name in list(logging.root.manager.loggerDict):
            if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UnoccludeError(
            f"no Dask scheduler responds at {scheduler}; start one with `dask scheduler` and give its"
            " address, such as tcp://10.0.0.1:8786"
        ) from error
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError as error:
        client.close(timeout=CONNECT_S)
        raise UnoccludeError(
            f"the scheduler at {scheduler} has no worker; start some with `dask worker {scheduler}`"
        ) from error
    return client


def rows_of(jobs: Iterator[Job], workers: Workers) -> Iterator[Row | None]:
    """The row of each job as it ends, None now and then meanwhile.

    A recording whose process died is tried once more, alone, after the others.
    """
    executor, work, slots = workers
    running: dict[Future[Row | None], Job] = {}
    again: list[Job] = []
    retried: set[str] = set()
    while True:
        while len(running) < slots() and (job := next(jobs, None)) is not None:
            running[executor.submit(work, job)] = job
        if not running:
            if not again:
                return
            job = again.pop(0)
            retried.add(job.name)
            running[executor.submit(work, job)] = job
        done, _ = wait(running, _TICK_S, FIRST_COMPLETED)
        if not done:
            yield None
        for future in done:
            job = running.pop(future)
            row = _row(future, job)
            if row is None and job.name not in retried:
                again.append(job)
            else:
                yield row or job.failed(_DIED)


def _row(future: Future[Any], job: Job) -> Row | None:
    """The row of a job that has ended; None where its process died, or went away."""
    error = None if future.cancelled() else future.exception()
    if future.cancelled() or type(error).__name__ == "KilledWorker":
        return None
    if isinstance(error, ImportError):
        return job.failed(f"a worker lacks a package ({error}); install the same unocclude on all machines")
    if error is not None:
        return job.failed(f"a worker could not do it: {type(error).__name__}: {' '.join(str(error).split())}")
    row: Row | None = future.result()
    return row
