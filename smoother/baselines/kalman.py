"""Baseline `kalman`: Le (thesis, Texas A&M 2017), a Kalman filter [p v a] an axis behind low-passes.

At its best within what was published: the work was done offline in MATLAB and says nothing of the direction
of filtering, so the low-passes run forwards and backwards and delay nothing. The Kalman filter itself is a
filter: inside a gap it has seen the camera only up to the gap, and it jumps where the camera comes back.
The gyroscope's low-pass belongs to the orientation, which the scene gives. While the camera sees, he
recommends to trust it much more than the IMU: gravity that a wrong orientation leaves does not show at
rest, so it is added to the IMU's deviation.

Order of the method: what is left of a movement by a low-pass of 2 Hz; on error-free sensors centimetres at
the pace of a reaching arm (each Hz of its motion weakened by 1/(1 + (f/2)^4)), millimetres at half of it.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ..array_types import FloatArray
from ..linalg import interpolate
from .linear import Chain, constant_acceleration, kalman_filter
from .scene import Path, Scene, no_answer

ACCELEROMETER_HZ = 6.0
CAMERA_HZ = 2.0
#: Standard deviations come from so many samples at rest.
REST_SAMPLES = 200
#: Frames farther apart than so many periods are not filtered together.
LONGEST_STEP_FRAMES = 4.5
#: Sensors without noise: the filter needs some, m and m/s^2.
LEAST_SIGMA_M = 1e-4
LEAST_SIGMA_ACC = 1e-3


def kalman(scene: Scene) -> Path:
    """Recover one segment; nan before the camera first sees the arm.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position and velocity, with the position's covariance.
    """
    frame_t, point = scene.visible_points
    first = int(np.searchsorted(scene.t, frame_t[0])) if len(frame_t) else len(scene.t)
    if first >= len(scene.t) - 1:
        return no_answer(scene)
    position = np.full((len(scene.t), 3), np.nan)
    velocity, covariance = position.copy(), np.full((len(scene.t), 3, 3), np.nan)
    acceleration = low_pass_acceleration(scene)
    camera = camera_at_samples(scene.t, frame_t, point)
    sigma_m, sigma_acc = deviations_at_rest(camera, acceleration, scene.point_sigma_m)
    sigma_acc = np.hypot(sigma_acc, scene.attitude_sigma_rad * np.linalg.norm(scene.gravity))
    chain = state_model(scene.t[first:], camera[first:], acceleration[first:], sigma_m, sigma_acc)
    filtered, _ = kalman_filter(chain)
    position[first:], velocity[first:] = filtered.mean[..., 0, 0], filtered.mean[..., 1, 0]
    covariance[first:] = np.einsum("na,ab->nab", filtered.covariance[..., 0, 0], np.eye(3))
    return Path(position, velocity, covariance)


def low_pass_acceleration(scene: Scene) -> FloatArray:
    """Acceleration (n, 3) m/s^2 in {K} from the low-passed accelerometer (5-9, in the scene's frames)."""
    force = low_pass(scene.imu.acc, scene.imu.rate_hz, ACCELEROMETER_HZ)
    return np.einsum("nij,nj->ni", scene.R_K_A, force) + scene.gravity


def low_pass(values: FloatArray, rate_hz: float, cutoff_hz: float) -> FloatArray:
    """2nd-order Butterworth, forwards and backwards; values (n, 3) evenly sampled."""
    cutoff = min(cutoff_hz, 0.45 * rate_hz)
    sections = butter(2, cutoff, fs=rate_hz, output="sos")
    pad = min(3 * round(rate_hz / cutoff), len(values) - 1)
    return np.asarray(sosfiltfilt(sections, values, axis=0, padlen=pad))


def camera_at_samples(t: FloatArray, frame_t: FloatArray, point: FloatArray) -> FloatArray:
    """(n, 3) m: the low-passed camera at the IMU sample nearest to each frame, nan elsewhere.

    Those samples between frames to which the method gives the last frame's value are given infinite
    variance by it too, so nothing is lost by leaving them out. Frames that follow each other are filtered
    together, those after a gap anew.
    """
    out = np.full((len(t), 3), np.nan)
    period = float(np.median(np.diff(frame_t))) if len(frame_t) > 1 else 1.0
    apart = np.flatnonzero(np.diff(frame_t) > LONGEST_STEP_FRAMES * period) + 1
    for rows in np.split(np.arange(len(frame_t)), apart):
        first, last = frame_t[rows[0]], frame_t[rows[-1]]
        even = np.arange(first, last + 0.5 * period, period)
        smooth = low_pass(interpolate(frame_t[rows], point[rows], even), 1.0 / period, CAMERA_HZ)
        nearest = np.searchsorted(0.5 * (t[1:] + t[:-1]), frame_t[rows])
        out[nearest] = interpolate(even, smooth, np.clip(t[nearest], first, last))
    return out


def deviations_at_rest(
    camera: FloatArray, acceleration: FloatArray, point_sigma_m: float
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (3,) of camera and acceleration over 200 samples, m and m/s^2.

    His recordings begin at rest; here the 200 samples count whose acceleration varies least. Where those are
    not at rest either, the camera's is never more than the noise that the scene knows.
    """
    count = min(REST_SAMPLES, len(acceleration) // 2)
    spread = [
        float(np.linalg.norm(acceleration[k : k + count].std(axis=0)))
        if np.isfinite(camera[k : k + count, 0]).sum() > count // 10
        else np.inf
        for k in range(0, len(acceleration) - count + 1, max(count // 4, 1))
    ]
    start = int(np.argmin(spread)) * max(count // 4, 1)
    rest = camera[start : start + count]
    rest = rest[np.isfinite(rest[:, 0])]
    sigma_m = rest.std(axis=0) if len(rest) > 1 else np.full(3, point_sigma_m)
    sigma_acc = acceleration[start : start + count].std(axis=0)
    return (
        np.clip(sigma_m, LEAST_SIGMA_M, max(point_sigma_m, LEAST_SIGMA_M)),
        np.maximum(sigma_acc, LEAST_SIGMA_ACC),
    )


def state_model(
    t: FloatArray, camera: FloatArray, acceleration: FloatArray, sigma_m: FloatArray, sigma_acc: FloatArray
) -> Chain:
    """Equations 10-15 for the three axes; Q with its entry [3, 1] as dt^2/2 (misprinted).

    The measurement of a state acts on that state (H x_k, misprinted as x_{k-1} in 11).

    Parameters
    ----------
    t : ndarray, shape (n,), s
        Times of the IMU's samples.
    camera : ndarray, shape (n, 3), m
        Positions; nan where there is none.
    acceleration : ndarray, shape (n, 3), m/s^2
        Without gravity, in {K}.
    sigma_m, sigma_acc : ndarray, shape (3,), m and m/s^2
        Standard deviations of the two, an axis each.

    Returns
    -------
    chain : Chain
        Of [p v a], each axis for itself: (n, 3, 3, 1).
    """
    dt = np.diff(t)
    F = constant_acceleration(dt)[:, None]
    push = np.stack([0.5 * dt**2, dt, np.ones_like(dt)], axis=1)
    Q = np.einsum("ni,nj,a->naij", push, push, sigma_acc**2)
    has_camera = np.isfinite(camera[:, 0])
    information, vector = np.zeros((len(t), 3, 3, 3)), np.zeros((len(t), 3, 3, 1))
    information[has_camera, :, 0, 0] = sigma_m**-2.0
    vector[has_camera, :, 0, 0] = camera[has_camera] / sigma_m**2
    information[..., 2, 2] = sigma_acc**-2.0
    vector[..., 2, 0] = acceleration / sigma_acc**2
    start = np.zeros((3, 3, 1))
    start[:, 0, 0] = camera[has_camera][0]
    return Chain(
        F, Q, np.zeros((len(dt), 1, 1, 1)), information, vector, start, np.tile(np.eye(3), (3, 1, 1))
    )
