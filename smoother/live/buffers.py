"""Frames as they arrive: stamps on one continuous clock, and the last minutes of them in order."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, replace
from enum import Enum
from statistics import median

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..recording import JOINTS, JointTracks


@dataclass(frozen=True)
class SkeletonFrame:
    """One arm in one frame of the camera."""

    t_s: float  # Its stamp, on the camera's clock
    # When it arrived here, on the clock of the time given to `LiveSmoother.step` (the IMU's)
    arrival_s: float
    position: FloatArray  # (5, 3) m: in {K}, joints in the order of `JOINTS`; nan where there is none
    state: NDArray[np.int8]  # int (5,): `JointState` values


#: Samples and frames older than this against the newest are not sorted in, s.
LATE_S = 0.5
#: Held for this many times the capacity at most; then the oldest go.
SLACK = 1.25


class FrameBuffer:
    """Frames of the last seconds."""

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._frames: list[SkeletonFrame] = []
        self._left_out: list[SkeletonFrame] = []
        self.late = self.duplicate = 0

    def __len__(self) -> int:
        return len(self._frames)

    def _at(self, t_s: float) -> int:
        """How many frames are before a stamp."""
        return bisect_left(self._frames, t_s, key=lambda frame: frame.t_s)

    def _has(self, index: int, t_s: float) -> bool:
        return index < len(self._frames) and self._frames[index].t_s == t_s

    def add(self, frame: SkeletonFrame) -> bool:
        """Sort a frame in; False where it is too late or was here already."""
        t_s, newest_s = frame.t_s, self._frames[-1].t_s if self._frames else -np.inf
        if not np.isfinite(t_s) or t_s < newest_s - LATE_S:
            self.late += 1
            return False
        if self._has(index := self._at(t_s), t_s):
            self.duplicate += 1
            return False
        self._frames.insert(index, frame)
        if t_s - self._frames[0].t_s > SLACK * self._capacity_s:
            del self._frames[: self._at(t_s - self._capacity_s)]
        return True

    def leave_out(self, since_s: float, until_s: float) -> None:
        """Take the joints of frames out, as long as they are not restored."""
        for index in range(self._at(since_s), self._at(until_s)):
            frame = self._frames[index]
            if frame.state.any():
                self._left_out.append(frame)
                self._frames[index] = replace(frame, state=np.zeros_like(frame.state))

    def restore(self) -> None:
        """Put those back that were left out: it was not the camera that was wrong."""
        for frame in self._left_out:
            if self._has(index := self._at(frame.t_s), frame.t_s):
                self._frames[index] = frame
        self.confirm()

    def confirm(self) -> None:
        """Those that were left out stay out."""
        self._left_out = []

    def since(self, t_s: float) -> list[SkeletonFrame]:
        """Frames from a stamp on, s on the camera's clock."""
        return self._frames[self._at(t_s) :]

    def tracks(self, start_s: float) -> JointTracks:
        """The frames from a stamp on as tracks of joints."""
        frames = self.since(start_s)
        return JointTracks(
            "live",
            np.array([frame.t_s for frame in frames]),
            np.array([frame.position for frame in frames], dtype=float).reshape(-1, len(JOINTS), 3),
            np.array([frame.state for frame in frames], dtype=np.int8).reshape(-1, len(JOINTS)),
        )


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
        self._doubtful: list[SkeletonFrame] = []
        self._cause = ShiftCause.OPEN

    @property
    def delay_s(self) -> float:
        """Median time from a corrected stamp to the arrival, s: latency plus offset; nan without a frame."""
        return median(self._usual) if self._usual else float("nan")

    def _is_usual(self, off_s: float) -> bool:
        """Whether a frame is off the usual delay by no more than delays are, or too few are known."""
        delay_s = self.delay_s
        if len(self._usual) < JUMP_FRAMES:
            return True
        deviation_s = median(abs(each - delay_s) for each in self._usual)
        return abs(off_s) < min(max(1.4826 * JUMP_SIGMAS * deviation_s, LEAST_JUMP_S), JUMP_S)

    def take(self, frame: SkeletonFrame) -> tuple[list[SkeletonFrame], Shift | None]:
        """Frames that can be used now, with continuous stamps, and the jump that they end, if they do."""
        off_s = frame.arrival_s - frame.t_s - self.correction_s - self.delay_s
        after_s = frame.t_s + self.correction_s - self._newest_s
        since_s, self._arrival_s = frame.arrival_s - self._arrival_s, frame.arrival_s
        if self._is_usual(off_s):
            if 0.0 < after_s < math.inf:
                self._intervals.append(after_s)
            self._usual.append(frame.arrival_s - frame.t_s - self.correction_s)
            self._newest_s = max(self._newest_s, frame.t_s + self.correction_s)
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

    def _ended(self, frame: SkeletonFrame) -> list[SkeletonFrame]:
        """A usual frame, after those that waited for it."""
        waited = [] if self._cause is ShiftCause.LATENCY else self._doubtful
        self._doubtful = []
        newest_s = max((each.t_s + self.correction_s for each in waited), default=-math.inf)
        self._newest_s = max(self._newest_s, newest_s)
        return self._corrected([*waited, frame])

    def _corrected(self, frames: list[SkeletonFrame]) -> list[SkeletonFrame]:
        return [replace(each, t_s=each.t_s + self.correction_s) for each in frames]
