"""Samples of one inertial sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..array_types import BoolArray, FloatArray
from ..linalg import median_rate_hz, rows_of


@dataclass(frozen=True)
class ImuStream:
    """Samples of one inertial sensor, on its own clock, in its own axes.

    Attributes
    ----------
    name : str
        Where it came from (a topic, a file's section).
    t_s : ndarray, shape (N,), s
        Centre of the interval that a sample averages, after the recording's origin.
    acc : ndarray, shape (N, 3), m/s^2
        Specific force: at rest about +9.81 upwards.
    gyro : ndarray, shape (N, 3), rad/s
        Angular velocity.
    mag : ndarray, shape (N, 3), optional
        Magnetic field in the sensor's unit.
    mag_calibrated : bool
        `mag` is corrected, of length 1 in the field where it was calibrated.
    accelerometer_density, gyroscope_density : float, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz), optional
        White noise measured of this sensor.
    """

    name: str
    t_s: FloatArray
    acc: FloatArray
    gyro: FloatArray
    mag: FloatArray | None = None
    mag_calibrated: bool = False
    accelerometer_density: float | None = None
    gyroscope_density: float | None = None

    def __len__(self) -> int:
        return len(self.t_s)

    @cached_property
    def rate_hz(self) -> float:
        """Median sample rate, Hz (nan for fewer than two samples)."""
        return median_rate_hz(self.t_s)

    def select(self, rows: BoolArray | slice) -> ImuStream:
        """The same stream with some of the samples only."""
        return rows_of(self, rows, "t_s", "acc", "gyro", "mag")
