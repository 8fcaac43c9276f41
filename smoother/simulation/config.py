"""What to simulate: the motion, the sensors, every error that can be switched on; what calibrations take."""

from __future__ import annotations

import tomllib
from enum import StrEnum
from importlib.resources import files
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field

from ..recording import JOINTS, CameraFrame


class Preset(StrEnum):
    """Named sets of errors."""

    CLEAN = "clean"  # no error at all
    WHITE = "white"  # 8 mm of white camera noise, an ordinary MEMS IMU: the defaults
    REALISTIC = "realistic"  # what Kinect skeletons and strapped IMUs do as well
    AZURE = "azure"  # the joints of an Azure Kinect as measured by motion capture, the rest as in REALISTIC


_PRESETS: dict[str, dict[str, Any]] = tomllib.loads(
    files(__package__).joinpath("presets.toml").read_text(encoding="utf-8")
)

_Size = Annotated[float, Field(ge=0)]


def setting(default: Any, description: str, **bounds: Any) -> Any:
    """A setting of a simulation, as `--set list` shows it."""
    return Field(default, description=description, **bounds)


def size(default: float, description: str, **bounds: Any) -> Any:
    """One that is not negative."""
    return setting(default, description, ge=0, **bounds)


class Settings(BaseModel):
    """What is simulated; every setting has a default."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SensorErrors(Settings):
    """The camera and the IMU, with their errors; the defaults are the preset `white`."""

    frame_rate_hz: float = setting(30.0, "camera frames per second", gt=1, le=240)
    noise_m: float = size(0.008, "white noise of a joint, m per axis")
    noise_depth_m: float = size(0.0, "white noise along the ray at 2 m, m; grows with distance squared")
    noise_correlated_m: float = size(0.0, "noise with a memory, m per axis")
    noise_correlated_s: float = setting(0.3, "its time constant, s", gt=0)
    joint_slow_m: tuple[_Size, ...] = setting(
        (),
        "noise with that memory by joint (shoulder, elbow, wrist, hand, strap), added, 3D rms, m",
        max_length=len(JOINTS),
    )
    joint_bias_m: float = size(0.0, "sigma of a joint's constant error, m per axis in {K}")
    joint_off_m: tuple[_Size, ...] = setting(
        (), "a joint's constant error, added: its 3D size is between these two, m", max_length=2
    )
    latency_s: float = setting(0.0, "camera stamps late by this; t_imu = t_camera - latency_s")
    frame_jitter_s: float = size(0.0, "sigma of a frame stamp's own error, s")
    dropped_frames: float = size(0.0, "fraction of frames that never arrive", lt=1)
    outliers: float = size(0.0, "fraction of tracked samples that are wrong", le=1)
    outlier_m: float = size(0.3, "how far an outlier lies off, m")

    imu_rate_hz: float = setting(80.0, "IMU samples per second", ge=20, le=1000)
    accelerometer_noise: float = size(0.003, "density, m/s^2/sqrt(Hz)")
    gyroscope_noise: float = size(0.0003, "density, rad/s/sqrt(Hz)")
    accelerometer_bias: float = size(0.05, "sigma of the first bias, m/s^2 per axis")
    gyroscope_bias: float = size(0.01, "sigma of the first bias, rad/s per axis")
    accelerometer_walk: float = size(0.0005, "bias walk, m/s^2/sqrt(s)")
    gyroscope_walk: float = size(5e-05, "bias walk, rad/s/sqrt(s)")
    imu_scale: float = size(0.0, "sigma of each axis' scale error, 0.003 = 0.3 %")
    imu_misalignment_deg: float = size(0.0, "sigma of each cross-axis angle, degrees")

    @classmethod
    def preset(cls, name: Preset | str, **changes: Any) -> Self:
        """The named preset ("clean", "white", "realistic", "azure") with these settings changed."""
        own = {key: each for key, each in _PRESETS.get(Preset(name), {}).items() if key in cls.model_fields}
        return cls(**(own | changes))


class ArmSimulation(SensorErrors):
    """An arm with a wrist IMU before a depth camera."""

    protocol: Literal["behind", "random", "hang"] = setting(
        "behind",
        "behind = held pose, behind the head, belly, behind the back; random = smooth motion with occlusions"
        " at random times; hang = arm at the side",
    )
    repetitions: int = setting(2, "how often the protocol `behind` is done", ge=1)
    duration_s: float = setting(30.0, "length of `random` and `hang`, s", gt=1)
    flexion_rad: tuple[float, float] = setting(
        (0.5, 2.0), "the elbow's flexion in `random` is between these two, rad"
    )
    side: Literal["left", "right"] = "right"
    camera_frame: CameraFrame = CameraFrame.KINECT
    distance_m: float = setting(2.0, "person to camera, m", gt=0.8)
    speed: float = setting(1.0, "factor on the speed of every movement", gt=0.1, le=3)
    sway_m: float = size(0.008, "rms of the shoulder's slow sway, m per axis")
    tremor_rad: float = size(0.0003, "rms of a 7-11 Hz tremor, rad per angle")
    still_start_s: float = size(0.0, "the arm first hangs without any motion, s")
    still_all: bool = setting(False, "the arm hangs without any motion from start to end")
    strap: bool = setting(False, "the camera finds the strap too")
    wobble_deg: float = size(0.0, "rms of the strap's rotation on the forearm, degrees")

    imus: Literal[
        "wrist",
        "wrist,upper-arm",
        "wrist,upper-arm,trunk",
        "wrist,hand",
        "wrist,upper-arm,hand",
        "wrist,upper-arm,hand,trunk",
    ] = setting("wrist", "where an IMU is worn; with `trunk` the camera sees both shoulders")
    wrist_deg: float = size(0.0, "rms of the wrist's flexion, degrees; it deviates by a third of that", le=30)
    hand_clock_s: float = setting(0.0, "the hand IMU's clock is ahead of the wrist's by this, s")
    hand_clock_ppm: float = setting(0.0, "and its drift against it, ppm")
    trunk_turn_deg: float = size(0.0, "rms of the trunk's turning and leaning, degrees; 0 = still")
    trunk_clock_s: float = setting(0.0, "the trunk IMU's clock is ahead of the wrist's by this, s")
    upper_wobble_deg: float = size(
        0.0,
        "soft tissue: rms of the upper-arm IMU's rotation against the bone, degrees; fast motion makes two to"
        " three times as much",
    )
    upper_clock_s: float = setting(0.0, "the upper-arm IMU's clock is ahead of the wrist's by this, s")
    upper_clock_ppm: float = setting(0.0, "and its drift against it, ppm")

    occluded_state: Literal["not_tracked", "inferred"] = setting(
        "not_tracked", "state of the forearm's joints in an occlusion"
    )
    inferred_error_m: float = size(0.06, "error of an inferred position, m per axis")
    elbow_lag_s: float = size(0.1, "the elbow stays tracked up to this much longer, s")
    shoulder_lost: float = size(0.0, "fraction of occluded frames without shoulder", le=1)
    frozen_gaps: float = size(0.0, "fraction of occlusions where joints stand still", le=1)
    swapped_gaps: float = size(0.0, "fraction of occlusions with the arms swapped", le=1)
    occlusion_lengths_s: tuple[float, ...] = setting(
        (0.5, 1.0, 2.0, 3.0), "lengths to choose from in `random`, s; empty = no occlusion"
    )
    occlusion_every_s: float = setting(6.0, "about one occlusion in this time in `random`, s", gt=0)
    end_gap_s: float = size(0.0, "how long the end of `random` is occluded, s")

    cameras: tuple[float, ...] = setting(
        (),
        "further depth cameras round the person: the angle of each from the first one's place, degrees, +"
        " towards the person's left",
        max_length=7,
    )
    camera_clock_s: float = setting(0.0, "each camera's clock is ahead of the one before by this, s")
    camera_clock_ppm: float = setting(0.0, "drift of all but the first, ppm")
    camera_blind: float = size(
        0.3,
        "fraction of the first camera's occlusions in `random` in which no other sees the forearm either",
        le=1,
    )
    camera_fault: Literal["none", "mirrored", "other_person", "moved"] = setting(
        "none", "what is wrong with the last further camera"
    )
    rgb: Literal["none", "first", "further", "all"] = setting(
        "none",
        "cameras without depth, of 1280 x 720 pixels: the first one, the further ones, or all, whose places"
        " are then known to 0.2 degrees and 5 mm; in space joints have their constant errors",
    )
    rgb_noise_px: float = size(
        3.0, "their joints' noise, pixels per axis; half of its variance has the memory of the preset's noise"
    )


class RestPoses(Settings):
    """A sensor laid still in one pose after the other, or for long in one."""

    poses: int = setting(12, "rest poses: sides, then edges, then corners", ge=1, le=26)
    rest_s: float = setting(3.0, "how long the sensor stays in a pose, s", ge=0.5, le=60)
    long_rest_s: float | None = setting(
        None, "one long rest instead of poses, for the noise; 3600 for an hour", ge=10, le=14400
    )
    offset: float = size(0.5, "of the accelerometer, m/s^2 per axis")
    scale: float = size(0.03, "largest scale error of any axis", le=0.2)
    cross: float = size(0.01, "largest cross-axis term", le=0.2)
    noise: float = size(0.02, "of an accelerometer sample in a pose, m/s^2")


class TurningMagnetometer(Settings):
    """A magnetometer turned in all directions."""

    hard_iron: float = size(0.5, "offset, in parts of the field", le=5)
    soft_iron: float = size(0.2, "largest error of scale, and cross term", le=0.25)
    field: float = setting(48.0, "the field's strength, in the sensor's unit", ge=0.01)
    noise: float = size(0.01, "of a sample, in parts of the field", le=0.2)


class ClockSources(Settings):
    """A beep, broadcasts and the motion of a session."""

    rounds: int = setting(20, "broadcasts", ge=4, le=1000)
    minutes: float = setting(5.0, "time over which they are spread", ge=0.5, le=120)
    motion_s: float = setting(30.0, "length of the arm's recording, s", ge=10, le=600)
    noise_db: float = size(25.0, "noise of the room below the beep, dB", le=80)


class StrapImages(Settings):
    """Images of an arm with its strap."""

    duration_s: float = setting(20.0, "length of the recording, s", ge=8, le=120)
    every: int = setting(5, "one image every this many camera frames", ge=1, le=60)
