"""Kalman filters of points: the linear filter and smoother; the baselines `kalman` and `multirate-kalman`.

Measurements come in their information form, so that a step takes any number of them at one price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ..array_types import BoolArray, FloatArray
from ..linalg import interpolate, nearest
from .scene import Path, Scene, no_answer, path_at


@dataclass(frozen=True)
class Chain:
    """A Gauss-Markov chain of n states of dimension d, and what was measured of it."""

    F: FloatArray  # (n - 1, ..., d, d): transitions and covariances of the process noise
    Q: FloatArray
    information: FloatArray  # (n, ..., d, d): sum of H' R^-1 H; zero where nothing was measured
    vector: FloatArray  # (n, ..., d, c): sum of H' R^-1 z
    mean: FloatArray  # (..., d, c): of the first state before it is measured
    covariance: FloatArray  # (..., d, d): likewise
    drift: FloatArray | None = None  # (n - 1, ..., d, c): what a state gains beside F


@dataclass(frozen=True)
class FilterEstimates:
    """What is known of a chain's states."""

    mean: FloatArray  # (n, ..., d, c)
    covariance: FloatArray  # (n, ..., d, d)


def kalman_filter(chain: Chain) -> tuple[FilterEstimates, FilterEstimates]:
    """Each state from the measurements so far (Kalman, J. Basic Engineering 82:35-45, 1960), and before."""
    n, (size, columns) = len(chain.information), chain.mean.shape[-2:]
    lead = np.broadcast_shapes(chain.mean.shape[:-2], chain.information.shape[1:-2], chain.Q.shape[1:-2])
    mean, covariance = np.empty((n, *lead, size, columns)), np.empty((n, *lead, size, size))
    mean_before, covariance_before = np.empty_like(mean), np.empty_like(covariance)
    measured = np.abs(chain.information.reshape(n, -1)).max(axis=1) > 0.0
    x, P = (
        np.broadcast_to(chain.mean, mean.shape[1:]),
        np.broadcast_to(chain.covariance, covariance.shape[1:]),
    )
    for k in range(n):
        if k:
            F = chain.F[k - 1]
            x, P = F @ x, F @ P @ np.swapaxes(F, -1, -2) + chain.Q[k - 1]
            x = x if chain.drift is None else x + chain.drift[k - 1]
        mean_before[k], covariance_before[k] = x, P
        if measured[k]:
            A = chain.information[k]
            P = np.linalg.solve(np.eye(size) + P @ A, P)  # (P^-1 + A)^-1
            P = 0.5 * (P + np.swapaxes(P, -1, -2))
            x = x + P @ (chain.vector[k] - A @ x)
        mean[k], covariance[k] = x, P
    return FilterEstimates(mean, covariance), FilterEstimates(mean_before, covariance_before)


def rts_smoother(chain: Chain) -> FilterEstimates:
    """Each state from all measurements (Rauch, Tung and Striebel, AIAA Journal 3:1445-1450, 1965)."""
    filtered, predicted = kalman_filter(chain)
    mean, covariance = filtered.mean.copy(), filtered.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        back = np.linalg.solve(predicted.covariance[k + 1], chain.F[k] @ covariance[k])
        gain = np.swapaxes(back, -1, -2)
        mean[k] += gain @ (mean[k + 1] - predicted.mean[k + 1])
        covariance[k] += gain @ (covariance[k + 1] - predicted.covariance[k + 1]) @ back
    return FilterEstimates(mean, covariance)


def axes_chain(
    t: FloatArray,  # (n,) s
    Q: FloatArray,  # (n - 1, ..., 3, 3, 3) or what broadcasts to it
    position: FloatArray,  # (n, 3) m and m/s^2; nan where nothing was measured
    acceleration: FloatArray,
    weights: tuple[FloatArray | float, FloatArray | float],  # inverse variances of the two
    covariance: FloatArray,  # (3, 3): of the first state
) -> Chain:
    """Position, velocity and acceleration of each axis; the first and the last are measured."""
    dt, n = np.diff(t), len(t)
    F = np.tile(np.eye(3), (n - 1, 1, 1, 1))
    F[..., 0, 1] = F[..., 1, 2] = dt[:, None]
    F[..., 0, 2] = 0.5 * dt[:, None] ** 2
    information, vector, mean = np.zeros((n, 3, 3, 3)), np.zeros((n, 3, 3, 1)), np.zeros((3, 3, 1))
    for row, values, weight in zip((0, 2), (position, acceleration), weights, strict=True):
        seen = np.isfinite(values[:, 0])
        weight = np.broadcast_to(weight, values.shape)[seen]
        information[seen, :, row, row], vector[seen, :, row, 0] = weight, weight * values[seen]
    mean[:, 0, 0] = position[np.isfinite(position[:, 0])][0]
    return Chain(F, Q, information, vector, mean, covariance)


