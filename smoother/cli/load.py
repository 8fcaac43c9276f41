"""Inputs of a command: recordings, recoveries, calibrations; and options that undo a wrong set-up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Unpack

import typer

from ..errors import RecordingError, UnoccludeError
from ..runtime.pool import check_allowance
from . import options as o
from .output import say

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..io.recording.choose import FileReading, Selection
    from ..measurements.clock import Clock
    from ..measurements.remedy import Remedy
    from ..recording import CameraFrame, Recording
    from ..result import Recovery

    Arm = tuple[Recording, ArmCalibration | None]


def load_arm(path: Path, calibration_file: Path | None = None, **reading: Unpack[FileReading]) -> Arm:
    """Read the one arm that is meant; a side that is left open a calibration of one arm settles."""
    return load_arms(path, calibration_file, alone=True, **reading)[0]


def load_arms(
    path: Path,
    calibration_file: Path | None = None,
    remedy: Remedy | None = None,
    alone: bool = False,
    **reading: Unpack[FileReading],
) -> list[Arm]:
    """Read every arm of a recording that has an IMU, with its calibration, and print what was chosen."""
    check_allowance()
    from ..io.recording.read import read_arms

    arms = read_arms(path, calibration_file, remedy=remedy, alone=alone, **reading)
    for recording, _ in arms:
        name = recording.arm_label if recording.side else "strap"
        joints = ", ".join(recording.arm.present) or "no joint tracked"
        say(f"{path}: IMU {recording.imu.name}, {name} of {recording.arm.name} ({joints})")
    return arms


def filter_of(names: Sequence[str], orientation: str | None) -> str:
    """The orientation filter of the baselines among the chosen methods."""
    from ..baselines.registry import BASELINES, DEFAULT_ORIENTATION

    if orientation is not None and not any(
        name in BASELINES and BASELINES[name].needs_orientation for name in names
    ):
        raise typer.BadParameter(
            "--orientation belongs to the methods that need a filter's orientation, such as rts; no such"
            f" method was chosen, but {', '.join(names)}"
        )
    return orientation or DEFAULT_ORIENTATION


def refuse_twice(paths: Iterable[Path], option: str = "") -> None:
    """Refuse a file that is named twice."""
    seen: set[Path] = set()
    for path in paths:
        if path in seen:
            raise typer.BadParameter(f"{option}{path} is named twice; it would count twice")
        seen.add(path)


def refuse_several(arms: Sequence[Recording | Recovery], truth: Path) -> None:
    """Refuse a truth that is not there, or one of one arm for several."""
    if not truth.is_file():
        raise UnoccludeError(f"{truth}: there is no such file")
    if len(arms) > 1 and truth.suffix.lower() != ".mcap":
        labels = ", ".join(arm.arm_label for arm in arms)
        raise UnoccludeError(
            f"{truth} is the truth of one arm, and here are several ({labels}); choose its arm with --side"
            " or --body"
        )


def camera_frame_of(path: Path) -> CameraFrame | None:
    """The axes of the camera as stated in the recording inside a result, or None."""
    from ..io import open_recording

    file = open_recording(path)
    return file.camera_frame or next(filter(None, (arm.camera_frame for arm in file.arms)), None)


@dataclass(frozen=True)
class ConfigInput:
    """The settings of the method; what neither their file nor an option names keeps its default."""

    config_file: o.ConfigFile = None
    processes: o.Processes = None

    def read(self) -> Config:
        """The configuration."""
        from .config import read_config

        return read_config(**vars(self))


@dataclass(frozen=True)
class PersonConfigInput(ConfigInput):
    """The settings of the method, and what is known of the person."""

    anatomy: o.Anatomy = None
    body_height: o.BodyHeight = None


@dataclass(frozen=True)
class ResultInput:
    """Which arms of a result are taken."""

    side: o.Side = None
    body: o.Body = None

    def load(self, path: Path) -> list[Recovery]:
        """The recoveries of a file, or those of a side or body."""
        from ..io import read_recovery

        recoveries = read_recovery(path)
        wanted = {name: value for name, value in vars(self).items() if value is not None}
        taken = [arm for arm in recoveries if all(getattr(arm, name) == wanted[name] for name in wanted)]
        if not taken:
            options = " ".join(f"--{name} {value}" for name, value in wanted.items())
            has = ", ".join(each.arm_label for each in recoveries) or "none"
            raise UnoccludeError(f"{path}: there is no recovered arm for {options}; the file has: {has}")
        return taken


@dataclass(frozen=True)
class Which:
    """Which arms of a recording are taken, and by which sensors."""

    imu: o.Imu = None
    skeleton: o.Skeleton = None
    side: o.Side = None
    body: o.Body = None

    @property
    def chosen(self) -> Selection:
        """The same for the readers."""
        return {"imu": self.imu, "skeleton": self.skeleton, "side": self.side, "body": self.body}


@dataclass(frozen=True)
class ArmInput(Which):
    """Which arms of a recording are read, and what of their set-up is corrected; checked as it is made."""

    calibration_file: o.Calibration = None  # Of the arm; its [clock], if any, is a measured clock
    mirror: o.Mirror = None
    swap: o.Swap = None
    negate: o.Negate = None
    camera_frame: o.CameraAxes = None
    clock_offset: o.ClockOffset = None
    clock_sigma: o.ClockSigma = None

    def __post_init__(self) -> None:
        is_a_clock = isfinite(self.clock_offset or 0) and isfinite(self.sigma_s) and self.sigma_s > 0
        lacks_clock = self.clock_sigma is not None and self.clock_offset is None
        o.refuse(
            {
                "--clock-sigma belongs to --clock-offset: give the measured clock too": lacks_clock,
                "--clock-offset is a time in s, --clock-sigma one above zero": not is_a_clock,
                "--mirror, --swap and --negate need a name each": "" in (self.mirror, self.swap, self.negate),
            }
        )
        try:
            _ = self.remedy
        except RecordingError as error:
            raise typer.BadParameter(str(error)) from error

    @property
    def sigma_s(self) -> float:
        """Of the measured clock."""
        return o.CLOCK_SIGMA_S if self.clock_sigma is None else self.clock_sigma

    @property
    def swaps_sides(self) -> bool:
        """Left and right are to be swapped, not two joints."""
        return sorted(_names(self.swap)) == ["left", "right"]

    @property
    def remedy(self) -> Remedy:
        """What the options undo in an arm."""
        from ..measurements.remedy import Remedy
        from ..recording import CameraFrame

        frame = None if self.camera_frame is None else CameraFrame(self.camera_frame)
        swapped = () if self.swaps_sides else _names(self.swap)
        return Remedy(self.mirror or "", swapped, _names(self.negate), frame)

    def load(self, path: Path, **reading: Unpack[FileReading]) -> list[Arm]:
        """Every arm, as `load_arms` reads it."""
        reading.update(self.chosen)
        reading["swap_sides"] = self.swaps_sides
        return load_arms(path, self.calibration_file, self.remedy, **reading)

    def clock(self, recording: Recording) -> Clock | None:
        """The clock that was measured, by option, else by the calibration; None where it is to be found."""
        from calib.clock import measured_clock
        from calib.file import read_calibration

        from ..measurements.clock import constant_clock

        if self.clock_offset is not None:
            return constant_clock(self.clock_offset, self.sigma_s)
        if self.calibration_file is None:
            return None
        return measured_clock(read_calibration(self.calibration_file), recording)


@dataclass(frozen=True)
class TrialInput(ArmInput):
    """The same of a recording that may be one trial of a session."""

    session: o.Session = None

    def __post_init__(self) -> None:
        super().__post_init__()
        twice = self.session is not None and self.calibration_file is not None
        o.refuse({"--session finds the calibration; give it or --calibration, not both": twice})

    @contextmanager
    def in_session(self, recording_file: Path, config: Config) -> Iterator[ArmInput]:
        """The input with the calibration that the session's trials show together, which is printed."""
        if self.session is None:
            yield self
            return
        from ..study.inputs import calibrate_session, is_trial, trials_in, write_arms

        own = recording_file.resolve()
        if not is_trial(own, self.chosen):
            say(f"{recording_file}: it is over a minute long, or has one clock: it stands for itself")
            yield self
            return
        found = calibrate_session(
            dict.fromkeys([*trials_in(self.session), own]), self.chosen, config, config.windows.processes
        )
        if found.sentence:
            say(f"{self.session}: {found.sentence}")
        if own not in found.arms:
            say(f"{recording_file}: it is no trial of this session's straps, or its motion does not show it")
            yield self
            return
        with TemporaryDirectory(prefix="unocclude-") as folder:
            write_arms(Path(folder) / "session.toml", found.arms[own])
            yield replace(self, calibration_file=Path(folder) / "session.toml", session=None)


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())
