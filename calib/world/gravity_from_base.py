"""A recording whose camera carries a base IMU: where down is in the camera, and how well that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from smoother.array_types import FloatArray
from smoother.recording import CameraFrame, ImuStream, Recording

from ..file import CalibrationFile
from ..imu.sensor import sensor_of
from .world_calibration import tilt_covariance
from .world_table import CameraFromBase, read_table

#: What a bias drifts with temperature, m/s^2; axes of the skeleton against those of the images, rad.
_DRIFT_M_S2, _SKELETON_RAD = 0.02, np.radians(0.05)
#: A camera that tilts by more than this in a recording did not stand still, rad.
_MOVED_RAD = np.radians(0.7)
#: So much of a recording is looked at together, s.
_PART_S = 600
#: Optical axes (x right, y down, z forward) to those of the skeleton.
_FROM_OPTICAL = {CameraFrame.OPTICAL: np.eye(3), CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0])}


def with_gravity(recording: Recording, file: CalibrationFile) -> Recording:
    """The recording with down in the camera from its base IMU, where both know it.

    `gravity_hint` and `gravity_sigma_rad` are set, and a note says so. Without a base IMU or without
    `[camera_from_base]` the recording is given back as it is.

    Raises
    ------
    CalibrationError
        `[camera_from_base]` cannot be used.
    """
    known = read_table(file)
    if known is None or recording.base_imu is None or len(recording.base_imu) == 0:
        return recording
    if recording.camera_frame not in _FROM_OPTICAL:
        return _noted(
            recording, "The base IMU was not used: the recording does not say how its camera's axes lie."
        )
    sensor = sensor_of(file, recording.base_imu.name)
    if (sensor is not None and sensor.accelerometer is not None) != known.accelerometer_corrected:
        return _noted(
            recording,
            "The base IMU was not used: its accelerometer's calibration is newer or older than "
            "[camera_from_base]; run `unocclude calibrate world` again.",
        )
    down, sigma, moved = down_of(known, recording.base_imu)
    note = f"Gravity in the camera is from the base IMU, good to {np.degrees(sigma):.1f} degrees."
    if moved > _MOVED_RAD:
        note += f" The camera was tilted by up to {np.degrees(moved):.1f} degrees while it recorded."
    to_skeleton = _FROM_OPTICAL[recording.camera_frame]
    held = replace(recording, gravity_hint=to_skeleton @ down, gravity_sigma_rad=sigma)
    return _noted(held, note)


def down_of(known: CameraFromBase, base: ImuStream) -> tuple[FloatArray, float, float]:
    """Down in {K} (3,) by the base IMU, its sigma (rad an axis), and how far the camera tilted (rad)."""
    means = _means(base)
    acc = np.median(means, axis=0) - known.accelerometer_bias
    each = (means - known.accelerometer_bias) / np.linalg.norm(means, axis=1)[:, None]
    up = acc / np.linalg.norm(acc)
    away = np.linalg.norm(np.cross(each, up), axis=1)
    moved = float(np.percentile(away, 95)) if len(away) > 1 else 0.0
    drifted = known.covariance.copy()
    drifted[3:, 3:] += _DRIFT_M_S2**2 * np.eye(3)
    variance = np.trace(tilt_covariance(known.R_K_B, drifted, acc)) / 2
    sigma = float(np.sqrt(variance + _SKELETON_RAD**2 + (moved if moved > _MOVED_RAD else 0.0) ** 2))
    return -known.R_K_B @ up, sigma, moved


def _means(base: ImuStream) -> FloatArray:
    """Specific force (seconds, 3) averaged over each second that has samples, a part at a time."""
    second = np.floor(base.t_s - base.t_s[0]).astype(int)
    means = []
    for start in range(0, int(second[-1]) + 1, _PART_S):
        rows = slice(*np.searchsorted(second, [start, start + _PART_S]).tolist())
        _, inverse = np.unique(second[rows], return_inverse=True)
        count = np.bincount(inverse)
        means += [np.stack([np.bincount(inverse, base.acc[rows, i]) / count for i in range(3)], axis=1)]
    return np.concatenate(means)


def _noted(recording: Recording, note: str) -> Recording:
    return replace(recording, notes=(*recording.notes, note))
