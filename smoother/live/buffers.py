"""Frames as they arrive, and the last minutes of them in order."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace

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
