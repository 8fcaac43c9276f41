"""Quaternion Kalman filter with an observation in closed form (Comotti 2013; Jatesiktat and Ang 2017).

JA II-D: the gyroscope predicts the quaternion; gravity's and the magnetic field's directions give all three
axes of the earth in the sensor (eq 1), which as a quaternion of the sign nearer to the prediction (eq 2) is
the observation. Their noise figures are not given; ours are here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...linalg import unit
from ...units import GRAVITY
from .samples import EvenSamples, start_attitude

#: Noise of the gyroscope, its errors of scale and mounting included, rad/s/sqrt(Hz).
GYROSCOPE_DENSITY = 0.0015
#: How far the measured force points from gravity where its strength is gravity's, rad.
DIRECTION_SIGMA_RAD = 0.10
#: A force whose strength is farther from gravity's is no observation, as a part of it.
GATE = 0.2
#: The uncertainty of the start, which is a mean over seconds, rad.
START_SIGMA_RAD = 0.01

# Quaternions as plain numbers: an object of scipy a sample would cost fifty times as much.
Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


def comotti(samples: EvenSamples) -> FloatArray:
    """Quaternions (n, 4; qw, qx, qy, qz) of `R_E_A`, x of {E} to magnetic north where there is a field.

    Prediction q' = exp(w dt / 2) q; observation z with H = I. The transition is a rotation of the
    four-space, and noise is alike on all four components, so the covariance stays p I and the gain is one
    number: with q the gyroscope's, r the observation's variance of a quaternion's component (a quarter of
    the angle's), p' = p + q, k = p' / (p' + r), p = (1 - k) p'. Without a field, or where it is disturbed,
    the prediction's own heading stands for it: then only the tilt is observed.
    """
    q: Quaternion = tuple(start_attitude(samples).as_quat(scalar_first=True))
    quaternion = np.empty((len(samples), 4))
    quaternion[0] = q
    step, p = samples.step_s, 0.25 * START_SIGMA_RAD**2
    drift, r = 0.25 * GYROSCOPE_DENSITY**2 * step, 0.25 * DIRECTION_SIGMA_RAD**2
    force = np.linalg.norm(samples.acc, axis=1)
    up = unit(samples.acc).tolist()
    near_gravity = (np.abs(force / GRAVITY - 1.0) < GATE).tolist()
    turns = Rotation.from_rotvec(samples.gyro * step).as_quat(scalar_first=True).tolist()
    fields = None if samples.mag is None else samples.mag.tolist()
    for k in range(1, len(samples)):
        q, p = product(q, turns[k]), p + drift
        if near_gravity[k]:
            z = observed(q, up[k], None if fields is None else fields[k])
            gain = p / (p + r)
            q, p = _normalised(tuple(a + gain * (b - a) for a, b in zip(q, z, strict=True))), (1.0 - gain) * p
        quaternion[k] = q
    return quaternion


def observed(predicted: Quaternion, up: Vector, field: Vector | None) -> Quaternion:
    """The attitude that gravity and field show (eq 1), of the sign nearer to the prediction (eq 2).

    Parameters
    ----------
    predicted : Quaternion
        qw, qx, qy, qz of `R_E_A`.
    up : Vector
        Unit vector of the force in {A}.
    field : Vector or None
        The magnetic field in {A}; the prediction's x of {E} where None or not a number.

    Returns
    -------
    quaternion : Quaternion
        qw, qx, qy, qz of `R_E_A`.
    """
    if field is None or field[0] != field[0]:
        field = _north(predicted)
    west = _normalised(_cross(up, field))
    north = _cross(west, up)
    # rows of R_E_A: the earth's axes in the sensor
    z = quaternion_of(north, west, up)
    return z if sum(a * b for a, b in zip(z, predicted, strict=True)) >= 0 else (-z[0], -z[1], -z[2], -z[3])


def quaternion_of(x: Vector, y: Vector, z: Vector) -> Quaternion:
    """Quaternion of the matrix with these rows, from its largest component (van Waveren 2005)."""
    trace = x[0] + y[1] + z[2]
    if trace > 0:
        s = 2.0 * math.sqrt(1.0 + trace)
        return 0.25 * s, (z[1] - y[2]) / s, (x[2] - z[0]) / s, (y[0] - x[1]) / s
    if x[0] >= y[1] and x[0] >= z[2]:
        s = 2.0 * math.sqrt(1.0 + x[0] - y[1] - z[2])
        return (z[1] - y[2]) / s, 0.25 * s, (x[1] + y[0]) / s, (x[2] + z[0]) / s
    if y[1] >= z[2]:
        s = 2.0 * math.sqrt(1.0 + y[1] - x[0] - z[2])
        return (x[2] - z[0]) / s, (x[1] + y[0]) / s, 0.25 * s, (y[2] + z[1]) / s
    s = 2.0 * math.sqrt(1.0 + z[2] - x[0] - y[1])
    return (y[0] - x[1]) / s, (x[2] + z[0]) / s, (y[2] + z[1]) / s, 0.25 * s


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Product of two quaternions qw, qx, qy, qz: first b, then a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _north(q: Quaternion) -> Vector:
    """X of {E} in {A}: the first row of `R_E_A`."""
    w, x, y, z = q
    return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _normalised(v: tuple[float, ...]) -> tuple[Any, ...]:
    """A vector or quaternion of length one."""
    length = math.hypot(*v) or 1.0
    return tuple(a / length for a in v)
