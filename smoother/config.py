"""The smoother's configuration: few leaves, each with its unit, defaults in code."""

from __future__ import annotations

from enum import StrEnum

from pydantic import BaseModel, ConfigDict, Field


class Anatomy(StrEnum):
    """Whose arm it is: decides which lengths are possible."""

    ADULT = "adult"
    CHILD = "child"
    ANY = "any"  # phantoms and robots: every length is


class _Section(BaseModel):
    """A group of settings; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class CameraNoise(_Section):
    """Noise of the camera's joints before the recording itself shows it."""

    joint_sigma_m: float = Field(
        default=0.010, gt=0, description="white noise of a joint, m per axis; start value"
    )
    cauchy: float = Field(
        default=2.8, gt=0, description="length of a residual, in sigmas, where its weight is halved"
    )


class ImuNoise(_Section):
    """The inertial sensor, errors of scale and mounting of a consumer device included."""

    accelerometer_density: float = Field(default=0.006, gt=0, description="m/s^2/sqrt(Hz)")
    gyroscope_density: float = Field(default=0.0008, gt=0, description="rad/s/sqrt(Hz)")
    accelerometer_share: float = Field(
        default=0.004, ge=0, description="density a m/s^2 beyond gravity, sqrt(s)"
    )
    gyroscope_share: float = Field(default=0.0012, ge=0, description="density a rad/s of turning, sqrt(s)")
    scale_sigma: float = Field(
        default=0.005, gt=0, description="errors of scale and axes, 0.005 = 0.5 % or 0.3 degrees"
    )
    accelerometer_bias_sigma: float = Field(
        default=0.3, gt=0, description="m/s^2, before the recording speaks"
    )
    gyroscope_bias_sigma: float = Field(default=0.05, gt=0, description="rad/s, before the recording speaks")
    accelerometer_bias_walk: float = Field(default=0.01, gt=0, description="m/s^2/sqrt(s) inside a window")
    gyroscope_bias_walk: float = Field(default=0.001, gt=0, description="rad/s/sqrt(s) inside a window")


class ArmPrior(_Section):
    """The arm's measures and motion before the recording itself shows them."""

    upper_arm_m: float = Field(default=0.30, gt=0, description="shoulder to elbow where nothing is known, m")
    upper_arm_sigma_m: float = Field(default=0.05, gt=0, description="m")
    upper_arm_flex_m: float = Field(default=0.005, gt=0, description="how far from constant the length is, m")
    height_m: float | None = Field(
        default=None,
        gt=0.4,
        lt=2.5,
        description="body height, m: how long the limbs are, where one camera without depth sees them",
    )
    anatomy: Anatomy = Field(default=Anatomy.ADULT, description="adult, child, or any (phantoms, robots)")
    shoulder_walk: float = Field(default=0.10, gt=0, description="how the shoulder wanders, m/sqrt(s)")


class Windows(_Section):
    """How a recording is cut into sections that are solved side by side."""

    margin_s: float = Field(default=2.5, gt=0, description="time on both sides of a section, s")
    processes: int = Field(default=0, ge=0, description="worker processes; 0 = one per core")


class Config(_Section):
    """Everything that can be set; `unocclude config` prints it."""

    camera: CameraNoise = CameraNoise()
    imu: ImuNoise = ImuNoise()
    arm: ArmPrior = ArmPrior()
    windows: Windows = Windows()
