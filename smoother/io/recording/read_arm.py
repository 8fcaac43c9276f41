"""One IMU of a recording by itself: for what needs no camera."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from ...calibration import ArmCalibration
from ...errors import RecordingError
from ...measurements.remedy import Remedy
from ...recording import ImuStream
from ..mcap.stamps import SECOND_NS, seconds
from .clean import clean_imu
from .read import open_recording, read_recording, read_recordings
from .selection import FileReading, choose_imu

if TYPE_CHECKING:
    from ...recording import Recording
    from ...runtime.store import Store


def read_imu(path: str | os.PathLike[str], imu: str | None = None) -> tuple[ImuStream, list[str]]:
    """Read one IMU from an MCAP file; a skeleton need not be there.

    Parameters
    ----------
    path : path-like
        The file.
    imu : str, optional
        Topic (or a part of it, or its frame_id) to take, where there are several.

    Returns
    -------
    stream : ImuStream
        Its samples.
    notes : list of str
        What was dropped or chosen, one sentence each.

    Raises
    ------
    RecordingError
        The file cannot be read, holds no IMU or several, or its samples cannot be used.
    """
    file = open_recording(path)
    with file.damage_told():
        chosen = choose_imu(file, imu)
        kept, notes = clean_imu(chosen, str(file.path))
    if kept.stamp_ns[-1] - kept.stamp_ns[0] <= 0:
        raise RecordingError(f"{path}: {kept.topic} lasts no time; record it again.")
    origin = int(kept.stamp_ns[0]) // SECOND_NS * SECOND_NS
    stream = ImuStream(kept.topic, seconds(kept.stamp_ns, origin), kept.acc, kept.gyro, kept.mag)
    return stream, [*file.notes, *notes]


def read_arm(
    path: str | os.PathLike[str],
    calibration_file: str | os.PathLike[str] | None = None,
    *,
    remedy: Remedy | None = None,
    **reading: Unpack[FileReading],
) -> tuple[Recording, ArmCalibration | None]:
    """Read a recording, corrected by what a calibration file knows of its sensors.

    Where the recording leaves the side open, a calibration of one arm settles it.

    Parameters
    ----------
    path : path-like
        The recording, MCAP.
    calibration_file : path-like, optional
        TOML; None where everything is to be found.
    remedy : Remedy, optional
        Mistakes of the set-up to undo as it is read.
    store : Store, optional
    truth, swap_sides : bool
        See `read_recording`.
    imu, skeleton, side : str, optional
    body : int, optional
        What to take where the recording has several: see there as well.

    Returns
    -------
    recording : Recording
        Corrected.
    calibration : ArmCalibration or None
        Of its arm: None without a file, or where it holds none; with the factors of sigma that the file
        holds.

    Raises
    ------
    RecordingError, CalibrationError
        A file cannot be used, or the two do not fit.
    """
    ((recording, calibration),) = _read(
        calibration_file,
        lambda prefer: [read_recording(path, prefer_side=prefer, **reading)],
        remedy or Remedy(),
        reading.get("store"),
    )
    return recording, calibration


def read_arms(
    path: str | os.PathLike[str],
    calibration_file: str | os.PathLike[str] | None = None,
    *,
    remedy: Remedy | None = None,
    **reading: Unpack[FileReading],
) -> list[tuple[Recording, ArmCalibration | None]]:
    """Read every arm of a recording that has an IMU, with its calibration; as `read_arm`.

    Returns
    -------
    list of (Recording, ArmCalibration or None)
        One an arm. A calibration file that holds only other arms gives none for this one, which a note
        says.

    Raises
    ------
    RecordingError, CalibrationError
        See `read_arm`.
    """
    return _read(
        calibration_file,
        lambda prefer: read_recordings(path, prefer_side=prefer, **reading),
        remedy or Remedy(),
        reading.get("store"),
    )


def _read(
    calibration_file: str | os.PathLike[str] | None,
    read: Callable[[str | None], list[Recording]],
    remedy: Remedy,
    store: Store | None,
) -> list[tuple[Recording, ArmCalibration | None]]:
    """Recordings, corrected, each with its calibration; `read` takes the side to prefer."""
    if calibration_file is None:
        return [(remedy.applied(recording, store), None) for recording in read(None)]
    from calib.file import read_calibration, sigma_factors_of
    from calib.imu.sensor import corrected
    from calib.world.world_table import with_gravity

    calibration = read_calibration(calibration_file)
    sides = [name for name in calibration.arms if name != "any"]
    factors = sigma_factors_of(calibration)
    arms: list[tuple[Recording, ArmCalibration | None]] = []
    recordings = read(sides[0] if len(sides) == 1 else None)
    for recording in recordings:
        recording = remedy.applied(recording, store)
        recording = with_gravity(corrected(recording, calibration, store), calibration)
        other_arm = len(recordings) > 1 and not {recording.side, "any"} & set(calibration.arms)
        if calibration.arms and other_arm:
            note = f"{calibration_file} holds no {recording.side} arm: this one is found from the motion."
            recording = replace(recording, notes=(*recording.notes, note))
        if not calibration.arms or other_arm:  # sensors, clocks, frames: the arm is found from the motion
            given = ArmCalibration(recording.side, sigma_factors=factors) if factors else None
        else:
            given = replace(calibration.arm(recording.side), sigma_factors=factors)
        arms.append((recording, given))
    return arms
