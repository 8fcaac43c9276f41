"""The preintegrated IMU between the nodes of a window. Preintegration: Forster et al., TRO 2017."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import islice

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, V, X

from ..array_types import FloatArray, IntArray
from ..window.problem import ImuIncrements, NoiseModel, Window

#: Error of the integration itself, m^2/s: a millimetre in a second, and intervals of some milliseconds do
#: not become so much stiffer than the rest that the solver calls the rest free.
INTEGRATION_VARIANCE = 1e-6
#: IMU noise goes up in steps of this factor, so that intervals share their parameters.
DENSITY_STEP = 1.25


def add_increments(
    graph: gtsam.NonlinearFactorGraph,
    window: Window,
    biases: IntArray,
    symbols: tuple[Callable[[int], int], ...] = (X, V, B),
    first_node: int = 0,
) -> None:
    """`ImuFactorWithGravityDirection` between neighbours.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    window : Window
        Its increments, times and noise.
    biases : ndarray of int, shape (n - 1,)
        Which bias variable each of the intervals uses.
    symbols : tuple of callable
        Letters of pose, velocity and bias.
    first_node : int
        Number of the window's first node.
    """
    pose, velocity, bias_of = (symbol(0) for symbol in symbols)  # keys of a letter follow each other
    increments = window.increments
    bias = gtsam.imuBias.ConstantBias(increments.bias[:3], increments.bias[3:])
    samples = zip(
        *np.moveaxis(increments.acc + increments.bias[:3], 1, 0),
        increments.gyro + increments.bias[3:],
        increments.h.tolist(),
        strict=True,
    )
    counts = np.diff(increments.first).tolist()
    levels = noise_levels(increments, np.diff(window.t), window.noise, window.gravity_magnitude)
    params = {
        level: preintegration_parameters(window.noise, window.gravity_magnitude, *level)
        for level in set(levels)
    }
    for i, (count, level, own_bias) in enumerate(zip(counts, levels, biases.tolist(), strict=True)):
        pim = gtsam.PreintegratedImuMeasurements(params[level], bias)
        integrate = pim.integrateMeasurement
        for first_half, second_half, rate, h in islice(samples, count):
            integrate(first_half, rate, h)
            integrate(second_half, rate, h)
        a, b = first_node + i, first_node + i + 1
        graph.add(
            gtsam.ImuFactorWithGravityDirection(
                pose + a,
                velocity + a,
                pose + b,
                velocity + b,
                bias_of + own_bias,
                G(0),
                pim,
                window.gravity_magnitude,
            )
        )


def noise_levels(
    increments: ImuIncrements, dt: FloatArray, noise: NoiseModel, gravity_magnitude: float
) -> list[tuple[int, int]]:
    """Noise of each interval above the still sensor's, (accelerometer, gyroscope) in `DENSITY_STEP`s.

    Parameters
    ----------
    increments : ImuIncrements
        Of n - 1 intervals.
    dt : ndarray, shape (n - 1,), s
        Their lengths.
    noise : NoiseModel
    gravity_magnitude : float, m/s^2

    Returns
    -------
    levels : list of tuple of int
        One an interval, for `preintegration_parameters`.
    """
    count = np.diff(increments.first)
    force = np.linalg.norm(increments.acc.mean(axis=1), axis=1) - gravity_magnitude
    rate = np.linalg.norm(increments.gyro, axis=1)
    moving = np.add.reduceat(np.abs(force), increments.first[:-1]) / count
    turning = np.add.reduceat(rate, increments.first[:-1]) / count
    impacts = increments.velocity_error / np.sqrt(dt)
    acc = np.hypot(
        np.hypot(1.0, noise.accelerometer_share / noise.accelerometer_density * moving),
        impacts / noise.accelerometer_density,
    )
    gyro = np.hypot(1.0, noise.gyroscope_share / noise.gyroscope_density * turning)
    level = np.round(np.log(np.stack([acc, gyro], axis=1)) / np.log(DENSITY_STEP)).astype(int)
    return [(int(a), int(g)) for a, g in level]


@lru_cache(maxsize=1024)
def preintegration_parameters(
    noise: NoiseModel, gravity_magnitude: float, acc: int, gyro: int
) -> gtsam.PreintegrationParams:
    """Noise of the preintegration at a level of `noise_levels`."""
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, -gravity_magnitude]))
    params.setAccelerometerCovariance(np.eye(3) * (DENSITY_STEP**acc * noise.accelerometer_density) ** 2)
    params.setGyroscopeCovariance(np.eye(3) * (DENSITY_STEP**gyro * noise.gyroscope_density) ** 2)
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_VARIANCE)
    return params
