"""What is kept of a sensor in the calibration file, and its corrections to a stream.

::

    [imu.forearm_right.accelerometer]    # corrected = matrix @ (raw - offset), m/s^2
    offset = [0.12, -0.31, 0.05]
    matrix = [[1.002, 0.001, 0.0], [0.001, 0.998, 0.0], [0.0, 0.0, 1.01]]
    noise_density = 0.0012               # m/s^2/sqrt(Hz), from a long rest

    [imu.forearm_right.gyroscope]        # corrected = raw - offset, rad/s
    offset = [0.01, 0.0, -0.003]
    noise_density = 0.0001               # rad/s/sqrt(Hz)

    [imu.forearm_right.magnetometer]     # corrected = matrix @ (raw - offset), of length 1
    offset = [12.0, -3.1, 30.2]
    matrix = [[0.02, 0.0, 0.0], [0.0, 0.021, 0.0], [0.0, 0.0, 0.019]]

The name is the topic's, without `/imu/`. Every table and every key but those of a matrix may be absent; keys
that are not named here are kept, and are there for the reader.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream

from ..file import CalibrationFile


@dataclass(frozen=True)
class SensorCalibration:
    """Corrections of one sensor; None where nobody measured.

    Attributes
    ----------
    accelerometer : tuple of ndarray, optional
        Offset (3,) and matrix (3, 3).
    gyroscope : ndarray, optional
        Offset (3,).
    magnetometer : tuple of ndarray, optional
        Offset (3,) and matrix (3, 3).
    accelerometer_density, gyroscope_density : float, optional
        White noise, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz).
    """

    accelerometer: tuple[FloatArray, FloatArray] | None = None
    gyroscope: FloatArray | None = None
    magnetometer: tuple[FloatArray, FloatArray] | None = None
    accelerometer_density: float | None = None
    gyroscope_density: float | None = None

    def apply(self, imu: ImuStream) -> ImuStream:
        """The corrected stream."""
        acc, gyro, mag = imu.acc, imu.gyro, imu.mag
        if self.accelerometer is not None:
            offset, matrix = self.accelerometer
            acc = (acc - offset) @ matrix.T
        if self.gyroscope is not None:
            gyro = gyro - self.gyroscope
        if self.magnetometer is not None and mag is not None:
            offset, matrix = self.magnetometer
            mag = (mag - offset) @ matrix.T
        return replace(
            imu,
            acc=acc,
            gyro=gyro,
            mag=mag,
            mag_calibrated=mag is not None and self.magnetometer is not None,
            accelerometer_density=self.accelerometer_density,
            gyroscope_density=self.gyroscope_density,
        )

    @property
    def named(self) -> tuple[str, ...]:
        """What is corrected, in words."""
        pairs = (("accelerometer", self.accelerometer), ("gyroscope", self.gyroscope))
        return tuple(name for name, held in (*pairs, ("magnetometer", self.magnetometer)) if held is not None)


def sensor_name(topic: str) -> str:
    """A stream's name in the calibration file: its topic without `/imu/`."""
    return topic.strip("/").removeprefix("imu/") or "imu"


def sensor_of(file: CalibrationFile, topic: str) -> SensorCalibration | None:
    """The calibration of a stream's sensor; None where the file has none of that name.

    Raises
    ------
    CalibrationError
        A value of its table is not what it should be.
    """
    held = sensors_in(file).get(sensor_name(topic))
    if held is None:
        return None
    where = f"{file.source}: imu.{sensor_name(topic)}"
    parts = {name: _table(held, name, where) for name in ("accelerometer", "gyroscope", "magnetometer")}
    acc, gyro, mag = parts["accelerometer"], parts["gyroscope"], parts["magnetometer"]
    return SensorCalibration(
        accelerometer=_affine(acc, f"{where}.accelerometer"),
        gyroscope=_numbers(gyro, "offset", (3,), f"{where}.gyroscope"),
        magnetometer=_affine(mag, f"{where}.magnetometer"),
        accelerometer_density=_density(acc, f"{where}.accelerometer"),
        gyroscope_density=_density(gyro, f"{where}.gyroscope"),
    )


def sensors_in(file: CalibrationFile) -> dict[str, Any]:
    """The tables of all sensors, by name."""
    held = file.tables.get("imu", {})
    if not isinstance(held, dict) or not all(isinstance(table, dict) for table in held.values()):
        raise CalibrationError(f"{file.source}: imu must hold a table for each sensor, [imu.NAME].")
    return held


def _table(held: dict[str, Any], name: str, where: str) -> dict[str, Any]:
    table = held.get(name, {})
    if not isinstance(table, dict):
        raise CalibrationError(f"{where}.{name} must be a table.")
    return table


def _affine(table: dict[str, Any], where: str) -> tuple[FloatArray, FloatArray] | None:
    offset, matrix = _numbers(table, "offset", (3,), where), _numbers(table, "matrix", (3, 3), where)
    if offset is None and matrix is None:
        return None
    matrix = np.eye(3) if matrix is None else matrix
    if abs(np.linalg.det(matrix)) < 1e-12 * np.linalg.norm(matrix) ** 3:
        raise CalibrationError(f"{where}.matrix has no inverse; mend it or calibrate again.")
    return (np.zeros(3) if offset is None else offset), matrix


def _numbers(table: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> FloatArray | None:
    if key not in table:
        return None
    try:
        values = np.array(table[key], dtype=float)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        raise CalibrationError(f"{where}.{key} must hold {' x '.join(map(str, shape))} numbers.")
    return values


def _density(table: dict[str, Any], where: str) -> float | None:
    value = table.get("noise_density")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise CalibrationError(f"{where}.noise_density must be a number above zero.")
    return float(value)
