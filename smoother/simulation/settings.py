"""Settings of the simulations that are made for a calibration."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RestPoses(_Settings):
    """A sensor laid still in one pose after the other, or for long in one."""

    poses: int = Field(12, ge=1, le=26, description="rest poses: sides, then edges, then corners")
    rest_s: float = Field(3.0, ge=0.5, le=60, description="how long the sensor stays in a pose, s")
    long_rest_s: float | None = Field(
        None, ge=10, le=14400, description="one long rest instead of poses, for the noise; 3600 for an hour"
    )
    offset: float = Field(0.5, ge=0, description="of the accelerometer, m/s^2 per axis")
    scale: float = Field(0.03, ge=0, le=0.2, description="largest scale error of any axis")
    cross: float = Field(0.01, ge=0, le=0.2, description="largest cross-axis term")
    noise: float = Field(0.02, ge=0, description="of an accelerometer sample in a pose, m/s^2")


class TurningMagnetometer(_Settings):
    """A magnetometer turned in all directions."""

    hard_iron: float = Field(0.5, ge=0, le=5, description="offset, in parts of the field")
    soft_iron: float = Field(0.2, ge=0, le=0.25, description="largest error of scale, and cross term")
    field: float = Field(48.0, ge=0.01, description="the field's strength, in the sensor's unit")
    noise: float = Field(0.01, ge=0, le=0.2, description="of a sample, in parts of the field")


class ClockSources(_Settings):
    """A beep, broadcasts and the motion of a session."""

    rounds: int = Field(20, ge=4, le=1000, description="broadcasts")
    minutes: float = Field(5.0, ge=0.5, le=120, description="time over which they are spread")
    motion_s: float = Field(30.0, ge=10, le=600, description="length of the arm's recording, s")
    noise_db: float = Field(25.0, ge=0, le=80, description="noise of the room below the beep, dB")


class StrapImages(_Settings):
    """Images of an arm with its strap."""

    duration_s: float = Field(20.0, ge=8, le=120, description="length of the recording, s")
    every: int = Field(5, ge=1, le=60, description="one image every this many camera frames")
