"""What is kept of a sensor in the calibration file, and its corrections to a stream as it is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream, Recording
from smoother.runtime.store import large_array

from .file import CalibrationFile, Section, Vector, checked

#: Samples that are corrected together.
_SAMPLES = 65536


class Correction(Section):
    """What is read of a sensor's table, corrected = matrix (raw - offset)."""

    offset: Vector | None = None
    matrix: Annotated[list[Vector], Field(min_length=3, max_length=3)] | None = None
    noise_density: float | None = Field(default=None, gt=0, strict=True)  # White, per sqrt(Hz)

    @model_validator(mode="after")
    def _invertible(self) -> Self:
        matrix = np.eye(3) if self.matrix is None else np.array(self.matrix)
        if abs(np.linalg.det(matrix)) < 1e-12 * np.linalg.norm(matrix) ** 3:
            raise ValueError("the matrix has no inverse; correct it or calibrate again")
        return self

    @property
    def is_known(self) -> bool:
        """Whether there is something to correct."""
        return self.offset is not None or self.matrix is not None

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3)."""
        left = raw if self.offset is None else raw - np.array(self.offset)
        return left if self.matrix is None else left @ np.array(self.matrix).T


class SensorCalibration(Section):
    """Corrections of one sensor."""

    accelerometer: Correction = Field(default_factory=Correction)
    gyroscope: Correction = Field(default_factory=Correction)
    magnetometer: Correction = Field(default_factory=Correction)

    @property
    def named(self) -> list[str]:
        """What is corrected, in words."""
        return [name for name in type(self).model_fields if getattr(self, name).is_known]

    def apply(self, imu: ImuStream) -> ImuStream:
        """The corrected stream, some thousand samples at a time."""

        def applied(correction: Correction, raw: FloatArray) -> FloatArray:
            values = large_array(raw.shape)
            for start in range(0, len(raw), _SAMPLES):
                rows = slice(start, start + _SAMPLES)
                values[rows] = correction.apply(raw[rows])
            return values

        return replace(
            imu,
            acc=applied(self.accelerometer, imu.acc),
            gyro=applied(self.gyroscope, imu.gyro),
            mag=None if imu.mag is None else applied(self.magnetometer, imu.mag),
            mag_calibrated=imu.mag is not None and self.magnetometer.is_known,
            accelerometer_density=self.accelerometer.noise_density,
            gyroscope_density=self.gyroscope.noise_density,
        )


def sensor_name(topic: str) -> str:
    """A stream's name in the calibration file: its topic without `/imu/`."""
    return topic.strip("/").removeprefix("imu/") or "imu"


def sensor_of(file: CalibrationFile, topic: str) -> SensorCalibration | None:
    """The calibration of a stream's sensor; None where the file has none of that name."""
    held = sensors_in(file).get(sensor_name(topic))
    return held and checked(SensorCalibration, held, f"{file.source}: imu.{sensor_name(topic)}")


def sensors_in(file: CalibrationFile) -> dict[str, Any]:
    """The tables of all sensors, by name."""
    held = file.tables.get("imu", {})
    if not isinstance(held, dict) or not all(isinstance(table, dict) for table in held.values()):
        raise CalibrationError(f"{file.source}: imu must contain a table for each sensor, [imu.NAME].")
    return held


def corrected(recording: Recording, calibration: CalibrationFile) -> Recording:
    """The recording with its IMUs corrected where the file has their calibration, and a note of it."""
    notes: list[str] = []

    def fixed(imu: ImuStream) -> ImuStream:
        found = sensor_of(calibration, imu.name)
        if found is None:
            return imu
        named = [name for name in found.named if name != "magnetometer" or imu.mag is not None]
        said = f"{imu.name}: {', '.join(named)} corrected" if named else f"{imu.name}: nothing to correct"
        if found.accelerometer.noise_density or found.gyroscope.noise_density:
            said += "; its measured noise is used"
        notes.append(f"{said} ({calibration.source})")
        return found.apply(imu)

    base, trunk = recording.base_imu, recording.trunk
    recording = replace(
        recording,
        imu=fixed(recording.imu),
        base_imu=None if base is None else fixed(base),
        further_imus={name: fixed(stream) for name, stream in recording.further_imus.items()},
        trunk=None if trunk is None else replace(trunk, imu=fixed(trunk.imu)),
    )
    known = sensors_in(calibration)
    if known and not notes:
        notes.append(
            f"{calibration.source} corrects {', '.join(sorted(known))}; the recording's IMU is"
            f" {recording.imu.name} and was left uncorrected"
        )
    return replace(recording, notes=(*recording.notes, *notes))


def corrected_streams(streams: Sequence[ImuStream], file: CalibrationFile) -> tuple[list[ImuStream], bool]:
    """Streams of one IMU corrected by the file's values, and whether its accelerometer is known."""
    sensor = sensor_of(file, streams[0].name)
    if sensor is None:
        return list(streams), False
    once = {id(stream): sensor.apply(stream) for stream in streams}
    return [once[id(stream)] for stream in streams], sensor.accelerometer.is_known
