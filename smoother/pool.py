"""Windows solved side by side in processes, or here when there are few."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from types import ModuleType, TracebackType

from .solve import solve
from .window import Solution, Window

#: With fewer nodes than this in all, starting processes costs more than it saves.
WORTH_NODES = 4000


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


def _wake() -> None:
    """Nothing: a worker that has run it has loaded its libraries."""


class Pool:
    """Solves windows in order; use as a context manager.

    Parameters
    ----------
    processes : worker processes, 0 = one a core.
    nodes : nodes of the whole job; a small one is solved here.
    """

    def __init__(self, processes: int, nodes: int) -> None:
        count = processes or os.cpu_count() or 1
        self._executor: ProcessPoolExecutor | None = None
        if count > 1 and nodes > WORTH_NODES:
            # spawn: GTSAM's threads do not survive a fork, and macOS and Windows have no other way
            context = multiprocessing.get_context("spawn")
            self._executor = ProcessPoolExecutor(count, mp_context=context)
            with blank_main():  # the workers load their libraries while the caller prepares
                for _ in range(count):
                    self._executor.submit(_wake)

    def __enter__(self) -> Pool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._executor is not None:
            self._executor.shutdown(wait=error is None, cancel_futures=True)

    def solve(
        self,
        windows: Iterable[Window],
        with_covariance: bool,
        done: Callable[[int], None],
        with_offset: bool = False,
    ) -> list[Solution]:
        """Solve every window (see `solve.solve`); `done` hears how many are finished.

        Windows that are made one by one are solved while the next ones are made.
        """
        job = partial(solve, with_covariance=with_covariance, with_offset=with_offset)
        results: Iterator[Solution] = map(job, windows)
        if self._executor is not None:
            with blank_main():
                results = self._executor.map(job, windows)
        solutions = []
        for solution in results:
            solutions.append(solution)
            done(len(solutions))
        return solutions
