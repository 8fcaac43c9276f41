"""Jobs done side by side in worker processes, or here when there is little to do."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from threading import Lock
from types import ModuleType, TracebackType
from typing import Any, Literal, TypeVar

from ..errors import UnoccludeError
from .packages import keep_freed_memory

#: Libraries and their threads take about this much, bytes; with less they end the process, or never answer.
LEAST_BYTES = 300 << 20


def check_allowance() -> None:
    """Refuse where this process may use less memory than its work needs before it has read anything."""
    if sys.platform != "linux":
        return
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_DATA)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_BYTES:
        raise UnoccludeError(
            f"memory is limited to {allowed >> 20} MB per process here (ulimit -d); this needs"
            f" {LEAST_BYTES >> 20} MB: raise the limit."
        )


_PR_SET_PDEATHSIG = 1


def prepare_worker() -> None:
    """Prepare a worker process; the first that it runs."""
    keep_freed_memory()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent ends its workers
    for number in signal.valid_signals() - {signal.SIGINT}:
        if callable(signal.getsignal(number)):  # a forked worker has its parent's
            signal.signal(number, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    end_with_parent()


def end_with_parent() -> None:
    """End this process as soon as its parent is gone, however that went."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            import ctypes

            ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent.pid:  # it was gone before
            os._exit(1)


#: With fewer frames than this in all, starting processes costs more than it saves.
WORTH_FRAMES = 4000
#: How often a worker that died in the middle of an answer is looked for, s.
_LOOK_S = 1.0
#: Libraries that would start threads of their own in each process.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def starting_processes() -> Iterator[None]:
    """Keep the caller's script, Ctrl-C and further threads from processes that start meanwhile."""
    main, missing = sys.modules["__main__"], [name for name in THREADS if name not in os.environ]
    has_masks = hasattr(signal, "pthread_sigmask")  # Windows has none
    held = {signal.SIGINT, signal.SIGHUP} if has_masks else set()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, held) if has_masks else set()
    try:
        if has_masks:
            # it lets Ctrl-C through again as it starts; the end of a terminal would end it before its users
            resource_tracker.ensure_running()
            signal.pthread_sigmask(signal.SIG_BLOCK, held)
        # a script is not run again, whether or not it guards its main part
        sys.modules["__main__"] = ModuleType("__main__")
        os.environ.update(dict.fromkeys(missing, "1"))
        yield
    finally:
        for name in missing:
            os.environ.pop(name, None)
        sys.modules["__main__"] = main
        if has_masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_method() -> Literal["fork", "spawn"]:
    """How workers start: a fork has everything loaded, which takes a spawned one most of a second."""
    try:
        alone = sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1
    except OSError:
        alone = False
    return "fork" if alone else "spawn"


def _wake() -> None:
    """Nothing: a worker that has run it has loaded its libraries."""


#: Callback that receives the share done, 0 to 1, and its label.
Progress = Callable[[float, str], None]

Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Pool:
    """Does jobs side by side and answers in order; use as a context manager."""

    def __init__(self, processes: int, frames: int) -> None:
        count = processes or os.cpu_count() or 1
        self._executor: ProcessPoolExecutor | None = None
        self._count = count
        if count > 1 and frames > WORTH_FRAMES:
            self._executor = self._started()

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._executor is not None:
            if error is not None:
                end_workers(self._executor)  # their results are not needed
            self._executor.shutdown(wait=True, cancel_futures=True)

    def map(self, job: Callable[[Item], Answer], items: Iterable[Item]) -> Iterator[Answer]:
        """The job's answers in the order of the items, of which no more are taken than keep all busy."""
        if self._executor is None:
            yield from map(job, items)
            return
        waiting: deque[Future[Answer]] = deque()
        try:
            for item in items:
                with starting_processes():
                    waiting.append(self._executor.submit(job, item))
                if len(waiting) > self._count + 1:
                    yield self._answer(waiting.popleft())
            while waiting:
                yield self._answer(waiting.popleft())
        except BrokenProcessPool:
            raise UnoccludeError(
                "A worker process was killed; perhaps there is not enough memory: use fewer of them"
                " (--processes), or a larger machine."
            ) from None

    def _answer(self, future: Future[Answer]) -> Answer:
        assert self._executor is not None
        while not wait_for([future], _LOOK_S).done:
            end_if_one_died(self._executor)
        return future.result()

    def _started(self) -> ProcessPoolExecutor:
        """Workers that load their libraries, where they have to, while the caller prepares."""
        context = multiprocessing.get_context(_start_method())
        with starting_processes(), suppress(BrokenProcessPool):
            executor = ProcessPoolExecutor(self._count, mp_context=context, initializer=prepare_worker)
            for _ in range(self._count):
                executor.submit(_wake)
        return executor


def _workers(executor: ProcessPoolExecutor) -> list[BaseProcess]:
    return list((getattr(executor, "_processes", None) or {}).values())


def end_if_one_died(executor: ProcessPoolExecutor) -> None:
    """End all workers where one has died, so that jobs that are not done raise BrokenProcessPool."""
    if wait([process.sentinel for process in _workers(executor)], 0):
        end_workers(executor)


def end_workers(executor: ProcessPoolExecutor) -> None:
    """End the workers in the middle of what they are doing, also of writing an answer."""
    for process in _workers(executor):
        with suppress(OSError, ValueError):
            process.terminate()
    # who reads half an answer waits for the rest as long as anyone, this process too, could write it
    with suppress(OSError, AttributeError):
        executor._result_queue._writer.close()  # type: ignore[attr-defined]


#: Commands and worker processes start so; what the environment says later, NumPy does not hear.
_ONE_FROM_THE_START = any(os.environ.get(name) == "1" for name in THREADS)

_lock = Lock()
_inside = 0
_limits: Any = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread meanwhile, in a notebook as in the commands, which start it so."""
    global _inside, _limits
    if _ONE_FROM_THE_START:
        yield
        return
    from threadpoolctl import threadpool_limits

    with _lock:  # the first one in sets the limit, the last one out takes it away
        if _inside == 0:
            _limits = threadpool_limits(1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _limits.restore_original_limits()
