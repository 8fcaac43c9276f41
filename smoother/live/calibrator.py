"""Who works the self-calibration out while the arm is followed."""

from __future__ import annotations

import math
import multiprocessing
import os
from abc import ABC, abstractmethod
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress

from ..runtime.pool import blank_main, one_thread_each
from ..runtime.worker import interrupts_wait, prepare_worker
from .calibration_job import CalibrationJob, LiveCalibration, calibrate_excerpts

#: The background leaves the processor to what is live (`os.nice`).
NICE = 10


class Calibrator(ABC):
    """Works one self-calibration out at a time."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """It works, or its answer was not fetched yet."""

    @abstractmethod
    def submit(self, job: CalibrationJob) -> None:
        """Begin with a job; not while busy."""

    @abstractmethod
    def answer(self) -> LiveCalibration | None:
        """The answer, once; None while there is none."""

    def close(self) -> None:  # noqa: B027 - nothing to end unless there is a process
        """End what it works at."""


class InlineCalibrator(Calibrator):
    """Works at once, in this process: for recordings that are played as fast as possible.

    Parameters
    ----------
    delay : int
        The answer is there only when it was asked for so many times: a background's time, in steps.
    """

    def __init__(self, delay: int = 0) -> None:
        self._delay, self._asked = delay, 0
        self._answer: LiveCalibration | None = None

    @property
    def busy(self) -> bool:
        """As `Calibrator.busy`."""
        return self._answer is not None

    def submit(self, job: CalibrationJob) -> None:
        """As `Calibrator.submit`."""
        with ThreadPoolExecutor(1) as aside:  # its processor time is not the live thread's
            self._answer, self._asked = aside.submit(calibrate_excerpts, job).result(), 0

    def answer(self) -> LiveCalibration | None:
        """As `Calibrator.answer`."""
        self._asked += 1
        if self._answer is None or self._asked <= self._delay:
            return None
        answer, self._answer = self._answer, None
        return answer


class BackgroundCalibrator(Calibrator):
    """Works in a process of its own, which ends with this one."""

    def __init__(self) -> None:
        self._executor: ProcessPoolExecutor | None = None
        self._future: Future[LiveCalibration] | None = None

    @property
    def busy(self) -> bool:
        """As `Calibrator.busy`."""
        return self._future is not None

    def submit(self, job: CalibrationJob) -> None:
        """As `Calibrator.submit`."""
        # spawn: GTSAM's threads do not survive a fork, and macOS and Windows have no other way
        with blank_main(), one_thread_each(), interrupts_wait(), suppress(BrokenProcessPool):
            if self._executor is None:
                context = multiprocessing.get_context("spawn")
                self._executor = ProcessPoolExecutor(1, mp_context=context, initializer=_prepare)
            self._future = self._executor.submit(calibrate_excerpts, job)

    def answer(self) -> LiveCalibration | None:
        """As `Calibrator.answer`; a process that was killed is started again with the next job."""
        if self._future is None or not self._future.done():
            return None
        future, self._future = self._future, None
        try:
            return future.result()
        except BrokenProcessPool:
            self.close()
            return LiveCalibration(
                math.nan, math.nan, reason="the background process was ended; it is started again"
            )

    def close(self) -> None:
        """As `Calibrator.close`."""
        if self._executor is None:
            return
        for process in list((getattr(self._executor, "_processes", None) or {}).values()):
            with suppress(OSError, ValueError):
                process.terminate()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor, self._future = None, None


def _prepare() -> None:
    prepare_worker()
    with suppress(OSError, AttributeError):
        os.nice(NICE)
