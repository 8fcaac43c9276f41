"""One continuous clock of the camera's stamps."""

from __future__ import annotations

from collections import deque
from statistics import median

import numpy as np

from .buffers import SkeletonFrame

#: A camera's latency before anything is known of it, s.
USUAL_LATENCY_S = 0.1
#: Frames behind the median of what is usual, and frames in a row that make a jump.
USUAL_FRAMES, JUMP_FRAMES = 60, 10
#: A jump is larger than this, s, and the frames after it agree to this share of it.
JUMP_S, AGREE = 0.08, 0.25


class CameraClock:
    """Makes one continuous clock of the camera's stamps.

    The time from a frame's stamp to its arrival is latency plus the clocks' difference. Where it changes at
    once and stays, the clock was set (or the latency has changed; the next calibration tells).

    Attributes
    ----------
    correction_s : float, s
        What is added to the camera's stamps since the jumps so far.
    """

    def __init__(self) -> None:
        self.correction_s = 0.0
        self._usual: deque[float] = deque(maxlen=USUAL_FRAMES)
        self._delay_s: float | None = None
        self._doubtful: list[SkeletonFrame] = []

    def __len__(self) -> int:
        return len(self._usual)

    @property
    def delay_s(self) -> float:
        """Median time from a corrected stamp to the arrival, s: latency plus offset; nan without a frame."""
        if self._delay_s is None:
            self._delay_s = median(self._usual) if self._usual else float("nan")
        return self._delay_s

    def take(self, frame: SkeletonFrame) -> tuple[list[SkeletonFrame], float]:
        """Frames that can be used now, with continuous stamps, and by how much the clock has jumped.

        A frame that does not fit the others waits until some more show whether it was late or the clock set.
        """
        delay_s = frame.arrival_s - frame.t_s - self.correction_s
        usual_s = self.delay_s
        if len(self._usual) < JUMP_FRAMES or abs(delay_s - usual_s) < JUMP_S:
            self._usual.append(delay_s)
            self._delay_s = None
            ready, self._doubtful = [*self._doubtful, frame], []
            return [self._corrected(each) for each in ready], 0.0
        self._doubtful.append(frame)
        if len(self._doubtful) < JUMP_FRAMES:
            return [], 0.0
        delays = [each.arrival_s - each.t_s - self.correction_s for each in self._doubtful]
        jump_s = float(np.median(delays)) - usual_s
        ready, self._doubtful = self._doubtful, []
        if np.ptp(delays) > AGREE * abs(jump_s):  # late by different times: no clock does that
            return [self._corrected(each) for each in ready], 0.0
        self.correction_s += jump_s
        return [self._corrected(each) for each in ready], jump_s

    def later(self, seconds: float) -> None:
        """The last jump was the latency's: the stamps were right, and frames come so much later now."""
        self.correction_s -= seconds
        self._usual.clear()
        self._delay_s = None

    def _corrected(self, frame: SkeletonFrame) -> SkeletonFrame:
        return SkeletonFrame(frame.t_s + self.correction_s, frame.arrival_s, frame.position, frame.state)
