"""The arm at one moment, as the live smoother answers it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..array_types import FloatArray
from .live_state import LiveState


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