ACCELEROMETER_HZ = 6.0
CAMERA_HZ = 2.0
#: Standard deviations come from this many samples at rest.
REST_SAMPLES = 200
#: Frames farther apart than this many periods are not filtered together.
LONGEST_STEP_FRAMES = 4.5
#: Sensors without noise: the filter needs some, m and m/s^2.
LEAST_SIGMA_M = 1e-4
LEAST_SIGMA_ACC = 1e-3


def kalman(scene: Scene) -> Path:
    """Recover one segment; nan before the camera first sees the arm (Le, thesis, Texas A&M 2017)."""
    frame_t, point = scene.visible_points
    first = int(np.searchsorted(scene.t, frame_t[0])) if len(frame_t) else len(scene.t)
    if first >= len(scene.t) - 1:
        return no_answer(scene)
    force = low_pass(scene.imu.acc, scene.imu.rate_hz, ACCELEROMETER_HZ)
    acceleration = np.einsum("nij,nj->ni", scene.R_K_A, force) + scene.gravity  # (5-9)
    camera = camera_at_samples(scene.t, frame_t, point)
    sigma_m, sigma_acc = deviations_at_rest(camera, acceleration, scene.point_sigma_m)
    sigma_acc = np.hypot(sigma_acc, scene.attitude_sigma_rad * np.linalg.norm(scene.gravity))
    chain = state_model(scene.t[first:], camera[first:], acceleration[first:], sigma_m, sigma_acc)
    filtered, _ = kalman_filter(chain)
    p, v = filtered.mean[:, :, 0, 0], filtered.mean[:, :, 1, 0]
    return path_at(scene, np.arange(first, len(scene.t)), p, v, filtered.covariance[..., 0, 0])


def low_pass(values: FloatArray, rate_hz: float, cutoff_hz: float) -> FloatArray:
    """2nd-order Butterworth, forwards and backwards; values (n, 3) evenly sampled."""
    cutoff = min(cutoff_hz, 0.45 * rate_hz)
    pad = min(3 * round(rate_hz / cutoff), len(values) - 1)
    return np.asarray(sosfiltfilt(butter(2, cutoff, fs=rate_hz, output="sos"), values, axis=0, padlen=pad))


def camera_at_samples(t: FloatArray, frame_t: FloatArray, point: FloatArray) -> FloatArray:
    """(n, 3) m: the low-passed camera at the IMU sample nearest to each frame, nan elsewhere."""
    out = np.full((len(t), 3), np.nan)
    period = float(np.median(np.diff(frame_t))) if len(frame_t) > 1 else 1.0
    apart = np.flatnonzero(np.diff(frame_t) > LONGEST_STEP_FRAMES * period) + 1
    for rows in np.split(np.arange(len(frame_t)), apart):
        first, last = frame_t[rows[0]], frame_t[rows[-1]]
        even = np.arange(first, last + 0.5 * period, period)
        smooth = low_pass(interpolate(frame_t[rows], point[rows], even), 1.0 / period, CAMERA_HZ)
        at = nearest(t, frame_t[rows])
        out[at] = interpolate(even, smooth, np.clip(t[at], first, last))
    return out


