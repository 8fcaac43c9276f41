"""Baseline `multirate-kalman`: Feng (Glasgow thesis, 2014), chapter 3, a Kalman filter fed at two rates.

A Wiener-process acceleration model an axis, fed with positions when there is a frame and with accelerations
when there is an IMU sample. At its best within what was published: every measurement at its own time. It is
a filter: inside a gap it has seen the camera only up to the gap, and it jumps where the camera comes back.

Published: q = 2000 mm^2/s^5, 8 mm, 10 mm/s^2 for a hand at rest and 100 mm/s^2 above 150 mm/s, where the
process noise grows too, to a value that is not given: here the likeliest of `Q_MOVING` on the camera's
samples of this segment. The camera's noise is the scene's; gravity that the scene's orientation may leave in
the accelerations is added to theirs. The switch follows the speed of a first pass of the filter (the
published one that of its last state).

Order of the method: on error-free sensors millimetres, what a constant acceleration between samples and the
sensor's averaging over its interval leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from .linear import Chain, FilterEstimates, constant_acceleration, kalman_filter
from .scene import Path, Scene, no_answer

#: Published values in SI units.
Q_STILL = 2000e-6  # m^2/s^5
POSITION_SIGMA_M = 0.008
ACC_SIGMA_STILL = 0.010  # m/s^2
ACC_SIGMA_MOVING = 0.100
MOVING_SPEED = 0.150  # m/s
#: Process noises of a moving hand that are tried, m^2/s^5.
Q_MOVING = tuple(2000e-6 * 10.0 ** np.arange(0, 7))
#: What is known of velocity and acceleration before the first frame, m/s and m/s^2.
START_SIGMA = (1.0, 10.0)
LEAST_SIGMA_M = 1e-4


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations of the measurements.

    Attributes
    ----------
    sigma_m : float, m
        Of a position.
    acc_still, acc_moving : float, m/s^2
        Of an acceleration of a still and of a moving hand.
    """

    sigma_m: float = POSITION_SIGMA_M
    acc_still: float = ACC_SIGMA_STILL
    acc_moving: float = ACC_SIGMA_MOVING


@dataclass(frozen=True)
class Events:
    """Measurements in order of time.

    Attributes
    ----------
    t : ndarray, shape (m,), s
    position : ndarray, shape (m, 3), m
        Nan where the event is no frame.
    acceleration : ndarray, shape (m, 3), m/s^2
        Nan where it is no sample of the IMU.
    """

    t: FloatArray
    position: FloatArray
    acceleration: FloatArray


def multirate_kalman(scene: Scene) -> Path:
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
    frame_t, point = frame_t[frame_t <= scene.t[-1]], point[frame_t <= scene.t[-1]]
    if len(frame_t) < 2:
        return no_answer(scene)
    n = len(scene.t)
    position, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    covariance = np.full((n, 3, 3), np.nan)
    after = np.flatnonzero(scene.t >= frame_t[0])
    leak = scene.attitude_sigma_rad * float(np.linalg.norm(scene.gravity))
    noise = FilterNoise(
        max(scene.point_sigma_m, LEAST_SIGMA_M), *np.hypot((ACC_SIGMA_STILL, ACC_SIGMA_MOVING), leak)
    )
    events = merge(frame_t, point, scene.t[after], scene.acceleration[after])
    moving = np.ones(len(events.t), dtype=bool)
    q_moving, filtered = likeliest(events, moving, noise)
    moving = np.linalg.norm(filtered.mean[:, 1], axis=1) > MOVING_SPEED
    filtered, _ = kalman_filter(state_model(events, moving, noise, q_moving))
    row = np.flatnonzero(np.isfinite(events.acceleration[:, 0]))
    position[after], velocity[after] = filtered.mean[row, 0], filtered.mean[row, 1]
    covariance[after] = filtered.covariance[row, 0, 0][:, None, None] * np.eye(3)
    return Path(position, velocity, covariance)


