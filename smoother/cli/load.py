"""Inputs of a command: recordings, recoveries, calibrations; and options that undo a wrong set-up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Unpack

import typer

from ..errors import RecordingError, UnoccludeError
from ..runtime.pool import check_allowance
from .options import ANY_ARM, ArmSelection, Calibration, ConfigFile, Processes
from .output import say

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..io.recording.choose import FileReading
    from ..measurements.clock import Clock
    from ..measurements.remedy import Remedy
    from ..recording import CameraFrame, Recording
    from ..result import Recovery


@dataclass(frozen=True)
class Solving:
    """How a calibration solves a recording of an arm, as a group of its options."""

    config_file: ConfigFile = None  # Settings
    arm: ArmSelection = ANY_ARM
    processes: Processes = None

    def config(self) -> Config:
        """The settings, read."""
        from .config import read_config

        return read_config(self.config_file, self.processes)


#: The defaults, on all cores.
AS_USUAL = Solving()


def load_arm(
    path: Path,
    calibration_file: Path | None = None,
    arm: ArmSelection = ANY_ARM,
    remedy: Remedy | None = None,
    **reading: Unpack[FileReading],
) -> tuple[Recording, ArmCalibration | None]:
    """Read the one arm that is meant; a side that is left open a calibration of one arm settles."""
    return load_arms(path, calibration_file, arm, remedy, alone=True, **reading)[0]


def load_arms(
    path: Path,
    calibration_file: Path | None = None,
    arm: ArmSelection = ANY_ARM,
    remedy: Remedy | None = None,
    alone: bool = False,
    **reading: Unpack[FileReading],
) -> list[tuple[Recording, ArmCalibration | None]]:
    """Read every arm of a recording that has an IMU, with its calibration, and print what was chosen."""
    reading.update(arm.reading())
    check_allowance()
    from ..io.recording.read import read_arms

    arms = read_arms(path, calibration_file, remedy=remedy, alone=alone, **reading)
    for recording, _ in arms:
        name = recording.arm_label if recording.side else "strap"
        joints = ", ".join(recording.arm.present) or "no joint tracked"
        say(f"{path}: IMU {recording.imu.name}, {name} of {recording.arm.name} ({joints})")
    return arms


def load_recoveries(path: Path, side: str | None = None, body: int | None = None) -> list[Recovery]:
    """The recoveries of a file, or those of a side or body."""
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
    """Of some notes those on a file that was cut off or is damaged."""
    from ..io.mcap.messages import damage as of_files

    return of_files(notes)


def camera_frame_of(path: Path) -> CameraFrame | None:
    """The axes of the camera as stated in the recording inside a result, or None."""
    from ..io import open_recording

    file = open_recording(path)
    implied = (arm.camera_frame for arm in file.arms)
    return file.camera_frame or next((frame for frame in implied if frame is not None), None)


Mirror = Annotated[
    str | None,
    typer.Option("--mirror", metavar="x|y|z", help="Undo a skeleton that is mirrored along this axis."),
]
Swap = Annotated[
    str | None,
    typer.Option(
        "--swap",
        metavar="A,B",
        help="Swap two joints (elbow,wrist), or left,right.",
    ),
]
Negate = Annotated[
    str | None,
    typer.Option(
        "--negate", metavar="SENSOR,..", help="Reverse the sign of the accelerometer, gyroscope, or both."
    ),
]
CameraAxes = Annotated[
    str | None,
    typer.Option(
        "--camera-frame", metavar="kinect|optical|zup", help="The camera's axes, overriding the file's."
    ),
]
ClockOffset = Annotated[
    float | None,
    typer.Option(
        "--clock-offset",
        metavar="S",
        help="IMU time minus camera time, if measured.  [default: from --calibration, or estimated]",
    ),
]
#: One standard deviation of a clock that was measured, where none is stated, s.
CLOCK_SIGMA_S = 0.02
ClockSigma = Annotated[
    float | None,
    typer.Option(
        "--clock-sigma",
        metavar="S",
        help=f"Standard deviation of --clock-offset.  [default: {CLOCK_SIGMA_S:g}]",
    ),
]


@dataclass(frozen=True)
class SetUp:
    """Those options together, as a group of a command's options."""

    mirror: Mirror = None  # What to undo
    swap: Swap = None  # What to undo
    negate: Negate = None  # What to undo
    camera_frame: CameraAxes = None  # What to undo
    clock_offset: ClockOffset = None  # s: the measured clock, if any; its sigma is 0.02 s unless given
    clock_sigma: ClockSigma = None  # s: the measured clock, if any; its sigma is 0.02 s unless given

    def __post_init__(self) -> None:
        if self.clock_sigma is not None and self.clock_offset is None:
            raise typer.BadParameter("--clock-sigma belongs to --clock-offset: give the measured clock too")

    def remedy(self) -> tuple[Remedy, bool]:
        """What the options undo, and whether left and right are to be swapped."""
        from ..measurements.remedy import Remedy
        from ..recording import CameraFrame

        swapped, negated = _names(self.swap), _names(self.negate)
        sides = set(swapped) == SIDES and len(swapped) == 2
        try:
            frame = None if self.camera_frame is None else CameraFrame(self.camera_frame)
        except ValueError:
            names = ", ".join(CameraFrame)
            raise typer.BadParameter(f"--camera-frame is one of {names}, not '{self.camera_frame}'") from None
        if "" in (self.mirror, self.swap, self.negate):
            raise typer.BadParameter("--mirror, --swap and --negate need a name each")
        try:
            return Remedy(self.mirror or "", () if sides else swapped, negated, frame), sides
        except RecordingError as error:
            raise typer.BadParameter(str(error)) from error

    def clock(self, calibration_file: Path | None, recording: Recording) -> Clock | None:
        """The clock that was measured: by option, else by the calibration file; None where it is to be
        found.
        """
        from calib.clock.links import measured_clock
        from calib.file import read_calibration

        from ..measurements.clock import constant_clock

        sigma_s = CLOCK_SIGMA_S if self.clock_sigma is None else self.clock_sigma
        if not sigma_s > 0.0 or not isfinite(sigma_s):
            raise typer.BadParameter("--clock-sigma is a time above zero, in s")
        if self.clock_offset is not None:
            if not isfinite(self.clock_offset):
                raise typer.BadParameter("--clock-offset is a time in s")
            return constant_clock(self.clock_offset, sigma_s)
        if calibration_file is None:
            return None
        return measured_clock(read_calibration(calibration_file), recording)


#: None of them.
AS_RECORDED = SetUp()
#: What `--swap` takes besides two joints.
SIDES = {"left", "right"}


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


@dataclass(frozen=True)
class ArmInput:
    """Which arms of a recording are read, and how, as a group of a command's options."""

    calibration_file: Calibration = None  # Of the arm; its [clock], if any, is a measured clock
    arm: ArmSelection = ANY_ARM
    set_up: SetUp = AS_RECORDED

    def check(self) -> None:
        """Refuse options whose values are not known, before any work is done."""
        self.set_up.remedy()

    def load(
        self, path: Path, **reading: Unpack[FileReading]
    ) -> list[tuple[Recording, ArmCalibration | None]]:
        """Every arm, as `load_arms` reads it."""
        remedy, swap_sides = self.set_up.remedy()
        reading["swap_sides"] = swap_sides
        return load_arms(path, self.calibration_file, self.arm, remedy, **reading)

    def clock(self, recording: Recording) -> Clock | None:
        """See `SetUp.clock`."""
        return self.set_up.clock(self.calibration_file, recording)


#: Every arm, as it was recorded.
EVERY_ARM = ArmInput()
