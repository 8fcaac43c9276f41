"""Settings of the simulations that are made for a calibration."""

from __future__ import annotations

from .config import Settings, setting, size


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
