"""A sensor alone, turned by hand: rest poses for the accelerometer, all directions for the magnetometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..array_types import FloatArray
from ..linalg import unit
from ..recording import ImuStream
from ..units import GRAVITY

#: Six sides, twelve edges and eight corners: the poses in order.
_SIDES = np.vstack([np.eye(3), -np.eye(3)])
_EDGES = np.array([v for v in np.ndindex(3, 3, 3) if np.abs(np.array(v) - 1).sum() == 2], float) - 1.0
_CORNERS = np.array(list(np.ndindex(2, 2, 2)), float) * 2.0 - 1.0
REST_POSES = unit(np.vstack([_SIDES, _EDGES[::2], _EDGES[1::2], _CORNERS]))

#: How long a sensor is turned for its magnetometer, s.
TURNING_S = 60.0


@dataclass(frozen=True)
class SensorModel:
    """measured = matrix @ true + offset; the matrix is symmetric, as a calibration cannot see a rotation.

    Attributes
    ----------
    offset : ndarray, shape (3,)
    matrix : ndarray, shape (3, 3)
    """

    offset: FloatArray
    matrix: FloatArray

    @classmethod
    def draw(cls, rng: np.random.Generator, *, offset: float, scale: float, cross: float) -> SensorModel:
        """Errors of the given sizes, their signs and shares at random."""
        matrix = np.eye(3) + np.diag(scale * rng.uniform(-1.0, 1.0, 3))
        off = cross * rng.uniform(-1.0, 1.0, (3, 3))
        matrix += np.triu(off, 1) + np.triu(off, 1).T
        return cls(offset * rng.choice([-1.0, 1.0], 3), matrix)

    def distort(self, true: FloatArray) -> FloatArray:
        """What the sensor reads (N, 3) of true values (N, 3)."""
        return true @ self.matrix.T + self.offset

    def correction(self, unit_of: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Offset (3,) and matrix (3, 3) that a calibration should find: true = matrix @ (read - offset).

        `unit_of` is what the sensor states for a true value of 1.
        """
        return unit_of * self.offset, np.asarray(np.linalg.inv(self.matrix) / unit_of)


def rest_poses(
    model: SensorModel,
    poses: int,
    *,
    seed: int = 0,
    rest_s: float = 2.0,
    turn_s: float = 1.0,
    rate_hz: float = 100.0,
    acc_noise: float = 0.02,
    gyro_noise: float = 0.002,
    gravity: float = GRAVITY,
) -> tuple[ImuStream, FloatArray]:
    """A sensor laid still in one pose after the other, turned by hand between.

    Parameters
    ----------
    model : SensorModel
        The accelerometer's errors.
    poses : int
        How many of `REST_POSES` (26), each some degrees off.
    seed : int
    rest_s, turn_s : float, s
        Rest in a pose, and the turn to the next.
    rate_hz : float, Hz
    acc_noise, gyro_noise : float, m/s^2 and rad/s
        Standard deviation of a sample.
    gravity : float, m/s^2

    Returns
    -------
    imu : ImuStream
    gyroscope_bias : ndarray, shape (3,), rad/s
    """
    rng = np.random.default_rng(seed)
    up = REST_POSES[:poses] + rng.normal(0.0, 0.06, (poses, 3))
    turns = [Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])[0] for axis in up]
    step = rest_s + turn_s
    knots = np.concatenate([[step * k, step * k + rest_s] for k in range(poses)])
    curve = Slerp(knots, Rotation.concatenate([turn for turn in turns for _ in range(2)]))
    t = np.arange(0.5 / rate_hz, knots[-1], 1.0 / rate_hz)
    # a smooth start and end of every turn
    k, within = np.divmod(t, step)
    u = np.clip((within - rest_s) / turn_s, 0.0, 1.0)
    eased = step * k + np.where(within < rest_s, within, rest_s + turn_s * u * u * (3.0 - 2.0 * u))
    R = curve(np.minimum(eased, knots[-1]))
    shake = ((u > 0) & (u < 1))[:, None] * rng.normal(0.0, 1.5, (len(t), 3))
    force = R.inv().apply([0.0, 0.0, gravity]) + shake
    rate = np.zeros((len(t), 3))
    rate[:-1] = (R[:-1].inv() * R[1:]).as_rotvec() * rate_hz
    bias = rng.normal(0.0, 0.01, 3)
    acc = model.distort(force) + rng.normal(0.0, acc_noise, force.shape)
    gyro = rate + bias + rng.normal(0.0, gyro_noise, rate.shape)
    return ImuStream("/imu/forearm_right", t, acc, gyro), bias


