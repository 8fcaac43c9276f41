"""The last minutes of the camera's frames, sorted, whatever the order they arrived in."""

from __future__ import annotations

from bisect import bisect_left, insort

import numpy as np

from ..recording import JOINTS, JointTracks
from .imu_buffer import LATE_S
from .skeleton_frame import SkeletonFrame


class FrameBuffer:
    """Frames of the last seconds.

    Parameters
    ----------
    capacity_s : float, s
        How much is held.

    Attributes
    ----------
    late, duplicate : int
        Frames that were not taken, and why.
    """

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._frames: list[SkeletonFrame] = []
        self.late = self.duplicate = 0

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def end_s(self) -> float:
        """Stamp of the newest frame, s on the camera's clock; -inf without any."""
        return self._frames[-1].t_s if self._frames else -np.inf

    def add(self, frame: SkeletonFrame) -> bool:
        """Sort a frame in; False where it is too late or was here already."""
        if not np.isfinite(frame.t_s) or frame.t_s < self.end_s - LATE_S:
            self.late += 1
            return False
        index = bisect_left(self._frames, frame.t_s, key=_stamp)
        if index < len(self._frames) and self._frames[index].t_s == frame.t_s:
            self.duplicate += 1
            return False
        insort(self._frames, frame, key=_stamp)
        if frame.t_s - self._frames[0].t_s > 1.25 * self._capacity_s:
            del self._frames[: bisect_left(self._frames, frame.t_s - self._capacity_s, key=_stamp)]
        return True

    def since(self, t_s: float) -> list[SkeletonFrame]:
        """Frames from a stamp on, s on the camera's clock."""
        return self._frames[bisect_left(self._frames, t_s, key=_stamp) :]

    def tracks(self, start_s: float) -> JointTracks:
        """The frames from a stamp on as tracks of joints."""
        frames = self.since(start_s)
        return JointTracks(
            "live",
            np.array([frame.t_s for frame in frames]),
            np.array([frame.position for frame in frames], dtype=float).reshape(-1, len(JOINTS), 3),
            np.array([frame.state for frame in frames], dtype=np.int8).reshape(-1, len(JOINTS)),
        )


def _stamp(frame: SkeletonFrame) -> float:
    return frame.t_s
