"""What the live smoother answers: its state, the arm at a moment, and the output of a step."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import numpy as np

from ..array_types import FloatArray


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

    def widened(self, factor: float) -> LiveEstimate:
        """The same with sigmas times a factor."""
        joints = {joint: factor**2 * covariance for joint, covariance in self.joint_covariance.items()}
        return replace(self, pose_covariance=factor**2 * self.pose_covariance, joint_covariance=joints)

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
        The present as given to the step, on the IMU's clock.
    state : LiveState
        At the present.
    now : LiveEstimate or None
        Predicted to the present; None while calibrating, or with the IMU lost.
    settled : LiveEstimate or None
        `lag_s` before the present; None as above, and until the answer is long enough.
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
    doubt : str
        Why the answer is to be taken with care, in words; "" where nothing speaks against it.
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
    doubt: str = ""

    @property
    def trusted(self) -> bool:
        """There is an answer, and nothing speaks against it."""
        return self.now is not None and not self.doubt
