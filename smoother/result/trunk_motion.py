"""The orientation of the trunk by an IMU on it, at the same samples as the forearm's motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..array_types import FloatArray, IntArray
from ..linalg import rotation_sigma_deg


@dataclass(frozen=True)
class TrunkMotion:
    """The thorax at the forearm IMU's times; nan where the trunk's IMU has no samples.

    Attributes
    ----------
    quaternion : ndarray, shape (N, 4)
        qw, qx, qy, qz of `R_K_T`: from the thorax's axes {T} (ISB: x forward, y up, z to its right).
    covariance : ndarray, shape (N, 3, 3), rad^2
        Of the rotation vector in {K}.
    R_T_D : ndarray, shape (3, 3)
        Mounting: maps a vector from the IMU's axes {D} to the thorax's.
    mount_sigma_rad : ndarray, shape (3,), rad
        How far the mounting may be off about each of the thorax's axes.
    clock_offset_s : float, s
        t_trunk = t_camera + offset, mean.
    name : str
        Of the IMU.
    """

    quaternion: FloatArray
    covariance: FloatArray
    R_T_D: FloatArray
    mount_sigma_rad: FloatArray
    clock_offset_s: float = float("nan")
    name: str = "trunk"

    def rows(self, rows: slice | IntArray) -> TrunkMotion:
        """Some of the samples."""
        return replace(self, quaternion=self.quaternion[rows], covariance=self.covariance[rows])

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.covariance)
