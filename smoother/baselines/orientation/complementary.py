"""Complementary filter on roll, pitch and heading (Feng, thesis, Glasgow 2014, eq 3.10 and 3.13-3.19).

The class of that name in `ahrs` is another algorithm: it uses body rates as the angles' rates and leaves
the heading at zero without a magnetometer. Feng's text leaves open what rates are meant; here the
gyroscope turns the attitude exactly, and the angles are blended after that. It has a compass; where there is
none, the blend turns about the level alone, so that the heading is the gyroscope's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...linalg import unit
from .samples import EvenSamples, start_attitude

#: Part of the gyroscope in a blend, at the rate it was published for, Hz (eq 3.16).
ALPHA, RATE_HZ = 0.98, 90.0
#: Keeps roll from turning wild near a vertical x axis (eq 3.14).
MU = 0.01

Angles = tuple[float, float, float]


def complementary(samples: EvenSamples) -> FloatArray:
    """Quaternions (n, 4; qw, qx, qy, qz) of `R_E_A` = Rz(heading) Ry(pitch) Rx(roll), z of {E} up.

    The angles are singular where the sensor's x axis is vertical. Which axis of a sensor is called x is
    free, so it is the one that keeps farthest from the vertical in this recording.
    """
    R_B_A = level_axes(samples)
    acc, gyro = R_B_A.apply(samples.acc), R_B_A.apply(samples.gyro)
    mag = None if samples.mag is None else R_B_A.apply(samples.mag)
    roll_acc, pitch_acc = tilt(acc)
    # the published weights belong to the published rate: the same time constant at another
    alpha = ALPHA ** (samples.step_s * RATE_HZ)
    here = start_attitude(samples) * R_B_A.inv()
    roll, pitch, heading = angles_of(here.as_matrix())
    angles = np.empty((len(samples), 3))
    angles[0] = roll, pitch, heading
    turns = Rotation.from_rotvec(gyro * samples.step_s).as_matrix()
    for k in range(1, len(samples)):
        propagated = matrix_of(roll, pitch, heading) @ turns[k]
        roll, pitch, heading = angles_of(propagated)
        roll += (1.0 - alpha) * wrapped(roll_acc[k] - roll)
        pitch += (1.0 - alpha) * wrapped(pitch_acc[k] - pitch)
        if mag is not None and mag[k, 0] == mag[k, 0]:
            heading += (1.0 - alpha) * wrapped(compass(mag[k], roll, pitch) - heading)
        else:
            heading = same_heading(propagated, roll, pitch)
        angles[k] = roll, pitch, heading
    R_E_B = Rotation.from_euler("ZYX", angles[:, ::-1])
    return np.asarray((R_E_B * R_B_A).as_quat(scalar_first=True))


def level_axes(samples: EvenSamples) -> Rotation:
    """`R_B_A`: axes whose x keeps farthest from the vertical, by the force's direction over time."""
    up = unit(samples.acc)
    count = np.arange(200) + 0.5
    polar, around = np.arccos(1.0 - count / 200.0), np.pi * (1.0 + np.sqrt(5.0)) * count
    candidates = np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=1
    )  # evenly over half of the sphere
    nearest = np.quantile(np.abs(up @ candidates.T), 0.99, axis=0)
    x = candidates[int(np.argmin(nearest))]
    z = unit(np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))]))
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z]))


def tilt(acc: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch (n,) rad from the force (n, 3) alone (eq 3.14 and 3.15)."""
    x, y, z = acc.T
    side = np.where(z < 0, -1.0, 1.0)
    # the angle's quadrant: tan of 3.14 with the signs of its numerator and denominator
    roll = np.arctan2(y, side * np.sqrt(MU * x**2 + z**2))
    return roll, np.arctan2(-x, np.hypot(y, z))


def compass(mag: FloatArray, roll: float, pitch: float) -> float:
    """Heading from the magnetic field (eq 3.17), rad."""
    across = mag[2] * math.sin(roll) - mag[1] * math.cos(roll)
    level = mag[1] * math.sin(roll) + mag[2] * math.cos(roll)
    return math.atan2(across, mag[0] * math.cos(pitch) + level * math.sin(pitch))


def matrix_of(roll: float, pitch: float, heading: float) -> FloatArray:
    """Rz(heading) Ry(pitch) Rx(roll), (3, 3) (eq 3.10)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    ch, sh = math.cos(heading), math.sin(heading)
    return np.array(
        [
            [ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr],
            [sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles_of(R: FloatArray) -> Angles:
    """Roll, pitch and heading of a matrix (3, 3), rad."""
    return (
        math.atan2(R[2, 1], R[2, 2]),
        math.asin(min(max(-R[2, 0], -1.0), 1.0)),
        math.atan2(R[1, 0], R[0, 0]),
    )


def same_heading(R: FloatArray, roll: float, pitch: float) -> float:
    """The heading with which an attitude (3, 3) gets another roll and pitch by turning about the level alone.

    Without a compass nothing would undo what a correction of roll turns about the vertical.
    """
    up = matrix_of(roll, pitch, 0.0)[2]  # of the earth, in the sensor
    x, y, z = R @ up
    # the shortest turn from there to (0, 0, 1), and what it makes of the sensor's first axis
    a, b = R[0, 0], R[1, 0]
    c, along = R[2, 0], (x * a + y * b) / (1.0 + z)
    return math.atan2(b - y * (c + along), a - x * (c + along))


def wrapped(angle: float) -> float:
    """An angle's nearest turn, -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)
