"""The last frames, and whether each showed the forearm."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..array_types import FloatArray
from ..measurements.visibility import MISSING_S
from .answers import LiveState

#: So many frames are remembered.
FRAMES = 400


class FrameHistory:
    """The last frames, and whether each showed the forearm.

    Attributes
    ----------
    visible_s : float, s
        Time of the last visible frame, on the IMU's clock.
    """

    def __init__(self) -> None:
        self._frames: deque[tuple[float, bool]] = deque(maxlen=FRAMES)
        self.visible_s = -np.inf

    def add(self, t_s: float, is_visible: bool) -> None:
        """Add a frame, in any order."""
        self._frames.append((t_s, is_visible))
        if is_visible:
            self.visible_s = max(self.visible_s, t_s)

    def sees_all(self, t: FloatArray) -> bool:
        """Whether the forearm was visible all the time that nodes at these times (n,) cover."""
        return len(t) > 5 and all(is_visible for t_s, is_visible in self._frames if t_s >= t[0])

    def state_now(self, now_s: float, usual_delay_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at the present, as far as the frames that have arrived say.

        Parameters
        ----------
        now_s : float, s
        usual_delay_s : float, s
            How late frames are.

        Returns
        -------
        state : LiveState
        since_s : float or None
            When the gap began.
        """
        if now_s - self.visible_s > usual_delay_s + MISSING_S:
            return LiveState.GAP, self.visible_s
        newest_s, is_visible = max(self._frames, default=(0.0, True))
        if not is_visible and newest_s > self.visible_s:
            return LiveState.GAP, self.visible_s
        return LiveState.VISIBLE, None

    def state_at(self, t_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at a moment a little ago, and when the gap began."""
        visible = sorted(t for t, is_visible in self._frames if is_visible)
        before = [t for t in visible if t <= t_s]
        after = [t for t in visible if t > t_s]
        first = before[-1] if before else self.visible_s
        last = after[0] if after else np.inf
        if last - first > MISSING_S and t_s - first > 1e-6:
            return LiveState.GAP, first
        return LiveState.VISIBLE, None
