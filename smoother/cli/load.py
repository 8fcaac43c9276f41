"""Inputs of a command: recordings, recoveries, calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UnoccludeError
from .output import say

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..recording import Recording
    from ..result import Recovery


def load_arm(
    path: Path,
    calibration_file: Path | None = None,
    *,
    imu: str | None = None,
    skeleton: str | None = None,
    side: str | None = None,
    body: int | None = None,
) -> tuple[Recording, ArmCalibration | None]:
    """Read a recording and the calibration of its arm, and say what was chosen.

    Where the recording leaves the side open, a calibration of one arm settles it.
    """
    from ..io import read_recording

    prefer, calibration = None, None
    if calibration_file is not None:
        from calib.file import read_calibration

        calibration = read_calibration(calibration_file)
        sides = [name for name in calibration.arms if name != "any"]
        prefer = sides[0] if len(sides) == 1 else None
    recording = read_recording(path, imu=imu, skeleton=skeleton, side=side, body=body, prefer_side=prefer)
    if calibration is not None:
        from .sensor import corrected

        recording = corrected(recording, calibration)
        from calib.world.apply import with_gravity

        recording = with_gravity(recording, calibration)
    arm = f"{recording.side} arm" if recording.side else "strap"
    joints = ", ".join(recording.arm.present) or "no joint tracked"
    say(f"{path}: IMU {recording.imu.name}, {arm} of {recording.arm.name} ({joints})")
    if calibration is None or (
        not calibration.arms and {"imu", "camera_from_base"} & set(calibration.tables)
    ):
        return recording, None  # a file of sensors alone leaves the arm to be found
    return recording, calibration.arm(recording.side)


def load_recovery(path: Path, side: str | None = None) -> Recovery:
    """The one recovery of a file, or that of a side."""
    from ..io import read_recovery

    found = read_recovery(path)
    chosen = [recovery for recovery in found if side in (None, recovery.side)]
    sides = ", ".join(recovery.side or "no side" for recovery in found) or "none"
    if not chosen:
        raise UnoccludeError(f"{path}: there is no recovered arm '{side}'; the file has: {sides}")
    if len(chosen) > 1:
        raise UnoccludeError(f"{path}: several arms are in this file ({sides}); choose one with --side")
    return chosen[0]
