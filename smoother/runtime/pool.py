"""Jobs done side by side in processes, or here when there is little to do."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from types import ModuleType, TracebackType
from typing import TypeVar

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


def _wake() -> None:
    """Nothing: a worker that has run it has loaded its libraries."""


Item = TypeVar("Item")
Answer = TypeVar("Answer")


class Pool:
    """Does jobs side by side and answers in order; use as a context manager.

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
        self._ahead = count + 1
        if count > 1 and frames > WORTH_FRAMES:
            # spawn: GTSAM's threads do not survive a fork, and macOS and Windows have no other way
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(count, mp_context=context)
            with (
                blank_main(),
                one_thread_each(),
            ):  # the workers load their libraries while the caller prepares
                for _ in range(count):
                    self._executor.submit(_wake)

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=error is None, cancel_futures=True)

    def map(self, job: Callable[[Item], Answer], items: Iterable[Item]) -> Iterator[Answer]:
        """The job's answers in the order of the items, of which no more are taken than keep all busy.

        Items that are made one by one are worked on while the next ones are made.
        """
        if self._executor is None:
            yield from map(job, items)
            return
        waiting: deque[Future[Answer]] = deque()
        for item in items:
            with blank_main():
                waiting.append(self._executor.submit(job, item))
            if len(waiting) > self._ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
