"""Corrections of an IMU from a calibration file, applied as a recording is loaded."""

from __future__ import annotations

from dataclasses import replace

from smoother.recording import ImuStream, Recording

from ..file import CalibrationFile
from .sensor import sensor_of, sensors_in


def corrected(recording: Recording, calibration: CalibrationFile) -> Recording:
    """The recording with its IMUs corrected where the file knows them, and a note of it."""
    imu, notes = _corrected(recording.imu, calibration)
    base = recording.base_imu
    if base is not None:
        base, more = _corrected(base, calibration)
        notes += more
    known = sensors_in(calibration)
    if known and not notes:
        notes.append(
            f"{calibration.source} corrects {', '.join(sorted(known))}; the recording's IMU is"
            f" {recording.imu.name} and was taken as it is"
        )
    return replace(recording, imu=imu, base_imu=base, notes=(*recording.notes, *notes))


def _corrected(imu: ImuStream, calibration: CalibrationFile) -> tuple[ImuStream, list[str]]:
    found = sensor_of(calibration, imu.name)
    if found is None:
        return imu, []
    named = [name for name in found.named if name != "magnetometer" or imu.mag is not None]
    said = f"{imu.name}: {', '.join(named)} corrected" if named else f"{imu.name}: nothing to correct"
    if found.accelerometer_density is not None or found.gyroscope_density is not None:
        said += "; its measured noise is used"
    return found.apply(imu), [f"{said} ({calibration.source})"]
