"""One continuous clock of the camera's stamps."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
from statistics import median

from .buffers import SkeletonFrame

#: A camera's latency before anything is known of it, s.
USUAL_LATENCY_S = 0.1
#: Frames behind the median of what is usual, and frames in a row that make a jump.
USUAL_FRAMES, JUMP_FRAMES = 60, 10
#: A jump is larger than this many usual deviations of the delay, at least the first and at most the second,
#: s; the frames after it agree to this share of it.
JUMP_SIGMAS, LEAST_JUMP_S, JUMP_S, AGREE = 6.0, 0.03, 0.08, 0.25


class ShiftCause(Enum):
    """Why frames come at another time after their stamps than before."""

    CLOCK = "clock"  # it was set: their stamps have a step
    LATENCY = "latency"  # the camera's: their arrivals have one
    OPEN = "open"  # stamps and arrivals do not say


@dataclass(frozen=True)
class Shift:
    """From some frame on, frames come at another time after their stamps."""

    seconds: float  # s: how much later
    cause: ShiftCause


class CameraClock:
    """Makes one continuous clock of the camera's stamps."""

    def __init__(self) -> None:
        self.correction_s = 0.0
        self._usual: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._intervals: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._newest_s = self._arrival_s = -math.inf  # corrected stamp; of the last
        self._delay_s: float | None = None
        self._limit_s = JUMP_S
        self._doubtful: list[SkeletonFrame] = []
        self._cause = ShiftCause.OPEN

    @property
    def delay_s(self) -> float:
        """Median time from a corrected stamp to the arrival, s: latency plus offset; nan without a frame."""
        if self._delay_s is None:
            self._delay_s = median(self._usual) if self._usual else float("nan")
            deviation_s = median(abs(each - self._delay_s) for each in self._usual) if self._usual else JUMP_S
            self._limit_s = min(max(1.4826 * JUMP_SIGMAS * deviation_s, LEAST_JUMP_S), JUMP_S)
        return self._delay_s

    def take(self, frame: SkeletonFrame) -> tuple[list[SkeletonFrame], Shift | None]:
        """Frames that can be used now, with continuous stamps, and the jump that they end, if they do."""
        off_s = frame.arrival_s - frame.t_s - self.correction_s - self.delay_s
        after_s = frame.t_s + self.correction_s - self._newest_s
        since_s, self._arrival_s = frame.arrival_s - self._arrival_s, frame.arrival_s
        if len(self._usual) < JUMP_FRAMES or abs(off_s) < self._limit_s:
            if 0.0 < after_s < math.inf:
                self._intervals.append(after_s)
            self._learn(frame)
            return self._ended(frame), None
        if not self._doubtful:
            self._cause = self._cause_of(after_s, since_s, off_s)
        self._doubtful.append(frame)
        is_late = self._cause is ShiftCause.LATENCY
        if is_late:
            self._newest_s = max(self._newest_s, frame.t_s + self.correction_s)
        ready = [frame] if is_late else []
        if len(self._doubtful) < JUMP_FRAMES:
            return self._corrected(ready), None
        delays = [each.arrival_s - each.t_s - self.correction_s for each in self._doubtful]
        jump_s = median(delays) - self.delay_s
        ready, self._doubtful = ready or self._doubtful, []
        if max(delays) - min(delays) > AGREE * abs(jump_s):  # late by different times: no clock does that
            return self._corrected(ready), None
        if is_late:
            self._usual.clear()
            self._usual.extend(delays)
            self._delay_s = None
        else:
            self.correction_s += jump_s
            self._newest_s = frame.t_s + self.correction_s
        return self._corrected(ready), Shift(jump_s, self._cause)

    def _cause_of(self, after_s: float, since_s: float, off_s: float) -> ShiftCause:
        """Whether the stamps or the arrivals have a step of this size at a frame."""
        if len(self._intervals) < JUMP_FRAMES:
            return ShiftCause.OPEN
        usual_s, limit_s = median(self._intervals), AGREE * abs(off_s)
        if abs(after_s - usual_s) < limit_s:
            return ShiftCause.LATENCY
        if abs(since_s - usual_s) < limit_s and abs(after_s - usual_s + off_s) < limit_s:
            return ShiftCause.CLOCK
        return ShiftCause.OPEN

    def _learn(self, frame: SkeletonFrame) -> None:
        self._usual.append(frame.arrival_s - frame.t_s - self.correction_s)
        self._newest_s = max(self._newest_s, frame.t_s + self.correction_s)
        self._delay_s = None

    def _ended(self, frame: SkeletonFrame) -> list[SkeletonFrame]:
        """A usual frame, after those that waited for it."""
        waited = [] if self._cause is ShiftCause.LATENCY else self._doubtful
        self._doubtful = []
        newest_s = max((each.t_s + self.correction_s for each in waited), default=-math.inf)
        self._newest_s = max(self._newest_s, newest_s)
        return self._corrected([*waited, frame])

    def _corrected(self, frames: list[SkeletonFrame]) -> list[SkeletonFrame]:
        return [replace(each, t_s=each.t_s + self.correction_s) for each in frames]
