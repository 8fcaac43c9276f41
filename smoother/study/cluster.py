"""A study on a cluster of Dask workers."""

from __future__ import annotations

import logging
import os
import queue
import time
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING, Any

from ..errors import UnoccludeError
from .columns import Row
from .job import Job, run_job

if TYPE_CHECKING:
    from distributed import Client

#: How long a scheduler may take to answer, and how long to wait for its first worker, s.
CONNECT_S, FIRST_WORKER_S = 10.0, 120.0
#: Recordings handed over beyond those that are worked on, a thread of the workers; keeps the scheduler light.
_AHEAD = 2
_TICK_S = 0.5
_LOOK_S = 5.0


def run_cluster(jobs: Iterator[Job], scheduler: str) -> Generator[Row | None, None, None]:
    """Do the jobs on the workers of a Dask scheduler.

    A recording whose worker died is given to others by the scheduler, some times; workers may come and go.

    Parameters
    ----------
    scheduler : its address, such as tcp://10.0.0.1:8786.

    Yields
    ------
    A row as soon as a recording is done, None now and then while nothing is.

    Raises
    ------
    UnoccludeError
        No scheduler answers, it has no worker, or it went away.
    """
    client = _connect(scheduler)
    try:
        yield from _run(client, jobs, scheduler)
    finally:
        client.close(timeout=CONNECT_S)


def _connect(scheduler: str) -> Client:
    from distributed import Client

    _be_quiet()
    try:
        client = Client(scheduler, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise UnoccludeError(
            f"no Dask scheduler answers at {scheduler}; start one with `dask scheduler` and give its address,"
            " such as tcp://10.0.0.1:8786"
        ) from error
    try:
        client.wait_for_workers(1, timeout=FIRST_WORKER_S)
    except TimeoutError as error:
        client.close(timeout=CONNECT_S)
        raise UnoccludeError(
            f"the scheduler at {scheduler} has no worker; start some with `dask worker {scheduler}`"
        ) from error
    return client


def _be_quiet() -> None:
    """Keep Dask's messages and tracebacks from the user: what matters is said in our words."""
    if os.environ.get("UNOCCLUDE_DEBUG", "0") not in ("", "0"):
        return
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


def _run(client: Client, jobs: Iterator[Job], scheduler: str) -> Generator[Row | None, None, None]:
    done: queue.SimpleQueue[Any] = queue.SimpleQueue()
    open_jobs: dict[str, Job] = {}
    futures: dict[str, Any] = {}
    slots, looked = 0, -_LOOK_S
    while True:
        if time.monotonic() - looked >= _LOOK_S:  # workers come and go
            threads = sum(client.nthreads().values())
            slots, looked = max(1, threads) * (1 + _AHEAD), time.monotonic()
        while len(futures) < slots and (job := next(jobs, None)) is not None:
            # the same key for the same work: what runs already is not started again
            key = f"unocclude-{job.key}"
            future = client.submit(run_job, job, key=key, pure=False)
            open_jobs[key], futures[key] = job, future
            future.add_done_callback(done.put)
        if not futures:
            return
        try:
            future = done.get(timeout=_TICK_S)
        except queue.Empty:
            if client.status != "running":
                raise UnoccludeError(_gone(scheduler)) from None
            yield None
            continue
        if future.key not in futures:
            continue
        job = open_jobs.pop(future.key)
        yield _row(future, job, scheduler)
        del futures[future.key]
        future.release()


def _row(future: Any, job: Job, scheduler: str) -> Row:
    """The row of a job that has ended, whichever way."""
    if future.status == "finished":
        row: Row = future.result()
        return row
    if future.status != "error":
        raise UnoccludeError(_gone(scheduler))
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        return job.lost(
            "the workers that worked on it died one after the other; perhaps their memory is short"
        )
    if isinstance(error, ImportError):
        return job.lost(f"a worker lacks a package ({error}); install the same unocclude on all machines")
    return job.lost(f"a worker could not do it: {type(error).__name__}: {' '.join(str(error).split())}")


def _gone(scheduler: str) -> str:
    return f"the scheduler at {scheduler} went away; the same command continues when it is back"
