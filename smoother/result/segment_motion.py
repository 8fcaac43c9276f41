"""The motion of IMUs on other segments, the upper arm and the trunk, at the samples of the forearm's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import rotation_sigma_deg, rows_of


@dataclass(frozen=True)
class SegmentMotion:
    """The IMU on a segment beyond the forearm at the forearm IMU's times; nan where it has no samples."""

    position: FloatArray  # (N, 3), m: In {K}
    quaternion: FloatArray  # (N, 4): qw, qx, qy, qz: from the IMU's axes to {K}
    pose_covariance: FloatArray  # (N, 6, 6), m and rad: Of (position in {K}, rotation vector in {K})
    # (3,), rad: How far the bone's axes may be from where `SegmentMounting.R_bone` has them, soft tissue
    # included, about each of them
    mount_sigma_rad: FloatArray
    clock_offset_s: float = float("nan")  # s: t_own = t_camera + offset, mean
    name: str = ""  # Of the IMU

    def rows(self, rows: slice | IntArray) -> SegmentMotion:
        """Some of the samples."""
        return rows_of(self, rows, "position", "quaternion", "pose_covariance")

    @property
    def sigma_m(self) -> FloatArray:
        """(N, 3) standard deviation of the IMU's position, m per axis of {K}."""
        return np.sqrt(np.einsum("nii->ni", self.pose_covariance[:, :3, :3]))

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.pose_covariance[:, 3:, 3:])


@dataclass(frozen=True)
class TrunkMotion:
    """The thorax at the forearm IMU's times; nan where the trunk's IMU has no samples."""

    # (N, 4): qw, qx, qy, qz of `R_K_T`: from the thorax's axes {T} (ISB: x forward, y up, z to its right)
    quaternion: FloatArray
    covariance: FloatArray  # (N, 3, 3), rad^2: Of the rotation vector in {K}
    R_T_D: FloatArray  # (3, 3): Mounting: maps a vector from the IMU's axes {D} to the thorax's
    mount_sigma_rad: FloatArray  # (3,), rad: How far the mounting may be off about each of the thorax's axes
    clock_offset_s: float = float("nan")  # s: t_trunk = t_camera + offset, mean
    name: str = "trunk"  # Of the IMU
    by_imu: bool = True  # By an IMU on it; False where it is by both shoulders as the camera sees them

    def rows(self, rows: slice | IntArray) -> TrunkMotion:
        """Some of the samples."""
        return rows_of(self, rows, "quaternion", "covariance")

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.covariance)
