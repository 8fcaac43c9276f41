"""Orientation filters for the baselines, by name: `R_E_A` of a sensor in a frame {E} with z up.

The heading of {E} drifts, or starts anywhere; the camera aligns it to its own frame, for all filters alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from .. import rotation
from ..array_types import FloatArray
from ..linalg import nearest, skew, sphere, unit
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

    def field(self, k: int) -> FloatArray | None:
        """The magnetic field at a sample; None where it is of no use."""
        return None if self.mag is None or np.isnan(self.mag[k, 0]) else self.mag[k]


def even_samples(
    signal: InertialSignal, rate_hz: float, gyroscope_bias: FloatArray, imu: ImuStream
) -> EvenSamples:
    """The signal's means over even intervals."""
    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    acc, gyro = np.ascontiguousarray(mean[:, :3]), np.ascontiguousarray(mean[:, 3:] - gyroscope_bias)
    field = _field(imu, 0.5 * (edges[1:] + edges[:-1]))
    return EvenSamples(edges[1:], float(edges[1] - edges[0]), acc, gyro, field)


def _field(imu: ImuStream, t: FloatArray) -> FloatArray | None:
    """Direction of the magnetic field at times, nan where its strength is off; None where it mostly is."""
    if imu.mag is None or not np.isfinite(imu.mag).all(axis=1).any():
        return None
    strength = np.linalg.norm(imu.mag, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        undisturbed = np.abs(strength / np.nanmedian(strength) - 1.0) < FIELD_SPREAD
    if undisturbed.mean() < 0.9:
        return None
    field = np.stack([np.interp(t, imu.t_s[undisturbed], imu.mag[undisturbed, k]) for k in range(3)], axis=1)
    field[~undisturbed[nearest(imu.t_s, t)]] = np.nan
    return unit(field)


def start_attitude(samples: EvenSamples) -> Rotation:
    """`R_E_A` at the end of the first interval: its tilt from the force of the first seconds."""
    count = min(len(samples), max(int(START_S / samples.step_s), 1))
    turns = rotation.Rotation.from_rotvec(samples.gyro[1:count] * samples.step_s)
    return level_turn((rotation.chained(turns.as_matrix()) @ samples.acc[:count, :, None]).sum(axis=0)[:, 0])


def level_turn(up: FloatArray) -> Rotation:
    """The shortest turn that takes a direction (3,) to z."""
    x, y, z = up
    across = np.hypot(x, y)
    axis = np.array([y, -x, 0.0]) / across if across else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(np.arctan2(across, z) * axis)


def vqf(samples: EvenSamples) -> FloatArray:
    """VQF (Laidig and Seel, Information Fusion 2023) by its package, forwards and backwards in time, 6D."""
    from vqf import offlineVQF

    answer = offlineVQF(samples.gyro, samples.acc, None, samples.step_s)
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


def comotti(samples: EvenSamples) -> FloatArray:
    """A quaternion Kalman filter with an observation in closed form (Comotti 2013; JA II-D, eq 1-2)."""
    here, step, p = start_attitude(samples), samples.step_s, 0.25 * START_SIGMA_RAD**2
    drift, r = 0.25 * GYROSCOPE_DENSITY**2 * step, 0.25 * DIRECTION_SIGMA_RAD**2
    near_gravity = np.abs(np.linalg.norm(samples.acc, axis=1) / GRAVITY - 1.0) < GATE
    up, turns = unit(samples.acc), Rotation.from_rotvec(samples.gyro * step)
    across = skew(up)
    quaternion = np.empty((len(samples), 4))
    quaternion[0] = here.as_quat(scalar_first=True)
    for k in range(1, len(samples)):
        here, p = here * turns[k], p + drift
        if near_gravity[k]:
            field = samples.field(k)
            # without a field, x of {E} in {A} as predicted; then the earth's axes in the sensor (eq 1)
            y = across[k] @ (here.as_matrix()[0] if field is None else field)
            seen = Rotation.from_matrix(unit(np.stack([-across[k] @ y, y, up[k]]))).as_quat()
            predicted, gain = here.as_quat(), p / (p + r)
            seen = seen if seen @ predicted > 0 else -seen  # eq 2
            here, p = Rotation.from_quat(predicted + gain * (seen - predicted)), (1.0 - gain) * p
        quaternion[k] = here.as_quat(scalar_first=True)
    return quaternion


#: Part of the gyroscope in a blend, at the rate it was published for, Hz (eq 3.16).
ALPHA, RATE_HZ = 0.98, 90.0
#: Keeps roll from turning wild near a vertical x axis (eq 3.14).
MU = 0.01


def complementary(samples: EvenSamples) -> FloatArray:
    """A complementary filter on roll, pitch, heading (Feng, thesis, Glasgow 2014, eq 3.10, 3.13-3.19)."""
    # `ahrs` has another algorithm of that name: body rates as the angles' rates, no heading without a field.
    # What rates Feng means is open: here the gyroscope turns the attitude, then the angles are blended
    R_B_A = level_axes(samples)
    x, y, z = R_B_A.apply(samples.acc).T
    # roll and pitch by the force (3.14, 3.15), the quadrant by the signs of numerator and denominator
    seen_roll = np.arctan2(y, np.where(z < 0, -1.0, 1.0) * np.sqrt(MU * x**2 + z**2))
    seen_pitch = np.arctan2(-x, np.hypot(y, z))
    # the published weights belong to the published rate: the same time constant at another
    share = 1.0 - ALPHA ** (samples.step_s * RATE_HZ)
    turns = Rotation.from_rotvec(R_B_A.apply(samples.gyro) * samples.step_s)
    here = start_attitude(samples) * R_B_A.inv()
    attitude = np.empty((len(samples), 4))
    attitude[0] = here.as_quat()
    for k in range(1, len(samples)):
        here = here * turns[k]
        heading, pitch, roll = here.as_euler("ZYX")
        roll += share * _wrapped(seen_roll[k] - roll)
        pitch += share * _wrapped(seen_pitch[k] - pitch)
        level, field = Rotation.from_euler("YX", [pitch, roll]), samples.field(k)
        if field is None:  # the shortest turn to the blended vertical
            here = level_turn(here.apply(level.as_matrix()[2])) * here
        else:
            north, west, _ = level.apply(R_B_A.apply(field))
            heading += share * _wrapped(np.arctan2(-west, north) - heading)  # 3.17
            here = Rotation.from_rotvec([0.0, 0.0, heading]) * level
        attitude[k] = here.as_quat()
    return np.asarray((Rotation.from_quat(attitude) * R_B_A).as_quat(scalar_first=True))


def _wrapped(angle: float) -> float:
    """An angle's nearest turn, -pi to pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def level_axes(samples: EvenSamples) -> Rotation:
    """`R_B_A`: axes whose x keeps farthest from the vertical, by the force's direction over time."""
    candidates = sphere(400)[:200]  # half of it
    nearest_up = np.quantile(np.abs(unit(samples.acc) @ candidates.T), 0.99, axis=0)
    x = candidates[int(np.argmin(nearest_up))]
    z = unit(np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))]))
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z]))


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
