"""Samples and frames as they arrive, the last minutes of them in order, and the camera's clock.

What the live smoother answers: its state, the arm at a moment, and the output of a step.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

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


class LiveState(StrEnum):
    """Whether there is an answer, and what it rests on."""

    CALIBRATING = "calibrating"  # no answer yet, never a guess; until the first calibration has caught up
    VISIBLE = "visible"
    GAP = "gap"  # the camera does not see the forearm: the IMU and the upper arm's length go on
    LOST = "lost"  # the IMU stopped, or there is too much to catch up with: no answer until then


@dataclass(frozen=True)
class LiveEstimate:
    """The arm at one moment.

    Attributes
    ----------
    t_s : float, s
        The moment, on the IMU's clock.
    kind : {"now", "settled"}
        Predicted to the present, or a lag ago.
    state : LiveState
        `VISIBLE` or `GAP`, at that moment.
    since_s : float or None, s
        When the gap began, on the IMU's clock; None where the forearm is visible.
    position : ndarray, shape (3,), m
        The IMU's in {K}.
    quaternion : ndarray, shape (4,)
        qw, qx, qy, qz of `R_K_A`.
    velocity : ndarray, shape (3,), m/s
        The IMU's in {K}.
    pose_covariance : ndarray, shape (6, 6), m^2, m rad, rad^2
        Of (position, rotation vector) in {K}.
    joints : dict of str to ndarray, shape (3,), m
        By joint in {K}: those with a lever arm, and the shoulder where the camera sees one.
    joint_covariance : dict of str to ndarray, shape (3, 3), m^2
        Of each joint, in {K}.
    offset : ndarray, shape (3,), m
        What of a jump is still to be spread: contained in the positions, and in their covariance.
    """

    t_s: float
    kind: Literal["now", "settled"]
    state: LiveState
    since_s: float | None
    position: FloatArray
    quaternion: FloatArray
    velocity: FloatArray
    pose_covariance: FloatArray
    joints: dict[str, FloatArray]
    joint_covariance: dict[str, FloatArray]
    offset: FloatArray

    @property
    def sigma_m(self) -> float:
        """Square root of the trace of the position's covariance, m."""
        return float(np.sqrt(np.trace(self.pose_covariance[:3, :3])))

    @property
    def sigma_deg(self) -> float:
        """Square root of the trace of the rotation's covariance, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.pose_covariance[3:, 3:]))))


@dataclass(frozen=True)
class Dropped:
    """What never took part, counted since the beginning.

    Attributes
    ----------
    late_samples, late_frames : int
        Older than the smoother sorts in.
    duplicate_samples, duplicate_frames : int
        A stamp that had been there before.
    invalid_samples : int
        Not finite.
    backlog_frames : int
        Skipped to catch up with the present.
    """

    late_samples: int = 0
    late_frames: int = 0
    duplicate_samples: int = 0
    duplicate_frames: int = 0
    invalid_samples: int = 0
    backlog_frames: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return (
            self.late_samples
            + self.late_frames
            + self.duplicate_samples
            + self.duplicate_frames
            + self.invalid_samples
            + self.backlog_frames
        )


@dataclass(frozen=True)
class LiveOutput:
    """What is known after a step.

    Attributes
    ----------
    now_s : float, s
        The present as the step was told it, on the IMU's clock.
    state : LiveState
        At the present.
    now : LiveEstimate or None
        Predicted to the present; None while calibrating, or with the IMU lost.
    settled : LiveEstimate or None
        `lag_s` before the present; None as above, and until there is so much of an answer.
    clock_offset_s, clock_sigma_s : float, s
        t_imu = t_camera + offset, and its standard deviation; nan before it is known.
    camera_latency_s : float, s
        From a frame's moment to its arrival, median of the last frames; nan before it is known.
    imu_rate_hz, frame_rate_hz : float, Hz
        Of the last seconds; nan without samples.
    dropped : Dropped
        Since the beginning.
    load : float
        Processor time of the steps as a share of one core, over the last seconds.
    step_ms : float, ms
        Processor time of this step.
    notes : tuple of str
        What happened in this step and should be said, one sentence each ("the camera's clock jumped ..").
    calibration : str
        How the self-calibration stands, in words.
    """

    now_s: float
    state: LiveState
    now: LiveEstimate | None = None
    settled: LiveEstimate | None = None
    clock_offset_s: float = float("nan")
    clock_sigma_s: float = float("nan")
    camera_latency_s: float = float("nan")
    imu_rate_hz: float = float("nan")
    frame_rate_hz: float = float("nan")
    dropped: Dropped = field(default_factory=Dropped)
    load: float = float("nan")
    step_ms: float = float("nan")
    notes: tuple[str, ...] = ()
    calibration: str = ""
