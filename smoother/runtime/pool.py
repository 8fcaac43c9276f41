"""Jobs done side by side in processes, or here when there is little to do."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from types import ModuleType, TracebackType
from typing import Generic, Literal, TypeVar

from ..errors import UnoccludeError
from .worker import interrupts_wait, prepare_worker

#: With fewer frames than this in all, starting processes costs more than it saves.
WORTH_FRAMES = 4000
#: Libraries that would start threads of their own in each process.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def blank_main() -> Iterator[None]:
    """Keep new workers from running the caller's script again, whether or not it guards its main part.

    A spawned worker imports the parent's main module so that functions of it can be found; ours are in
    this package.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Keep the libraries of processes that start meanwhile from starting threads of their own."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update({name: "1" for name, value in before.items() if value is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


def _start_method() -> Literal["fork", "spawn"]:
    """How workers start: a fork has everything loaded, which takes a spawned one most of a second.

    Other threads' locks do not survive a fork: it is used where this process has no other thread, of Python
    or of a library (GTSAM, BLAS, a progress bar, a notebook), and where the system is known to allow it.
    """
    try:
        alone = sys.platform == "linux" and len(os.listdir("/proc/self/task")) == 1
    except OSError:
        alone = False
    return "fork" if alone else "spawn"


def _wake() -> None:
    """Nothing: a worker that has run it has loaded its libraries."""


Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Pool:
    """Does jobs side by side and answers in order; use as a context manager.

    Workers end with this process, however it ends. If one is killed, all are started once more and do again
    what they had not answered: jobs depend on their items alone.

    Parameters
    ----------
    processes : int
        Worker processes, 0 = one a core.
    frames : int
        Camera frames of the whole job; a small one is done here.
    """

    def __init__(self, processes: int, frames: int) -> None:
        count = processes or os.cpu_count() or 1
        self._executor: ProcessPoolExecutor | None = None
        self._count = count
        self._ahead = count + 1
        self._may_restart = True
        if count > 1 and frames > WORTH_FRAMES:
            self._executor = self._started()

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._executor is not None:
            if error is not None:
                _end_workers(self._executor)  # nobody waits for what they are doing
            self._executor.shutdown(wait=True, cancel_futures=True)

    def map(self, job: Callable[[Item], Answer], items: Iterable[Item]) -> Iterator[Answer]:
        """The job's answers in the order of the items, of which no more are taken than keep all busy.

        Items that are made one by one are worked on while the next ones are made.

        Raises
        ------
        UnoccludeError
            Workers were killed twice.
        """
        if self._executor is None:
            yield from map(job, items)
            return
        waiting: deque[_Work[Item, Answer]] = deque()
        for item in items:
            waiting.append(_Work(item, self._submit(job, item)))
            if len(waiting) > self._ahead:
                yield self._answer(job, waiting)
        while waiting:
            yield self._answer(job, waiting)

    def _started(self) -> ProcessPoolExecutor:
        """Workers that load their libraries, where they have to, while the caller prepares."""
        context = multiprocessing.get_context(_start_method())
        with blank_main(), one_thread_each(), interrupts_wait(), suppress(BrokenProcessPool):
            executor = ProcessPoolExecutor(self._count, mp_context=context, initializer=prepare_worker)
            for _ in range(self._count):
                executor.submit(_wake)
        return executor

    def _submit(self, job: Callable[[Item], Answer], item: Item) -> Future[Answer] | None:
        """The future of a job; None where a worker has died meanwhile."""
        assert self._executor is not None
        try:
            with blank_main(), one_thread_each(), interrupts_wait():
                return self._executor.submit(job, item)
        except BrokenProcessPool:
            return None

    def _answer(self, job: Callable[[Item], Answer], waiting: deque[_Work[Item, Answer]]) -> Answer:
        """The answer of the job that waits longest."""
        while True:
            future = waiting[0].future
            try:
                if future is not None:
                    answer = future.result()
                    waiting.popleft()
                    return answer
            except BrokenProcessPool:
                pass
            self._restart()
            for work in waiting:
                if work.future is None or not work.future.done() or work.future.exception() is not None:
                    work.future = self._submit(job, work.item)

    def _restart(self) -> None:
        """Start the workers once more."""
        assert self._executor is not None
        self._executor.shutdown(wait=True, cancel_futures=True)
        if not self._may_restart:
            raise UnoccludeError(
                "Worker processes were killed twice; perhaps the memory does not suffice: use fewer of them"
                " (--processes), or a larger machine."
            )
        self._may_restart = False
        self._executor = self._started()


class _Work(Generic[Item, Answer]):
    """An item and the future of its job."""

    __slots__ = ("future", "item")

    def __init__(self, item: Item, future: Future[Answer] | None) -> None:
        self.item = item
        self.future = future


def _end_workers(executor: ProcessPoolExecutor) -> None:
    """End the workers in the middle of what they are doing."""
    for process in list((getattr(executor, "_processes", None) or {}).values()):
        with suppress(OSError, ValueError):
            process.terminate()
