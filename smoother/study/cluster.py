"""A study on Dask workers: processes of this machine, or a cluster."""

from __future__ import annotations

import logging
import math
import os
import queue
import signal
import time
import warnings
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

from ..errors import UnoccludeError, debugging
from ..runtime.pool import THREADS, blank_main, check_allowance, interrupts_wait
from .folder import Row
from .job import Job, run_job

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

#: How long a scheduler may take to answer, and how long to wait for its first worker, s.
CONNECT_S, FIRST_WORKER_S = 10.0, 120.0
#: Recordings handed to a cluster beyond those that are worked on, a thread of the workers; keeps its
#: scheduler light. On one machine handing over takes no time.
_AHEAD = 2
_TICK_S = 0.5
_LOOK_S = 5.0
#: Ends the key of a second try.
_AGAIN = "again"
_SAME_COMMAND = "the same command continues"
#: Memory of the scheduler's process, and of its threads for each worker: with less they never answer.
_SCHEDULER_BYTES, _NANNY_BYTES = 380 << 20, 25 << 20
#: How Dask works on one machine.
_LOCAL = {
    # the client tries again, without others beside
    "distributed.scheduler.allowed-failures": 0,
    # GTSAM may keep a worker from answering for minutes, and a worker may take its time to start again
    "distributed.scheduler.worker-ttl": None,
    "distributed.deploy.lost-worker-timeout": "1 day",
    "distributed.worker.profile.enabled": False,
    "distributed.nanny.pre-spawn-environ": dict.fromkeys(THREADS, "1"),
}


def run_local(jobs: Iterator[Job], processes: int = 0) -> Generator[Row | None, None, None]:
    """Do the jobs on this machine, in processes that each work on one recording at a time."""
    first = list(islice(jobs, processes or os.cpu_count() or 1))
    if not first:
        return
    check_allowance(_SCHEDULER_BYTES + len(first) * _NANNY_BYTES)
    with interrupts_wait():  # an import may swallow Ctrl-C, or turn it into an error of its own
        import dask.config
        from distributed import Client
    with ExitStack() as stack:
        silent = _be_quiet()
        stack.enter_context(dask.config.set(_LOCAL))
        stack.enter_context(blank_main())
        with interrupts_wait():  # neither is left half made
            cluster = stack.enter_context(_processes(len(first), silent))
            client = stack.enter_context(Client(cluster, set_as_default=False))
            stack.push(partial(_end_processes, cluster))
        gone = f"its processes went away; {_SAME_COMMAND}"
        yield from _run(client, chain(first, jobs), 0, gone, FIRST_WORKER_S)


def _end_processes(cluster: LocalCluster, error: type[BaseException] | None, *_: object) -> None:
    """After an error or Ctrl-C end the processes: closing would wait for what they are doing."""
    if error is None:
        return
    for nanny in cluster.workers.values():
        nanny.close_gracefully()  # else it starts another process
        if (process := nanny.pid) is not None:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGTERM)


def _processes(count: int, silent: int | bool, again: bool = True) -> LocalCluster:
    """Dask on this machine; begun `again` where a process was killed as it started."""
    from distributed import LocalCluster

    try:
        return LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=None,
            silence_logs=silent,
            preload=[__name__],
        )
    except (
        OSError,
        RuntimeError,
        AssertionError,
    ) as error:  # a nanny asserts that its process began
        if again:
            return _processes(count, silent, again=False)
        reason = str(error) or "one of them ended as it began"
        raise UnoccludeError(f"the processes could not be started: {reason}") from error


def run_cluster(jobs: Iterator[Job], scheduler: str) -> Generator[Row | None, None, None]:
    """Do the jobs on the workers of a Dask scheduler."""
    client = _connect(scheduler)
    try:
        yield from _run(
            client,
            jobs,
            _AHEAD,
            f"the scheduler at {scheduler} went away; {_SAME_COMMAND} when it is back",
        )
    finally:
        client.close(timeout=CONNECT_S)


def dask_setup(worker: object) -> None:
    """Prepare a process of `run_local`; Dask calls this."""
    if _be_quiet():
        warnings.simplefilter("ignore")  # a library's warning is of no use to a user
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the client ends its processes


def _connect(scheduler: str) -> Client:
    from distributed import Client

    _be_quiet()
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


def _be_quiet() -> int | bool:
    """Keep Dask's messages and tracebacks from the user: what matters is said in our words."""
    if debugging():
        return False
    level = logging.CRITICAL + 1
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(level)
    return level


def _run(
    client: Client, jobs: Iterator[Job], ahead: int, gone: str, alone_s: float = math.inf
) -> Generator[Row | None, None, None]:
    """Keep the workers busy; a recording whose worker died is tried once more, alone, after the others."""
    ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
    running: dict[str, tuple[Job, Any]] = {}
    again: deque[Job] = deque()
    slots, looked = 0, -_LOOK_S
    last_seen = time.monotonic()

    def submit(job: Job, key: str) -> None:
        future = client.submit(run_job, job, key=key, pure=False)
        running[key] = job, future
        future.add_done_callback(ended.put)

    while True:
        if time.monotonic() - looked >= _LOOK_S:  # workers come and go
            threads = sum(client.nthreads().values())
            slots, looked = max(1, threads) * (1 + ahead), time.monotonic()
            last_seen = looked if threads else last_seen
            if looked - last_seen > alone_s:
                raise UnoccludeError(
                    f"no process for the recordings could start within {alone_s:.0f} s; close other programs,"
                    " or use fewer --processes: memory may be insufficient"
                )
        while len(running) < slots and (job := next(jobs, None)) is not None:
            # the same key for the same work: what runs already is not started again
            submit(job, f"unocclude-{job.key}")
        if not running:
            if not again:
                return
            submit(again[0], f"unocclude-{again.popleft().key}-{_AGAIN}")
        try:
            future = ended.get(timeout=_TICK_S)
        except queue.Empty:
            if client.status != "running":
                raise UnoccludeError(gone) from None
            yield None
            continue
        if future.key not in running:
            continue
        job, _ = running.pop(future.key)
        if future.status not in ("finished", "error"):
            raise UnoccludeError(gone)
        if _worker_died(future) and not future.key.endswith(_AGAIN):
            again.append(job)
        else:
            yield _row(future, job)
        future.release()


def _worker_died(future: Any) -> bool:
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


def _row(future: Any, job: Job) -> Row:
    """The row of a job that has ended, whichever way."""
    if future.status == "finished":
        row: Row = future.result()
        return row
    if _worker_died(future):
        return job.lost(
            "the processes that worked on it died one after the other; perhaps there is not enough memory:"
            " use fewer of them a machine (--processes)"
        )
    error = future.exception()
    if isinstance(error, ImportError):
        return job.lost(f"a worker lacks a package ({error}); install the same unocclude on all machines")
    return job.lost(f"a worker could not do it: {type(error).__name__}: {' '.join(str(error).split())}")
