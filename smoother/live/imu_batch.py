"""Samples of the forearm IMU as they arrive."""

from __future__ import annotations

from dataclasses import dataclass

from ..array_types import FloatArray


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