def magnetometer_turns(
    model: SensorModel, count: int, *, noise: float = 0.01, seed: int = 0, dip_deg: float = 60.0
) -> FloatArray:
    """Samples (count, 3) of a sensor turned slowly about all its axes in a field of length 1."""
    rng = np.random.default_rng(seed)
    field = np.array([np.cos(np.radians(dip_deg)), 0.0, -np.sin(np.radians(dip_deg))])
    return model.distort(_turning(count, seed).inv().apply(field)) + rng.normal(0.0, noise, (count, 3))


def turning_sensor(
    model: SensorModel, *, seed: int = 0, rate_hz: float = 50.0, field: float = 48.0, noise: float = 0.01
) -> ImuStream:
    """A sensor turned slowly about all its axes for a minute, on one spot.

    Parameters
    ----------
    model : SensorModel
        The magnetometer's errors, in parts of the field.
    seed : int
        Of the turns and of the noise.
    rate_hz : float, Hz
        Samples per second.
    field : float, in the sensor's unit
        Strength of the field (48 microtesla in Central Europe).
    noise : float
        Standard deviation of a sample, in parts of the field.

    Returns
    -------
    imu : ImuStream
        Acceleration and angular velocity belong to the same turns.
    """
    count = round(TURNING_S * rate_hz)
    rng = np.random.default_rng([seed, 1])
    R = _turning(count, seed)
    rate = np.zeros((count, 3))
    rate[:-1] = (R[:-1].inv() * R[1:]).as_rotvec() * rate_hz
    acc: FloatArray = R.inv().apply([0.0, 0.0, GRAVITY]) + rng.normal(0.0, 0.02, (count, 3))
    gyro = rate + rng.normal(0.0, 0.002, (count, 3))
    t = (np.arange(float(count)) + 0.5) / rate_hz
    mag = field * magnetometer_turns(model, count, noise=noise, seed=seed)
    return ImuStream("/imu/forearm_right", t, acc, gyro, mag)


def _turning(count: int, seed: int) -> Rotation:
    """Orientations of a sensor that is turned for a minute, through one at random a second."""
    knots = round(TURNING_S) + 1
    path = Slerp(np.arange(float(knots)), Rotation.random(knots, random_state=seed))
    return path(np.linspace(0.0, TURNING_S, count))


def long_rest(
    model: SensorModel,
    rest_s: float,
    *,
    seed: int = 0,
    rate_hz: float = 100.0,
    acc_density: float = 2e-3,
    gyro_density: float = 2e-4,
) -> tuple[ImuStream, FloatArray]:
    """A sensor at rest, with white noise and a bias that wanders by a twentieth of it in a second.

    Parameters
    ----------
    model : SensorModel
        The accelerometer's errors.
    rest_s : float, s
        How long it rests.
    seed : int
        Of the noise.
    rate_hz : float, Hz
        Samples per second.
    acc_density, gyro_density : float, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz)
        White noise.

    Returns
    -------
    imu : ImuStream
        The samples.
    gyroscope_bias : ndarray, shape (3,), rad/s
        The mean of the bias over the rest.
    """
    rng = np.random.default_rng(seed)
    count = round(rest_s * rate_hz)
    bias = rng.normal(0.0, 0.01, 3)

    def noise(density: float) -> tuple[FloatArray, FloatArray]:
        white = density * np.sqrt(rate_hz) * rng.normal(size=(count, 3))
        return white, np.cumsum(density / 20.0 / np.sqrt(rate_hz) * rng.normal(size=(count, 3)), axis=0)

    up = np.tile(np.array([0.0, 0.0, GRAVITY]), (count, 1))
    acc = model.distort(up) + np.sum(noise(acc_density), axis=0)
    white, walk = noise(gyro_density)
    t = (np.arange(float(count)) + 0.5) / rate_hz
    gyro = np.asarray(bias + walk + white)
    return ImuStream("/imu/forearm_right", t, acc, gyro), np.asarray(bias + walk.mean(axis=0))
