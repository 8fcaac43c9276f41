"""Inputs of a command: recordings, recoveries, calibrations."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ..errors import UnoccludeError
from ..runtime.pool import check_allowance
from .output import say

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..io.recording.selection import FileReading
    from ..measurements.remedy import Remedy
    from ..recording import CameraFrame, Recording
    from ..result import Recovery

#: How the reader of a file says that it was cut off or is damaged.
DAMAGED = ("ends in the middle of the recording", "damaged", "checksum")


def load_arm(
    path: Path,
    calibration_file: Path | None = None,
    remedy: Remedy | None = None,
    **reading: Unpack[FileReading],
) -> tuple[Recording, ArmCalibration | None]:
    """Read a recording and the calibration of its arm, and say what was chosen.

    Where the recording leaves the side open, a calibration of one arm settles it. Parameters as of
    `io.recording.read_arm`.
    """
    check_allowance()
    from ..io.recording.read_arm import read_arm

    recording, calibration = read_arm(path, calibration_file, remedy=remedy, **reading)
    _say_chosen(path, recording)
    return recording, calibration


def load_arms(
    path: Path,
    calibration_file: Path | None = None,
    remedy: Remedy | None = None,
    **reading: Unpack[FileReading],
) -> list[tuple[Recording, ArmCalibration | None]]:
    """Read every arm of a recording that has an IMU, with its calibration, and say what was chosen.

    Parameters as of `load_arm`.
    """
    check_allowance()
    from ..io.recording.read_arm import read_arms

    arms = read_arms(path, calibration_file, remedy=remedy, **reading)
    for recording, _ in arms:
        _say_chosen(path, recording)
    return arms


def _say_chosen(path: Path, recording: Recording) -> None:
    arm = recording.arm_label if recording.side else "strap"
    joints = ", ".join(recording.arm.present) or "no joint tracked"
    say(f"{path}: IMU {recording.imu.name}, {arm} of {recording.arm.name} ({joints})")


def load_recoveries(path: Path, side: str | None = None, body: int | None = None) -> list[Recovery]:
    """The recoveries of a file, or those of a side or body.

    Raises
    ------
    UnoccludeError
        There is none.
    """
    from ..io import read_recovery

    recoveries = read_recovery(path)
    chosen = [one for one in recoveries if side in (None, one.side) and body in (None, one.body)]
    if not chosen:
        wanted = [f"--side {side}"] if side is not None else []
        wanted += [f"--body {body}"] if body is not None else []
        has = ", ".join(one.arm_label for one in recoveries) or "none"
        raise UnoccludeError(f"{path}: there is no recovered arm for {' '.join(wanted)}; the file has: {has}")
    return chosen


def damage(notes: Iterable[str]) -> list[str]:
    """Of some notes those that say that a file was cut off or is damaged."""
    return [note for note in notes if any(words in note for words in DAMAGED)]


def camera_frame_of(path: Path) -> CameraFrame | None:
    """The axes of the camera as the recording inside a result says, or None."""
    from ..io import open_recording

    file = open_recording(path)
    implied = (arm.camera_frame for arm in file.arms)
    return file.camera_frame or next((frame for frame in implied if frame is not None), None)
