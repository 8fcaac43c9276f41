"""The last frames, and whether each showed the forearm."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right, insort

from ..array_types import FloatArray
from ..measurements.visibility import MISSING_S
from .answers import LiveState

#: This many frames are remembered.
FRAMES = 400


class FrameHistory:
    """The last frames, and whether each showed the forearm."""

    def __init__(self) -> None:
        self._frames: list[tuple[float, bool]] = []  # in order of time
        self.visible_s = -math.inf

    def add(self, t_s: float, is_visible: bool) -> None:
        """Add a frame, in any order."""
        insort(self._frames, (t_s, is_visible))
        del self._frames[:-FRAMES]
        if is_visible:
            self.visible_s = max(self.visible_s, t_s)

    def sees_all(self, t: FloatArray) -> bool:
        """Whether the forearm was visible all the time that nodes at these times (n,) cover."""
        if len(t) <= 5:
            return False
        first = bisect_left(self._frames, (float(t[0]), False))
        return all(is_visible for _, is_visible in self._frames[first:])

    def state_now(self, now_s: float, usual_delay_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at the present, as far as the frames that have arrived say."""
        if now_s - self.visible_s > usual_delay_s + MISSING_S:
            return LiveState.GAP, self.visible_s
        newest_s, is_visible = self._frames[-1] if self._frames else (0.0, True)
        if not is_visible and newest_s > self.visible_s:
            return LiveState.GAP, self.visible_s
        return LiveState.VISIBLE, None

    def state_at(self, t_s: float) -> tuple[LiveState, float | None]:
        """Visible or gap at a moment a little ago, and when the gap began."""
        after = bisect_right(self._frames, (t_s, True))
        before = (t for t, is_visible in reversed(self._frames[:after]) if is_visible)
        first = next(before, self.visible_s)
        last = next((t for t, is_visible in self._frames[after:] if is_visible), math.inf)
        if last - first > MISSING_S and t_s - first > 1e-6:
            return LiveState.GAP, first
        return LiveState.VISIBLE, None
