"""Orientation filters for the baselines, by name: `R_E_A` of a sensor in a frame {E} with z up.

The heading of {E} drifts, or starts anywhere; the camera aligns it to its own frame, for all filters alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .. import rotation
from ..array_types import FloatArray
from ..linalg import sphere, unit
from ..measurements.inertial import InertialAttitude, InertialSignal
from ..recording import ImuStream
from ..units import GRAVITY

#: The start's tilt is averaged over this much time, s.
START_S = 4.0
#: A magnetometer is of use where the field's strength keeps this near to its median, as a part of it.
FIELD_SPREAD = 0.1


@dataclass(frozen=True)
class EvenSamples:
    """Samples of a sensor, spread evenly."""

    t: FloatArray  # (n,) s: ends of the samples' intervals; a filter answers there
    step_s: float  # Their distance
    acc: FloatArray  # (n, 3) m/s^2: mean specific force of the interval in {A}
    gyro: FloatArray  # (n, 3) rad/s: mean angular rate of the interval in {A}, its bias taken off
    mag: FloatArray | None = None  # (n, 3): direction of the magnetic field in {A}, nan where it is disturbed

    def __len__(self) -> int:
        return len(self.t)


def even_samples(
    signal: InertialSignal, rate_hz: float, gyroscope_bias: FloatArray, imu: ImuStream
) -> EvenSamples:
    """The signal's means over even intervals."""
    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    return EvenSamples(
        t=edges[1:],
        step_s=float(edges[1] - edges[0]),
        acc=np.ascontiguousarray(mean[:, :3]),
        gyro=np.ascontiguousarray(mean[:, 3:] - gyroscope_bias),
        mag=_field(imu, 0.5 * (edges[1:] + edges[:-1])),
    )


def _field(imu: ImuStream, t: FloatArray) -> FloatArray | None:
    """Direction of the magnetic field at times, nan where its strength is off; None where it mostly is."""
    if imu.mag is None:
        return None
    strength = np.linalg.norm(imu.mag, axis=1)
    usual = float(np.nanmedian(strength)) if np.isfinite(strength).any() else 0.0
    if not usual > 0:
        return None
    with np.errstate(invalid="ignore"):
        undisturbed = np.abs(strength / usual - 1.0) < FIELD_SPREAD
    if undisturbed.mean() < 0.9:
        return None
    field = np.stack([np.interp(t, imu.t_s[undisturbed], imu.mag[undisturbed, k]) for k in range(3)], axis=1)
    nearest = np.clip(np.searchsorted(0.5 * (imu.t_s[1:] + imu.t_s[:-1]), t), 0, len(imu) - 1)
    field[~undisturbed[nearest]] = np.nan
    return unit(field)


def start_attitude(samples: EvenSamples) -> Rotation:
    """`R_E_A` at the end of the first interval: its tilt from the force of the first seconds."""
    count = min(len(samples), max(int(START_S / samples.step_s), 1))
    turns = Rotation.from_rotvec(samples.gyro[1:count] * samples.step_s)
    here = Rotation.identity()
    total = samples.acc[0].copy()
    for k in range(count - 1):
        here = here * turns[k]
        total += here.apply(samples.acc[k + 1])
    return tilted(total)


def tilted(up_A: FloatArray) -> Rotation:
    """The rotation `R_E_A` with the shortest turn that takes a direction (3,) in {A} to z of {E}."""
    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [up_A])[0]


def vqf(samples: EvenSamples) -> FloatArray:
    """VQF (Laidig and Seel, Information Fusion 2023) by its package, forwards and backwards in time, 6D."""
    from vqf import offlineVQF

    answer = offlineVQF(
        np.ascontiguousarray(samples.gyro), np.ascontiguousarray(samples.acc), None, samples.step_s
    )
    return np.asarray(answer["quat6D"], dtype=np.float64)


#: The published gain for gyroscope and accelerometer, rad/s (report of 2010, section 6).
GAIN = 0.033


def madgwick(samples: EvenSamples) -> FloatArray:
    """Madgwick's gradient descent filter (2010), gyroscope and accelerometer, by the package `ahrs`."""
    from ahrs.filters import Madgwick

    start = start_attitude(samples).as_quat(scalar_first=True)
    answer = Madgwick(gyr=samples.gyro, acc=samples.acc, frequency=1.0 / samples.step_s, gain=GAIN, q0=start)
    return np.asarray(answer.Q, dtype=np.float64)