def deviations_at_rest(
    camera: FloatArray, acceleration: FloatArray, point_sigma_m: float
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (3,) of camera and acceleration over 200 samples, m and m/s^2."""
    count = min(REST_SAMPLES, len(acceleration) // 2)
    windows = [slice(k, k + count) for k in range(0, len(acceleration) - count + 1, max(count // 4, 1))]
    spread = [
        float(np.linalg.norm(acceleration[each].std(axis=0)))
        if np.isfinite(camera[each, 0]).sum() > count // 10
        else np.inf
        for each in windows
    ]
    quiet = windows[int(np.argmin(spread))]
    rest = camera[quiet][np.isfinite(camera[quiet, 0])]
    sigma_m = rest.std(axis=0) if len(rest) > 1 else np.full(3, point_sigma_m)
    return (
        np.clip(sigma_m, LEAST_SIGMA_M, max(point_sigma_m, LEAST_SIGMA_M)),
        np.maximum(acceleration[quiet].std(axis=0), LEAST_SIGMA_ACC),
    )


def state_model(
    t: FloatArray, camera: FloatArray, acceleration: FloatArray, sigma_m: FloatArray, sigma_acc: FloatArray
) -> Chain:
    """Equations 10-15 for the three axes; Q with its entry [3, 1] as dt^2/2 (misprinted)."""
    dt = np.diff(t)
    push = np.stack([0.5 * dt**2, dt, np.ones_like(dt)], axis=1)
    Q = np.einsum("ni,nj,a->naij", push, push, sigma_acc**2)
    return axes_chain(t, Q, camera, acceleration, (sigma_m**-2.0, sigma_acc**-2.0), np.eye(3))


#: Published values in SI units.
Q_STILL = 2000e-6  # m^2/s^5
#: Of a position, and of an acceleration of a still and of a moving hand, m and m/s^2.
FENG_SIGMAS = (0.008, 0.010, 0.100)
MOVING_SPEED = 0.150  # m/s
#: Process noises of a moving hand that are tried, m^2/s^5.
Q_MOVING: FloatArray = 2000e-6 * np.power(10.0, np.arange(0, 7))
#: What is known of velocity and acceleration before the first frame, m/s and m/s^2.
START_SIGMA = (1.0, 10.0)
LEAST_CAMERA_SIGMA_M = 1e-4


@dataclass(frozen=True)
class Events:
    """Measurements in order of time."""

    t: FloatArray  # (m,) s
    position: FloatArray  # (m, 3) m: nan where the event is not a frame
    acceleration: FloatArray  # (m, 3) m/s^2: nan where it is not a sample of the IMU


def multirate_kalman(scene: Scene) -> Path:
    """Recover one segment; nan before the camera first sees the arm (Feng, thesis, Glasgow 2014, ch. 3)."""
    # not given: the process noise of a moving hand, here the likeliest of `Q_MOVING` on the camera's samples.
    # Gravity that the orientation may leave in the accelerations is added to their noise. The switch follows
    # the speed of a first pass of the filter (published: of its last state)
    frame_t, point = scene.visible_points
    frame_t, point = frame_t[frame_t <= scene.t[-1]], point[frame_t <= scene.t[-1]]
    if len(frame_t) < 2:
        return no_answer(scene)
    after = np.flatnonzero(scene.t >= frame_t[0])
    leak = scene.attitude_sigma_rad * float(np.linalg.norm(scene.gravity))
    sigmas = np.hypot(FENG_SIGMAS, (0.0, leak, leak))
    sigmas[0] = max(scene.point_sigma_m, LEAST_CAMERA_SIGMA_M)
    events = merge(frame_t, point, scene.t[after], scene.acceleration[after])
    moving = np.ones(len(events.t), dtype=bool)
    filtered, predicted = kalman_filter(multirate_model(events, moving, sigmas, Q_MOVING))
    is_frame, is_sample = np.isfinite(events.position[:, 0]), np.isfinite(events.acceleration[:, 0])
    variance = predicted.covariance[is_frame, ..., 0, 0] + sigmas[0] ** 2
    innovation = events.position[is_frame, None] - predicted.mean[is_frame, ..., 0, 0]
    best = int(np.argmin(np.sum(np.log(variance) + innovation**2 / variance, axis=(0, 2))))
    moving = np.linalg.norm(filtered.mean[:, best, :, 1, 0], axis=1) > MOVING_SPEED
    filtered, _ = kalman_filter(multirate_model(events, moving, sigmas, float(Q_MOVING[best])))
    mean, covariance = filtered.mean[is_sample], filtered.covariance[is_sample]
    return path_at(scene, after, mean[:, :, 0, 0], mean[:, :, 1, 0], covariance[..., 0, 0])


def merge(frame_t: FloatArray, point: FloatArray, t: FloatArray, acceleration: FloatArray) -> Events:
    """Frames and IMU samples in the order of time; a frame precedes a sample of the same time."""
    order = np.argsort(np.concatenate([frame_t, t]), kind="stable")
    none_p, none_a = np.full((len(t), 3), np.nan), np.full((len(frame_t), 3), np.nan)
    columns = ([frame_t, t], [point, none_p], [none_a, acceleration])
    return Events(*(np.concatenate(parts)[order] for parts in columns))


def multirate_model(
    events: Events, moving: BoolArray, sigmas: Sequence[float] | FloatArray, q_moving: FloatArray | float
) -> Chain:
    """Equations 3.1-3.7 for one process noise or several (c,) side by side."""
    q, (sigma_m, acc_still, acc_moving) = np.asarray(q_moving, dtype=np.float64), sigmas
    dt = np.diff(events.t)
    q_t = np.where(moving[1:].reshape(-1, *([1] * q.ndim)), np.maximum(q, Q_STILL), Q_STILL)
    # Q's entry [2, 2] is dt^3/3 (Bar-Shalom et al. 2004; misprinted as dt^3/6 in 3.3)
    powers = np.array([[5, 4, 3], [4, 3, 2], [3, 2, 1]])
    shares = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
    Q = (shares * dt[:, None, None] ** powers).reshape(-1, *([1] * q.ndim), 3, 3) * q_t[..., None, None]
    weights = sigma_m**-2.0, np.where(moving, acc_moving, acc_still)[:, None] ** -2.0
    start = np.diag([sigma_m**2, START_SIGMA[0] ** 2, START_SIGMA[1] ** 2])
    return axes_chain(events.t, Q[..., None, :, :], events.position, events.acceleration, weights, start)
