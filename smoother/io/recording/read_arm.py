"""A recording together with the calibration of its arm."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from ...calibration import ArmCalibration
from ...measurements.remedy import Remedy
from .read import read_recording
from .selection import Selection

if TYPE_CHECKING:
    from ...recording import Recording
    from ...runtime.store import Store


def read_arm(
    path: str | os.PathLike[str],
    calibration_file: str | os.PathLike[str] | None = None,
    *,
    store: Store | None = None,
    truth: bool = True,
    remedy: Remedy | None = None,
    swap_sides: bool = False,
    **selection: Unpack[Selection],
) -> tuple[Recording, ArmCalibration | None]:
    """Read a recording, corrected by what a calibration file knows of its sensors.

    Where the recording leaves the side open, a calibration of one arm settles it.

    Parameters
    ----------
    path : path-like
        The recording, MCAP.
    calibration_file : path-like, optional
        TOML; None where everything is to be found.
    store : Store, optional
    truth : bool
        Where samples lie, and whether the reference motion is read: see `read_recording`.
    remedy : Remedy, optional
        Mistakes of the set-up to undo as it is read.
    swap_sides : bool
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
    remedy = remedy or Remedy()
    if calibration_file is None:
        recording = read_recording(path, store=store, truth=truth, swap_sides=swap_sides, **selection)
        return remedy.applied(recording, store), None
    from calib.file import read_calibration
    from calib.imu.correction import corrected
    from calib.sigma import sigma_factors_of
    from calib.world.gravity_from_base import with_gravity

    calibration = read_calibration(calibration_file)
    sides = [name for name in calibration.arms if name != "any"]
    prefer = sides[0] if len(sides) == 1 else None
    recording = read_recording(
        path, prefer_side=prefer, store=store, truth=truth, swap_sides=swap_sides, **selection
    )
    recording = remedy.applied(recording, store)
    recording = with_gravity(corrected(recording, calibration, store), calibration)
    factors = sigma_factors_of(calibration)
    if not calibration.arms:  # sensors, clocks, frames: the arm is found from the motion
        return recording, ArmCalibration(recording.side, sigma_factors=factors) if factors else None
    return recording, replace(calibration.arm(recording.side), sigma_factors=factors)
