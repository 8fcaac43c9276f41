"""What to simulate: the motion, the sensors, and every error that can be switched on."""

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


class SensorErrors(BaseModel):
    """The camera and the IMU, with their errors; the defaults are the preset `white`."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    frame_rate_hz: float = Field(default=30.0, gt=1, le=240, description="camera frames per second")
    noise_m: float = Field(default=0.008, ge=0, description="white noise of a joint, m per axis")
    noise_depth_m: float = Field(
        default=0.0, ge=0, description="white noise along the ray at 2 m, m; grows with distance squared"
    )
    noise_correlated_m: float = Field(default=0.0, ge=0, description="noise with a memory, m per axis")
    noise_correlated_s: float = Field(default=0.3, gt=0, description="its time constant, s")
    joint_slow_m: tuple[_Size, ...] = Field(
        default=(),
        max_length=len(JOINTS),
        description="noise with that memory by joint (shoulder, elbow, wrist, hand, strap), added, 3D rms, m",
    )
    joint_bias_m: float = Field(
        default=0.0, ge=0, description="sigma of a joint's constant error, m per axis in {K}"
    )
    joint_off_m: tuple[_Size, ...] = Field(
        default=(),
        max_length=2,
        description="a joint's constant error, added: its 3D size is between these two, m",
    )
    latency_s: float = Field(
        default=0.0, description="camera stamps late by this; t_imu = t_camera - latency_s"
    )
    frame_jitter_s: float = Field(default=0.0, ge=0, description="sigma of a frame stamp's own error, s")
    dropped_frames: float = Field(default=0.0, ge=0, lt=1, description="fraction of frames that never arrive")
    outliers: float = Field(default=0.0, ge=0, le=1, description="fraction of tracked samples that are wrong")
    outlier_m: float = Field(default=0.3, ge=0, description="how far an outlier lies off, m")

    imu_rate_hz: float = Field(default=80.0, ge=20, le=1000, description="IMU samples per second")
    accelerometer_noise: float = Field(default=0.003, ge=0, description="density, m/s^2/sqrt(Hz)")
    gyroscope_noise: float = Field(default=0.0003, ge=0, description="density, rad/s/sqrt(Hz)")
    accelerometer_bias: float = Field(
        default=0.05, ge=0, description="sigma of the first bias, m/s^2 per axis"
    )
    gyroscope_bias: float = Field(default=0.01, ge=0, description="sigma of the first bias, rad/s per axis")
    accelerometer_walk: float = Field(default=0.0005, ge=0, description="bias walk, m/s^2/sqrt(s)")
    gyroscope_walk: float = Field(default=0.00005, ge=0, description="bias walk, rad/s/sqrt(s)")
    imu_scale: float = Field(default=0.0, ge=0, description="sigma of each axis' scale error, 0.003 = 0.3 %")
    imu_misalignment_deg: float = Field(
        default=0.0, ge=0, description="sigma of each cross-axis angle, degrees"
    )
    accelerometer_range: float | None = Field(default=None, gt=0, description="saturates at +- this, m/s^2")
    gyroscope_range: float | None = Field(default=None, gt=0, description="saturates at +- this, rad/s")

    @classmethod
    def _changes(cls, name: Preset) -> dict[str, Any]:
        return _PRESETS.get(name, {})

    @classmethod
    def preset(cls, name: Preset | str, **changes: Any) -> Self:
        """The named preset ("clean", "white", "realistic", "azure") with these settings changed."""
        return cls(**{**cls._changes(Preset(name)), **changes})


class ArmSimulation(SensorErrors):
    """An arm with a wrist IMU before a depth camera."""

    protocol: Literal["behind", "random", "hang"] = Field(
        default="behind",
        description="behind = held pose, behind the head, belly, behind the back; random = smooth motion "
        "with occlusions at random times; hang = arm at the side",
    )
    repetitions: int = Field(default=2, ge=1, description="how often the protocol `behind` is done")
    duration_s: float = Field(default=30.0, gt=1, description="length of `random` and `hang`, s")
    flexion_rad: tuple[float, float] = Field(
        default=(0.5, 2.0), description="the elbow's flexion in `random` is between these two, rad"
    )
    side: Literal["left", "right"] = "right"
    camera_frame: CameraFrame = CameraFrame.KINECT
    distance_m: float = Field(default=2.0, gt=0.8, description="person to camera, m")
    speed: float = Field(default=1.0, gt=0.1, le=3, description="factor on the speed of every movement")
    sway_m: float = Field(default=0.008, ge=0, description="rms of the shoulder's slow sway, m per axis")
    tremor_rad: float = Field(default=0.0003, ge=0, description="rms of a 7-11 Hz tremor, rad per angle")
    still_start_s: float = Field(default=0.0, ge=0, description="the arm first hangs without any motion, s")
    still_all: bool = Field(default=False, description="the arm hangs without any motion from start to end")
    strap: bool = Field(default=False, description="the camera finds the strap too")
    wobble_deg: float = Field(
        default=0.0, ge=0, description="rms of the strap's rotation on the forearm, degrees"
    )

    imus: Literal[
        "wrist",
        "wrist,upper-arm",
        "wrist,upper-arm,trunk",
        "wrist,hand",
        "wrist,upper-arm,hand",
        "wrist,upper-arm,hand,trunk",
    ] = Field(
        default="wrist", description="where an IMU is worn; with `trunk` the camera sees both shoulders"
    )
    wrist_deg: float = Field(
        default=0.0,
        ge=0,
        le=30,
        description="rms of the wrist's flexion, degrees; it deviates by a third of that",
    )
    hand_clock_s: float = Field(
        default=0.0, description="the hand IMU's clock is ahead of the wrist's by this, s"
    )
    hand_clock_ppm: float = Field(default=0.0, description="and its drift against it, ppm")
    trunk_turn_deg: float = Field(
        default=0.0, ge=0, description="rms of the trunk's turning and leaning, degrees; 0 = still"
    )
    trunk_clock_s: float = Field(
        default=0.0, description="the trunk IMU's clock is ahead of the wrist's by this, s"
    )
    upper_wobble_deg: float = Field(
        default=0.0,
        ge=0,
        description="soft tissue: rms of the upper-arm IMU's rotation against the bone, degrees; fast motion "
        "makes two to three times as much",
    )
    upper_clock_s: float = Field(
        default=0.0, description="the upper-arm IMU's clock is ahead of the wrist's by this, s"
    )
    upper_clock_ppm: float = Field(default=0.0, description="and its drift against it, ppm")

    occluded_state: Literal["not_tracked", "inferred"] = Field(
        default="not_tracked", description="state of the forearm's joints in an occlusion"
    )
    inferred_error_m: float = Field(
        default=0.06, ge=0, description="error of an inferred position, m per axis"
    )
    elbow_lag_s: float = Field(
        default=0.1, ge=0, description="the elbow stays tracked up to this much longer, s"
    )
    belly: Literal["tracked", "inferred", "not_tracked"] = Field(
        default="tracked", description="the forearm's joints while it is in front of the belly"
    )
    shoulder_lost: float = Field(
        default=0.0, ge=0, le=1, description="fraction of occluded frames without shoulder"
    )
    frozen_gaps: float = Field(
        default=0.0, ge=0, le=1, description="fraction of occlusions where joints stand still"
    )
    swapped_gaps: float = Field(
        default=0.0, ge=0, le=1, description="fraction of occlusions with the arms swapped"
    )
    occlusion_lengths_s: tuple[float, ...] = Field(
        default=(0.5, 1.0, 2.0, 3.0),
        description="lengths to choose from in `random`, s; empty = no occlusion",
    )
    occlusion_every_s: float = Field(
        default=6.0, gt=0, description="about one occlusion in this time in `random`, s"
    )
    end_gap_s: float = Field(default=0.0, ge=0, description="how long the end of `random` is occluded, s")

    cameras: tuple[float, ...] = Field(
        default=(),
        max_length=7,
        description="further depth cameras round the person: the angle of each from the first one's place, "
        "degrees, + towards the person's left",
    )
    camera_clock_s: float = Field(
        default=0.0, description="each camera's clock is ahead of the one before by this, s"
    )
    camera_clock_ppm: float = Field(default=0.0, description="drift of all but the first, ppm")
    camera_blind: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="fraction of the first camera's occlusions in `random` in which no other sees the "
        "forearm either",
    )
    camera_fault: Literal["none", "mirrored", "other_person", "moved"] = Field(
        default="none", description="what is wrong with the last further camera"
    )
    rgb: Literal["none", "first", "further", "all"] = Field(
        default="none",
        description="cameras without depth, of 1280 x 720 pixels: the first one, the further ones, or all, "
        "whose places are then known to 0.2 degrees and 5 mm; in space joints have their constant errors",
    )
    rgb_noise_px: float = Field(
        default=3.0,
        ge=0,
        description="their joints' noise, pixels per axis; half of its variance has the "
        "memory of the preset's noise",
    )

    @classmethod
    def _changes(cls, name: Preset) -> dict[str, Any]:
        extra = _PRESETS["arm"] if name in (Preset.REALISTIC, Preset.AZURE) else {}
        return {**super()._changes(name), **extra}


class PointSimulation(SensorErrors):
    """A tracked point (the strap alone) that carries an IMU, in a frame with z up."""

    duration_s: float = Field(default=30.0, gt=1, description="length, s")
    speed: float = Field(default=1.0, gt=0.1, le=3, description="factor on the speed of the movement")
    tilt_deg: float = Field(default=0.0, ge=0, le=45, description="gravity off -z by this angle, degrees")
    occlusion_lengths_s: tuple[float, ...] = Field(
        default=(0.5, 1.0, 2.0, 3.0), description="lengths to choose from, s; empty = no occlusion"
    )
    occlusion_every_s: float = Field(default=6.0, gt=0, description="about one occlusion in this time, s")