def merge(frame_t: FloatArray, point: FloatArray, t: FloatArray, acceleration: FloatArray) -> Events:
    """Frames and IMU samples in the order of time; a frame stands before a sample of the same time."""
    order = np.argsort(np.concatenate([frame_t, t]), kind="stable")
    none_p, none_a = np.full((len(t), 3), np.nan), np.full((len(frame_t), 3), np.nan)
    return Events(
        np.concatenate([frame_t, t])[order],
        np.concatenate([point, none_p])[order],
        np.concatenate([none_a, acceleration])[order],
    )


def likeliest(events: Events, moving: BoolArray, noise: FilterNoise) -> tuple[float, FilterEstimates]:
    """The process noise of a moving hand under which the camera's samples are likeliest, and its filter."""
    candidates = np.array(Q_MOVING)
    filtered, predicted = kalman_filter(state_model(events, moving, noise, candidates))
    is_frame = np.isfinite(events.position[:, 0])
    variance = predicted.covariance[is_frame, :, 0, 0] + noise.sigma_m**2
    innovation = events.position[is_frame, None] - predicted.mean[is_frame, :, 0]
    loss = np.sum(3.0 * np.log(variance) + np.sum(innovation**2, axis=2) / variance, axis=0)
    best = int(np.argmin(loss))
    return float(candidates[best]), FilterEstimates(filtered.mean[:, best], filtered.covariance[:, best])


def state_model(events: Events, moving: BoolArray, noise: FilterNoise, q_moving: FloatArray | float) -> Chain:
    """Equations 3.1-3.7 with the continuous Wiener-process acceleration model.

    Q's entry [2, 2] is dt^3/3 (Bar-Shalom et al. 2004; misprinted as dt^3/6 in 3.3).

    Parameters
    ----------
    events : Events
        What was measured.
    moving : ndarray, shape (m,)
        Whether the hand moves at the events.
    noise : FilterNoise
        Of the measurements.
    q_moving : float or ndarray, shape (c,), m^2/s^5
        Process noise of a moving hand; several candidates give a chain with that leading axis.

    Returns
    -------
    chain : Chain
        Of [p v a], the three axes as columns: (m, 3, 3) or (m, c, 3, 3).
    """
    q = np.asarray(q_moving, dtype=np.float64)

    def for_all(stack: FloatArray) -> FloatArray:
        """A stack (m, 3, 3) that is the same for all candidates."""
        return stack[:, None] if q.ndim else stack

    dt = np.diff(events.t)
    q_t = np.where(moving[1:].reshape(-1, *([1] * q.ndim)), np.maximum(q, Q_STILL), Q_STILL)
    powers = np.array([[5, 4, 3], [4, 3, 2], [3, 2, 1]])
    shares = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
    Q = for_all(shares * dt[:, None, None] ** powers) * q_t[..., None, None]
    is_frame, is_sample = np.isfinite(events.position[:, 0]), np.isfinite(events.acceleration[:, 0])
    acc_weight = np.where(moving, noise.acc_moving, noise.acc_still) ** -2.0
    information, vector = np.zeros((len(events.t), 3, 3)), np.zeros((len(events.t), 3, 3))
    information[is_frame, 0, 0] = noise.sigma_m**-2.0
    vector[is_frame, 0] = events.position[is_frame] / noise.sigma_m**2
    information[is_sample, 2, 2] = acc_weight[is_sample]
    vector[is_sample, 2] = events.acceleration[is_sample] * acc_weight[is_sample, None]
    start = np.zeros((*q.shape, 3, 3))
    start[..., 0, :] = events.position[is_frame][0]
    return Chain(
        F=for_all(constant_acceleration(dt)),
        Q=Q,
        drift=for_all(np.zeros((len(dt), 1, 1))),
        information=for_all(information),
        vector=for_all(vector),
        mean=start,
        covariance=np.diag([noise.sigma_m**2, START_SIGMA[0] ** 2, START_SIGMA[1] ** 2]),
    )
