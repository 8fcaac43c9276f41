"""Where a study's recordings are worked on: processes of this machine, or a cluster's.

Each recording is done by a process that does one at a time and ends with the one that started it. One that
takes too long, or dies, stops no other.
"""

from __future__ import annotations

import logging
import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from ..errors import UnoccludeError, debugging
from ..runtime.pool import check_allowance
from .folder import Row
from .job import Job, run_job

if TYPE_CHECKING:
    from distributed import Client

#: Runs the jobs of `run_apart`.
COMMAND = [sys.executable, "-m", __name__]
#: How long a scheduler may take to answer, and how long to wait for its first worker, s.
CONNECT_S, FIRST_WORKER_S = 10.0, 120.0
_TICK_S = 0.5
_LATE = "it took longer than a recording may; give more time (--time-limit), or cut it"
_DIED = (
    "the processes that worked on it died one after the other; perhaps there is not enough memory: use fewer"
    " of them a machine (--processes)"
)

#: What does jobs, and how many of them it can take.
Workers = tuple[Executor, Callable[[], int]]
_own = threading.local()
_started: list[subprocess.Popen[bytes]] = []
_ended = threading.Event()


def run_apart(job: Job) -> Row | None:
    """Do a job in this thread's own process; None where that died."""
    process: subprocess.Popen[bytes] | None = getattr(_own, "process", None)
    if process is None or process.poll() is not None:
        process = _own.process = _start()
    assert process.stdin is not None and process.stdout is not None
    late = threading.Event()

    def end() -> None:
        late.set()
        process.kill()

    timer = threading.Timer(job.settings.time_limit_s, end)
    if job.settings.time_limit_s:
        timer.start()
    try:
        pickle.dump(job, process.stdin)
        process.stdin.flush()
        row: Row = pickle.load(process.stdout)
        return row
    except (EOFError, OSError, pickle.UnpicklingError):
        process.kill()
        process.wait()
        return job.failed(_LATE) if late.is_set() else None
    finally:
        timer.cancel()


def _start() -> subprocess.Popen[bytes]:
    """A process that does jobs; Ctrl-C in a terminal does not reach it."""
    process = subprocess.Popen(
        COMMAND,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=None if debugging() else subprocess.DEVNULL,
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
    )
    _started.append(process)
    if _ended.is_set():
        process.kill()
    return process


def serve() -> None:
    """Do the jobs that arrive on standard input, until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is not an answer
    jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()

    def receive() -> None:
        with suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                jobs.put(pickle.load(sys.stdin.buffer))
        os._exit(0)  # in the middle of a recording, too: nobody would hear of it

    threading.Thread(target=receive, daemon=True).start()
    while True:
        pickle.dump(run_job(jobs.get()), answers)
        answers.flush()


@contextmanager
def local(processes: int = 0) -> Iterator[Workers]:
    """Processes of this machine."""
    check_allowance()
    count = processes or os.cpu_count() or 1
    _ended.clear()
    with ThreadPoolExecutor(count) as threads:
        try:
            yield threads, lambda: count
        finally:  # after an error or Ctrl-C in the middle of what they are doing
            _ended.set()
            threads.shutdown(wait=False, cancel_futures=True)
            for process in _started:
                process.kill()
                process.wait()
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
        yield client.get_executor(pure=False), slots
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
    executor, slots = workers
    running: dict[Future[Row | None], Job] = {}
    again: list[Job] = []
    retried: set[str] = set()
    while True:
        while len(running) < slots() and (job := next(jobs, None)) is not None:
            running[executor.submit(run_apart, job)] = job
        if not running:
            if not again:
                return
            job = again.pop(0)
            retried.add(job.name)
            running[executor.submit(run_apart, job)] = job
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


if __name__ == "__main__":
    serve()
