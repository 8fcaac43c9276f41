"""A clock that was measured for a session, as a prior for recovering a recording of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from smoother.errors import CalibrationError
from smoother.measurements.clock import Clock
from smoother.recording import Recording

from ..file import CalibrationFile

#: Words by which a clock is the camera's.
CAMERA_WORDS = ("camera", "kinect", "k4a", "azure", "depth", "realsense")
#: Nothing is measured better than a frame is stamped, s.
LEAST_SIGMA_S = 0.0005
#: A time beyond this counts from 1970, not from the recording's start, s.
UNIX_S = 1e8
#: A skew with this sigma was not measured, ppm.
UNKNOWN_PPM = 499.0
#: What crystals differ by in most devices, ppm: widens sigma where it was not measured.
TYPICAL_PPM = 50.0


def measured_clock(file: CalibrationFile, recording: Recording) -> Clock | None:
    """The link of a file's `[clock]` between the recording's camera and its IMU.

    Parameters
    ----------
    file : CalibrationFile
        As `unocclude calibrate clock` writes it.
    recording : Recording

    Returns
    -------
    clock : Clock or None
        t_imu = t_camera + offset; None where the file has no `[clock]` or none of a camera.

    Raises
    ------
    CalibrationError
        A link lacks a number, or several may be meant.
    """
    table = file.tables.get("clock")
    if not isinstance(table, dict) or not isinstance(table.get("links"), list):
        return None
    links = [link for link in table["links"] if isinstance(link, dict) and _camera_ends(link) == 1]
    named = [link for link in links if _imu_end(link).lower() in recording.imu.name.lower()]
    links = named or links
    if not links:
        return None
    if len(links) > 1:
        names = ", ".join(_imu_end(link) for link in links)
        raise CalibrationError(
            f"{file.source}: its [clock] links the camera with {names}, and none has the name of the IMU,"
            f" {recording.imu.name}; give --clock-offset"
        )
    return _clock(links[0], file.source, recording)


def _camera_ends(link: Mapping[str, Any]) -> int:
    return sum(_is_camera(str(link.get(end, ""))) for end in ("from", "to"))


def _is_camera(name: str) -> bool:
    return any(word in name.lower() for word in CAMERA_WORDS)


def _imu_end(link: Mapping[str, Any]) -> str:
    return str(link["to"] if _is_camera(str(link["from"])) else link["from"])


def _clock(link: Mapping[str, Any], source: str, recording: Recording) -> Clock:
    numbers = {}
    for key, default in (
        ("offset_s", None),
        ("sigma_s", None),
        ("skew_ppm", 0.0),
        ("skew_sigma_ppm", 0.0),
        ("at_s", 0.0),
    ):
        value = link.get(key, default)
        if not isinstance(value, int | float) or not np.isfinite(value):
            raise CalibrationError(f"{source}: {key} of a link of [clock] must be a number")
        numbers[key] = float(value)
    if numbers["sigma_s"] < 0.0:
        raise CalibrationError(f"{source}: sigma_s of a link of [clock] cannot be negative")
    offset_s, skew, at_s = numbers["offset_s"], 1e-6 * numbers["skew_ppm"], numbers["at_s"]
    if not _is_camera(str(link["from"])):  # t_camera = t_imu + offset, turned round
        offset_s, skew, at_s = -offset_s, -skew, at_s + offset_s
    if abs(at_s) > UNIX_S:
        at_s -= 1e-9 * recording.origin_ns
    t = recording.arm.t_s
    farthest_s = max(abs(float(t[0]) - at_s), abs(float(t[-1]) - at_s)) if len(t) else 0.0
    skew_sigma_ppm = numbers["skew_sigma_ppm"]
    if skew_sigma_ppm >= UNKNOWN_PPM:
        skew, skew_sigma_ppm = 0.0, TYPICAL_PPM
    drift_s = 1e-6 * skew_sigma_ppm * farthest_s
    sigma_s = float(np.hypot(max(numbers["sigma_s"], LEAST_SIGMA_S), drift_s))
    return Clock(np.array([at_s]), np.array([offset_s]), sigma_s, skew=skew)
