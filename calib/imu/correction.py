"""Corrections of an IMU from a calibration file, applied as a recording is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from smoother.recording import ImuStream, Recording
from smoother.runtime.store import Store

from ..file import CalibrationFile
from .sensor import SensorCalibration, sensor_of, sensors_in

#: Samples that are corrected together.
_SAMPLES = 65536


def corrected(recording: Recording, calibration: CalibrationFile, store: Store | None = None) -> Recording:
    """The recording with its IMUs corrected where the file knows them, and a note of it.

    Parameters
    ----------
    recording : Recording
        As read.
    calibration : CalibrationFile
        Its tables `imu` are looked at.
    store : Store, optional
        Where the corrected samples lie; in memory where None.

    Returns
    -------
    recording : Recording
    """
    store = store or Store()
    imu, notes = _corrected(recording.imu, calibration, store)
    base = recording.base_imu
    if base is not None:
        base, more = _corrected(base, calibration, store)
        notes += more
    upper = recording.upper_imu
    if upper is not None:
        upper, more = _corrected(upper, calibration, store)
        notes += more
    trunk = recording.trunk
    if trunk is not None:
        on_trunk, more = _corrected(trunk.imu, calibration, store)
        trunk = replace(trunk, imu=on_trunk)
        notes += more
    known = sensors_in(calibration)
    if known and not notes:
        notes.append(
            f"{calibration.source} corrects {', '.join(sorted(known))}; the recording's IMU is"
            f" {recording.imu.name} and was taken as it is"
        )
    notes = [*recording.notes, *notes]
    return replace(recording, imu=imu, base_imu=base, upper_imu=upper, trunk=trunk, notes=tuple(notes))


def corrected_streams(streams: Sequence[ImuStream], file: CalibrationFile) -> tuple[list[ImuStream], bool]:
    """Streams of one IMU with what the file knows of it taken off, and whether its accelerometer is known.

    Parameters
    ----------
    streams : sequence of ImuStream
        One a pose; one that stands there several times is corrected once and stays one.
    file : CalibrationFile
        Its tables `imu` are looked at.

    Returns
    -------
    streams : list of ImuStream
    accelerometer_known : bool
    """
    sensor = sensor_of(file, streams[0].name)
    if sensor is None:
        return list(streams), False
    once = {id(stream): sensor.apply(stream) for stream in streams}
    return [once[id(stream)] for stream in streams], sensor.accelerometer is not None


def _corrected(imu: ImuStream, calibration: CalibrationFile, store: Store) -> tuple[ImuStream, list[str]]:
    found = sensor_of(calibration, imu.name)
    if found is None:
        return imu, []
    named = [name for name in found.named if name != "magnetometer" or imu.mag is not None]
    said = f"{imu.name}: {', '.join(named)} corrected" if named else f"{imu.name}: nothing to correct"
    if found.accelerometer_density is not None or found.gyroscope_density is not None:
        said += "; its measured noise is used"
    return _applied(found, imu, store), [f"{said} ({calibration.source})"]


def _applied(sensor: SensorCalibration, imu: ImuStream, store: Store) -> ImuStream:
    """The corrected stream, some thousand samples at a time."""
    acc, gyro = store.array((len(imu), 3)), store.array((len(imu), 3))
    mag = None if imu.mag is None else store.array((len(imu), 3))
    for start in range(0, len(imu), _SAMPLES):
        rows = slice(start, start + _SAMPLES)
        part = sensor.apply(imu.select(rows))
        acc[rows], gyro[rows] = part.acc, part.gyro
        if mag is not None:
            mag[rows] = part.mag
    return replace(sensor.apply(imu.select(slice(0, 0))), t_s=imu.t_s, acc=acc, gyro=gyro, mag=mag)
