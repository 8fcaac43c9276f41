"""Samples and frames as they arrive, the last minutes of them in order, and the camera's clock."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..recording import JOINTS, ImuStream, JointTracks


@dataclass(frozen=True)
class SkeletonFrame:
    """One arm in one frame of the camera.

    Attributes
    ----------
    t_s : float, s
        Its stamp, on the camera's clock.
    arrival_s : float, s
        When it arrived here, on the clock that `LiveSmoother.step` is told the time of (the IMU's).
    position : ndarray, shape (5, 3), m
        In {K}, joints in the order of `JOINTS`; nan where there is none.
    state : ndarray of int8, shape (5,)
        `JointState` values.
    """

    t_s: float
    arrival_s: float
    position: FloatArray
    state: NDArray[np.int8]


@dataclass(frozen=True)
class ImuBatch:
    """Some samples of the forearm IMU, as they arrived together.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Centre of the interval that a sample averages, on the IMU's clock.
    acc : ndarray, shape (n, 3), m/s^2
        Specific force in {A}: at rest about +9.81 upwards.
    gyro : ndarray, shape (n, 3), rad/s
        Angular velocity in {A}.
    """

    t_s: FloatArray
    acc: FloatArray
    gyro: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)


#: Samples older than this against the newest are not sorted in, s.
LATE_S = 0.5
#: So much more than its capacity is held before the oldest go (share).
SLACK = 0.25


class ImuBuffer:
    """Samples of the last seconds.

    Parameters
    ----------
    capacity_s : float, s
        How much is held.

    Attributes
    ----------
    late, duplicate, invalid : int
        Samples that were not taken, and why.
    version : int
        Goes up whenever samples come.
    """

    def __init__(self, capacity_s: float) -> None:
        self._capacity_s = capacity_s
        self._rows = np.zeros((1024, 7))
        self._count = self.version = 0
        self.late = self.duplicate = self.invalid = 0

    def __len__(self) -> int:
        return self._count

    @property
    def t(self) -> FloatArray:
        """Times of the samples, s; a view."""
        return self._rows[: self._count, 0]

    @property
    def end_s(self) -> float:
        """Time of the newest sample, s; -inf without any."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def add(self, batch: ImuBatch) -> float | None:
        """Sort samples in.

        Parameters
        ----------
        batch : ImuBatch

        Returns
        -------
        changed_s : float or None
            The earliest sample that came after later ones; None where all are new.
        """
        rows = np.column_stack([batch.t_s, batch.acc, batch.gyro]).astype(float)
        finite = np.isfinite(rows).all(axis=1)
        self.invalid += int((~finite).sum())
        rows = rows[finite]
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        if not len(rows):
            return None
        newest_s = max(self.end_s, float(rows[-1, 0]))
        late = rows[:, 0] < newest_s - LATE_S
        if self._count:  # a first batch may be as long as it likes
            self.late += int(late.sum())
            rows = rows[~late]
        fresh = np.diff(rows[:, 0], prepend=-np.inf) > 0
        before_s = self.end_s
        inside = rows[:, 0] <= before_s
        if inside.any():
            fresh &= ~np.isin(rows[:, 0], self.t)
        self.duplicate += int((~fresh).sum())
        rows, inside = rows[fresh], inside[fresh]
        if not len(rows):
            return None
        self.version += 1
        self._reserve(len(rows))
        if not inside.any():
            self._rows[self._count : self._count + len(rows)] = rows
            self._count += len(rows)
            return None
        first = int(np.searchsorted(self.t, rows[0, 0]))
        tail = np.concatenate([self._rows[first : self._count], rows])
        self._count += len(rows)
        self._rows[first : self._count] = tail[np.argsort(tail[:, 0], kind="stable")]
        return float(rows[0, 0])

    def since_pause_s(self, longest_s: float, looked_s: float) -> float:
        """Where the samples begin that have no longer pause, within the last `looked_s`; s."""
        t = self.t[int(np.searchsorted(self.t, self.end_s - looked_s)) :]
        pauses = np.flatnonzero(np.diff(t) > longest_s)
        return float(t[pauses[-1] + 1]) if len(pauses) else float(t[0])

    def stream(self, start_s: float, end_s: float = np.inf) -> ImuStream:
        """A copy of the samples from one time to another."""
        rows = self._rows[slice(*np.searchsorted(self.t, [start_s, end_s]).tolist())].copy()
        return ImuStream("live", rows[:, 0], rows[:, 1:4], rows[:, 4:])

    def _reserve(self, more: int) -> None:
        """Make place for more samples: the oldest go, or the array grows."""
        if self._count + more <= len(self._rows):
            return
        keep = int(np.searchsorted(self.t, self.end_s - self._capacity_s))
        held = self._rows[keep : self._count]
        size = max(int((1.0 + SLACK) * (len(held) + more)), 1024)
        rows = np.zeros((size, 7))
        rows[: len(held)] = held
        self._rows, self._count = rows, len(held)


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
        self._doubtful: list[SkeletonFrame] = []

    def __len__(self) -> int:
        return len(self._usual)

    @property
    def delay_s(self) -> float:
        """Median time from a corrected stamp to the arrival, s: latency plus offset; nan without a frame."""
        return float(np.median(self._usual)) if self._usual else float("nan")

    def take(self, frame: SkeletonFrame) -> tuple[list[SkeletonFrame], float]:
        """Frames that can be used now, with continuous stamps, and by how much the clock has jumped.

        A frame that does not fit the others waits until some more show whether it was late or the clock set.
        """
        delay_s = frame.arrival_s - frame.t_s - self.correction_s
        usual_s = self.delay_s
        if len(self._usual) < JUMP_FRAMES or abs(delay_s - usual_s) < JUMP_S:
            self._usual.append(delay_s)
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

    def _corrected(self, frame: SkeletonFrame) -> SkeletonFrame:
        return SkeletonFrame(frame.t_s + self.correction_s, frame.arrival_s, frame.position, frame.state)