#: Noise of the gyroscope, its errors of scale and mounting included, rad/s/sqrt(Hz).
GYROSCOPE_DENSITY = 0.0015
#: How far the measured force points from gravity where its strength is gravity's, rad.
DIRECTION_SIGMA_RAD = 0.10
#: A force whose strength is farther from gravity's is not an observation, as a part of it.
GATE = 0.2
#: The uncertainty of the start, which is a mean over seconds, rad.
START_SIGMA_RAD = 0.01

# Quaternions as plain numbers: an object of scipy a sample would cost fifty times as much.
Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]


def comotti(samples: EvenSamples) -> FloatArray:
    """A quaternion Kalman filter with an observation in closed form (Comotti 2013; JA II-D, eq 1-2)."""
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
    """The attitude that gravity and field show (eq 1), of the sign nearer to the prediction (eq 2)."""
    w, x, y, z = predicted
    if field is None or field[0] != field[0]:  # x of {E} in {A} as predicted
        field = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    b = _normalised(_cross(up, field))
    a, c = _cross(b, up), up
    # rows of R_E_A: the earth's axes in the sensor. With its quaternion q, 4 q q' is linear in them
    # (Shepperd 1978), and that times the prediction is q of the wanted sign, but for its length
    less = 1.0 - (a[0] + b[1] + c[2])
    dx, dy, dz = c[1] - b[2], a[2] - c[0], b[0] - a[1]
    xy, xz, yz = a[1] + b[0], a[2] + c[0], b[2] + c[1]
    return _normalised(
        (
            (2.0 - less) * w + dx * x + dy * y + dz * z,
            dx * w + (less + 2.0 * a[0]) * x + xy * y + xz * z,
            dy * w + xy * x + (less + 2.0 * b[1]) * y + yz * z,
            dz * w + xz * x + yz * y + (less + 2.0 * c[2]) * z,
        )
    )


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


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _normalised(v: tuple[float, ...]) -> tuple[Any, ...]:
    """A vector or quaternion of length one."""
    length = math.hypot(*v) or 1.0
    return tuple(a / length for a in v)


#: Part of the gyroscope in a blend, at the rate it was published for, Hz (eq 3.16).
ALPHA, RATE_HZ = 0.98, 90.0
#: Keeps roll from turning wild near a vertical x axis (eq 3.14).
MU = 0.01

Angles = tuple[float, float, float]


def complementary(samples: EvenSamples) -> FloatArray:
    """A complementary filter on roll, pitch, heading (Feng, thesis, Glasgow 2014, eq 3.10, 3.13-3.19)."""
    # `ahrs` has another algorithm of that name: body rates as the angles' rates, no heading without a field.
    # What rates Feng means is open: here the gyroscope turns the attitude, then the angles are blended
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
    candidates = sphere(400)[:200]  # half of it
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
    """The heading with which an attitude (3, 3) gets another roll and pitch by turning about the level."""
    up = matrix_of(roll, pitch, 0.0)[2]  # of the earth, in the sensor
    x, y, z = R @ up
    # the shortest turn from there to (0, 0, 1), and what it makes of the sensor's first axis
    a, b = R[0, 0], R[1, 0]
    c, along = R[2, 0], (x * a + y * b) / (1.0 + z)
    return math.atan2(b - y * (c + along), a - x * (c + along))


def wrapped(angle: float) -> float:
    """An angle's nearest turn, -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


#: The filters by name: even samples in, quaternions (n, 4; qw, qx, qy, qz) of `R_E_A` out.
FILTERS: dict[str, Callable[[EvenSamples], FloatArray]] = {
    each.__name__: each for each in (vqf, madgwick, comotti, complementary)
}


def attitude_by(
    name: str, signal: InertialSignal, imu: ImuStream, rate_hz: float, gyroscope_bias: FloatArray
) -> InertialAttitude:
    """Run a filter over a signal."""
    samples = even_samples(signal, rate_hz, gyroscope_bias, imu)
    attitude = rotation.Rotation.from_quat(FILTERS[name](samples), scalar_first=True)
    return InertialAttitude(samples.t, attitude, gyroscope_bias)
