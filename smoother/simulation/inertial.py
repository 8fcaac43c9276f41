"""What an IMU on a moving body measures: exact averages over each sample, then the sensor's errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..recording import ImuStream
from .config import SensorErrors
from .motion import MotionModel

#: At least this many points a second lie under every sample's average.
FINE_RATE_HZ = 1000.0
#: Samples worked on at a time, so that an hour fits in memory.
_CHUNK = 4000


def ideal_imu(motion: MotionModel, duration_s: float, rate_hz: float, gravity: FloatArray) -> ImuStream:
    """Error-free samples: the mean over each sample's interval, stamped at its centre.

    Angular velocity and acceleration come from five-point differences of the smooth motion at 1 kHz or more,
    their mean from Simpson's rule; both are good to a millionth.

    Parameters
    ----------
    motion : MotionModel
        The body.
    duration_s : float, s
        Samples fill 0 to `duration_s`.
    rate_hz : float, Hz
        Samples a second.
    gravity : ndarray, shape (3,), m/s^2
        In {K}.

    Returns
    -------
    imu : ImuStream
    """
    count = int(np.floor(duration_s * rate_hz))
    parts = [
        _averages(motion, begin, min(_CHUNK, count - begin), rate_hz, gravity)
        for begin in range(0, count, _CHUNK)
    ]
    acc, gyro = (np.concatenate(part) for part in zip(*parts, strict=True))
    return ImuStream("simulated", (np.arange(count, dtype=np.float64) + 0.5) / rate_hz, acc, gyro)


def _averages(
    motion: MotionModel, begin: int, count: int, rate_hz: float, gravity: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean specific force and angular velocity (count, 3) in {A} of samples from number `begin` on."""
    fine = 2 * int(np.ceil(FINE_RATE_HZ / rate_hz / 2))  # even, for Simpson's rule
    h = 1.0 / (rate_hz * fine)
    t_s = begin / rate_hz + h * np.arange(-2, count * fine + 3, dtype=np.float64)
    R, p = motion.imu_pose(t_s)
    acceleration = (-p[:-4] + 16 * p[1:-3] - 30 * p[2:-2] + 16 * p[3:-1] - p[4:]) / (12 * h * h)
    R_dot = (R[:-4] - 8 * R[1:-3] + 8 * R[3:-1] - R[4:]) / (12 * h)
    R_A_K = np.swapaxes(R[2:-2], 1, 2)
    spin = R_A_K @ R_dot
    rate = 0.5 * np.stack(
        [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], axis=1
    )
    force = np.einsum("nij,nj->ni", R_A_K, acceleration - gravity)
    weights = np.ones(fine + 1)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    weights /= weights.sum()
    means = [
        sum(w * values[k : k + count * fine : fine] for k, w in enumerate(weights))
        for values in (force, rate)
    ]
    return np.asarray(means[0]), np.asarray(means[1])


def _sensor(
    sensor: str, true: FloatArray, errors: SensorErrors, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One triaxial sensor: its samples (N, 3), its bias (N, 3) and its matrix (3, 3) of scale and axes."""
    density, bias, walk, limit = (
        getattr(errors, f"{sensor}_{error}") for error in ("noise", "bias", "walk", "range")
    )
    rate_hz = errors.imu_rate_hz
    matrix = np.eye(3) + np.diag(errors.imu_scale * rng.normal(size=3))
    cross = np.radians(errors.imu_misalignment_deg) * rng.normal(size=(3, 3))
    matrix += cross - np.diag(np.diag(cross))
    steps = walk / np.sqrt(rate_hz) * rng.normal(size=true.shape)
    drift = bias * rng.normal(size=3) + np.cumsum(steps, axis=0)
    noise = density * np.sqrt(rate_hz) * rng.normal(size=true.shape)
    measured = true @ matrix.T + drift + noise
    if limit is not None:
        measured = np.clip(measured, -limit, limit)
    return measured, drift, matrix


def measure(
    ideal: ImuStream, errors: SensorErrors, rng: np.random.Generator
) -> tuple[ImuStream, dict[str, Any]]:
    """The samples with the sensor's errors.

    The model is measured = matrix @ true + bias + noise, then saturation. A noise density d gives samples a
    standard deviation of d * sqrt(rate).

    Parameters
    ----------
    ideal : ImuStream
        Samples without errors.
    errors : SensorErrors
        How large the errors are.
    rng : Generator
        Of the draws.

    Returns
    -------
    imu : ImuStream
    parameters : dict
        What was drawn, by name: biases, their means (3,) and their course `..._bias_t` (N, 3), and matrices
        (3, 3), SI units.
    """
    samples, parameters = {}, {}
    for sensor, true in (("accelerometer", ideal.acc), ("gyroscope", ideal.gyro)):
        samples[sensor], bias, matrix = _sensor(sensor, true, errors, rng)
        parameters[f"{sensor}_bias"] = bias.mean(axis=0)
        parameters[f"{sensor}_bias_t"] = bias
        parameters[f"{sensor}_matrix"] = matrix
    imu = ImuStream(ideal.name, ideal.t_s, samples["accelerometer"], samples["gyroscope"])
    return imu, parameters
