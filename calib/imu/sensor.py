"""What is kept of a sensor in the calibration file, and its corrections to a stream as it is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream, Recording
from smoother.runtime.store import large_array

from ..file import CalibrationFile


@dataclass(frozen=True)
class SensorCalibration:
    """Corrections of one sensor; None where not measured."""

    accelerometer: tuple[FloatArray, FloatArray] | None = None  # Offset (3,) and matrix (3, 3)
    gyroscope: FloatArray | None = None  # Offset (3,)
    magnetometer: tuple[FloatArray, FloatArray] | None = None  # Offset (3,) and matrix (3, 3)
    accelerometer_density: float | None = None  # White noise, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz)
    gyroscope_density: float | None = None  # White noise, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz)

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
    """The calibration of a stream's sensor; None where the file has none of that name."""
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
        raise CalibrationError(f"{file.source}: imu must contain a table for each sensor, [imu.NAME].")
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
        raise CalibrationError(f"{where}.matrix has no inverse; correct it or calibrate again.")
    return (np.zeros(3) if offset is None else offset), matrix


def _numbers(table: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> FloatArray | None:
    if key not in table:
        return None
    try:
        values = np.array(table[key], dtype=float)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if values.shape != shape or not np.isfinite(values).all():
        raise CalibrationError(f"{where}.{key} must contain {' x '.join(map(str, shape))} numbers.")
    return values


def _density(table: dict[str, Any], where: str) -> float | None:
    value = table.get("noise_density")
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < np.inf:
        raise CalibrationError(f"{where}.noise_density must be a number above zero.")
    return float(value)


#: Samples that are corrected together.
_SAMPLES = 65536


def corrected(recording: Recording, calibration: CalibrationFile) -> Recording:
    """The recording with its IMUs corrected where the file has their calibration, and a note of it."""
    imu, notes = _corrected(recording.imu, calibration)
    base = recording.base_imu
    if base is not None:
        base, more = _corrected(base, calibration)
        notes += more
    further = {}
    for name, stream in recording.further_imus.items():
        further[name], more = _corrected(stream, calibration)
        notes += more
    trunk = recording.trunk
    if trunk is not None:
        on_trunk, more = _corrected(trunk.imu, calibration)
        trunk = replace(trunk, imu=on_trunk)
        notes += more
    known = sensors_in(calibration)
    if known and not notes:
        notes.append(
            f"{calibration.source} corrects {', '.join(sorted(known))}; the recording's IMU is"
            f" {recording.imu.name} and was left uncorrected"
        )
    notes = [*recording.notes, *notes]
    return replace(recording, imu=imu, base_imu=base, further_imus=further, trunk=trunk, notes=tuple(notes))


def corrected_streams(streams: Sequence[ImuStream], file: CalibrationFile) -> tuple[list[ImuStream], bool]:
    """Streams of one IMU corrected by the file's values, and whether its accelerometer is known."""
    sensor = sensor_of(file, streams[0].name)
    if sensor is None:
        return list(streams), False
    once = {id(stream): sensor.apply(stream) for stream in streams}
    return [once[id(stream)] for stream in streams], sensor.accelerometer is not None


def _corrected(imu: ImuStream, calibration: CalibrationFile) -> tuple[ImuStream, list[str]]:
    found = sensor_of(calibration, imu.name)
    if found is None:
        return imu, []
    named = [name for name in found.named if name != "magnetometer" or imu.mag is not None]
    said = f"{imu.name}: {', '.join(named)} corrected" if named else f"{imu.name}: nothing to correct"
    if found.accelerometer_density is not None or found.gyroscope_density is not None:
        said += "; its measured noise is used"
    return _applied(found, imu), [f"{said} ({calibration.source})"]


def _applied(sensor: SensorCalibration, imu: ImuStream) -> ImuStream:
    """The corrected stream, some thousand samples at a time."""
    acc, gyro = large_array((len(imu), 3)), large_array((len(imu), 3))
    mag = None if imu.mag is None else large_array((len(imu), 3))
    for start in range(0, len(imu), _SAMPLES):
        rows = slice(start, start + _SAMPLES)
        part = sensor.apply(imu.select(rows))
        acc[rows], gyro[rows] = part.acc, part.gyro
        if mag is not None:
            mag[rows] = part.mag
    return replace(sensor.apply(imu.select(slice(0, 0))), t_s=imu.t_s, acc=acc, gyro=gyro, mag=mag)
