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
    """The arm at one moment."""

    t_s: float  # The moment, on the IMU's clock
    kind: Literal["now", "settled"]  # Predicted to the present, or a lag ago
    state: LiveState  # `VISIBLE` or `GAP`, at that moment
    since_s: float | None  # When the gap began, on the IMU's clock; None where the forearm is visible
    position: FloatArray  # (3,) m: the IMU's in {K}
    quaternion: FloatArray  # (4,): qw, qx, qy, qz of `R_K_A`
    velocity: FloatArray  # (3,) m/s: the IMU's in {K}
    pose_covariance: FloatArray  # (6, 6) m^2, m rad, rad^2: of (position, rotation vector) in {K}
    joints: dict[str, FloatArray]  # dict of (3,) m: by joint in {K}
    joint_covariance: dict[str, FloatArray]  # dict of (3, 3) m^2: of each joint, in {K}

    def widened(self, factor: float) -> LiveEstimate:
        """The same with sigmas times a factor."""
        if factor == 1.0:
            return self
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
class LiveOutput:
    """What is known after a step."""

    now_s: float  # The present as given to the step, on the IMU's clock
    state: LiveState  # At the present
    now: LiveEstimate | None = None  # Predicted to the present; None while calibrating, or with the IMU lost
    settled: LiveEstimate | None = None  # `lag_s` before the present
    clock_offset_s: float = float("nan")  # t_imu = t_camera + offset
    clock_sigma_s: float = float("nan")  # The offset's standard deviation
    camera_latency_s: float = float("nan")  # From a frame's moment to its arrival, median of the last frames
    # What never took part since the beginning, by why: late, there before, not finite, skipped to catch up
    dropped: dict[str, int] = field(default_factory=dict)
    step_ms: float = float("nan")  # Processor time of this step
    # What happened in this step and should be said, one sentence each ("the camera's clock jumped ..")
    notes: tuple[str, ...] = ()
    calibration: str = ""  # How the self-calibration stands, in words
    doubt: str = ""  # Why the answer is to be taken with care, in words; "" where nothing speaks against it

    @property
    def trusted(self) -> bool:
        """There is an answer, and nothing speaks against it."""
        return self.now is not None and not self.doubt
