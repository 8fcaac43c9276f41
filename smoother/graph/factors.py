"""The factors of a window's graph, one at a time (GTSAM): the IMU between nodes, joints, the shoulder.

Preintegration: Forster et al., TRO 2017.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import islice

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, noiseModel
from gtsam.symbol_shorthand import G, S, U, V, X

from ..array_types import FloatArray
from ..body import SEGMENTS
from ..units import GRAVITY
from ..window.problem import ImuIncrements, NoiseModel
from .variables import keys_of

#: Rows of an `ImuFactorWithGravityDirection`, and of a factor on a point.
IMU_ROWS, POINT_ROWS = 9, 3
#: Error of the integration itself, m^2/s: a millimetre in a second, and intervals of some milliseconds do
#: not become so much stiffer than the rest that the solver calls the rest free.
INTEGRATION_VARIANCE = 1e-6
#: IMU noise goes up in steps of this factor, so that intervals share their parameters.
DENSITY_STEP = 1.25
#: A shared joint on the parent's side, m: the strap sits firmer at the wrist, its lever arm is a variable.
PARENT_TIE_M = 0.005
#: How long a movement of the tissue lasts, s.
TISSUE_S = 1.0


def imu_factors(
    segment: str,
    between: Iterable[tuple[int, int, int]],  # Numbers of each interval's nodes and of its bias
    increments: ImuIncrements,
    dt: FloatArray,  # (n - 1,) s
    noise: NoiseModel,
) -> Iterator[gtsam.ImuFactorWithGravityDirection]:
    """An IMU between nodes."""
    keys, bias = keys_of(segment), gtsam.imuBias.ConstantBias(*np.split(increments.bias, 2))
    samples = zip(
        *np.moveaxis(increments.acc + increments.bias[:3], 1, 0),
        increments.gyro + increments.bias[3:],
        increments.h.tolist(),
        strict=True,
    )
    counts, levels = np.diff(increments.first).tolist(), noise_levels(increments, dt, noise)
    for (before, node, number), count, level in zip(between, counts, levels, strict=True):
        pim = gtsam.PreintegratedImuMeasurements(preintegration_parameters(noise, *level), bias)
        integrate = pim.integrateMeasurement
        for first_half, second_half, rate, h in islice(samples, count):
            integrate(first_half, rate, h)
            integrate(second_half, rate, h)
        states = keys.pose + before, keys.velocity + before, keys.pose + node, keys.velocity + node
        yield gtsam.ImuFactorWithGravityDirection(*states, keys.bias + number, G(0), pim, GRAVITY)


def noise_levels(increments: ImuIncrements, dt: FloatArray, noise: NoiseModel) -> list[tuple[int, int]]:
    """Noise of each interval above the still sensor's, (accelerometer, gyroscope) in `DENSITY_STEP`s."""
    count = np.diff(increments.first)
    force = np.linalg.norm(increments.acc.mean(axis=1), axis=1) - GRAVITY
    rate = np.linalg.norm(increments.gyro, axis=1)
    moving = np.add.reduceat(np.abs(force), increments.first[:-1]) / count
    turning = np.add.reduceat(rate, increments.first[:-1]) / count
    impacts = increments.velocity_error / np.sqrt(dt)
    acc = np.hypot(
        np.hypot(1.0, noise.accelerometer_share / noise.accelerometer_density * moving),
        impacts / noise.accelerometer_density,
    )
    gyro = np.hypot(1.0, noise.gyroscope_share / noise.gyroscope_density * turning)
    if increments.turn_error is not None:
        gyro = np.hypot(gyro, increments.turn_error / np.sqrt(dt) / noise.gyroscope_density)
    level = np.round(np.log(np.stack([acc, gyro], axis=1)) / np.log(DENSITY_STEP)).astype(int)
    return [(int(a), int(g)) for a, g in level]


@lru_cache(maxsize=1024)
def preintegration_parameters(noise: NoiseModel, acc: int, gyro: int) -> gtsam.PreintegrationParams:
    """Noise of the preintegration at a level of `noise_levels`."""
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, -GRAVITY]))
    params.setAccelerometerCovariance(np.eye(3) * (DENSITY_STEP**acc * noise.accelerometer_density) ** 2)
    params.setGyroscopeCovariance(np.eye(3) * (DENSITY_STEP**gyro * noise.gyroscope_density) ** 2)
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_VARIANCE)
    return params


def bias_walk(before: int, bias: int, model: noiseModel.Base) -> gtsam.BetweenFactorConstantBias:
    """A bias variable near the one before it."""
    return gtsam.BetweenFactorConstantBias(before, bias, gtsam.imuBias.ConstantBias(), model)


def joint_factor(
    pose: int, lever: int | None, position: FloatArray, model: noiseModel.Base
) -> gtsam.NonlinearFactor:
    """A joint where the camera sees it: at a lever arm that is a variable, or at the IMU itself."""
    if lever is None:
        return gtsam.GPSFactorArm(pose, position, np.zeros(3), model)
    return gtsam.GPSFactorArmCalib(pose, lever, position, model)


def knot_walk(before: int, knot: int, walk: float, root_s: float) -> gtsam.BetweenFactorPoint3:
    """A shoulder knot near the one before it; the time between them as its root, sqrt(s)."""
    model = isotropic(3, round(walk * root_s, 6))
    return gtsam.BetweenFactorPoint3(S(before), S(knot), np.zeros(3), model)


def length_factor(
    node: int, knot: int, length_m: float, sigma_m: float, elbow: FloatArray
) -> gtsam.RangeFactorWithTransformBias3D:
    """The upper arm's length from a shoulder knot to a node's elbow (3,) in {A}; U is its correction."""
    model, at_elbow = isotropic(1, sigma_m), Pose3(Rot3(), elbow)
    return gtsam.RangeFactorWithTransformBias3D(X(node), S(knot), U(0), length_m, model, at_elbow)


def constant_velocity(node: int, change: float) -> gtsam.BetweenFactorVector:
    """The forearm's velocity changes by no more than about `change`, m/s, to the next node."""
    return gtsam.BetweenFactorVector(V(node), V(node + 1), np.zeros(3), isotropic(3, change))


def tissue_sigma(noise: NoiseModel, segment: str, step_s: FloatArray | float) -> FloatArray:
    """Sigma of a joint in an IMU's axes, m, at nodes this far apart: tissue moves slowly, and denser samples
    add nothing.
    """
    return np.round(dict(noise.tissue_m)[segment] * np.sqrt(np.maximum(TISSUE_S / step_s, 1.0)), 3)


def shared_joint(segment: str, node: int, sigma_m: float) -> list[gtsam.ReferenceFrameFactorPoint3Pose3]:
    """One point on a segment and on its parent, at their lever arms."""
    own, parent, joint = keys_of(segment), keys_of(SEGMENTS[segment].parent), SEGMENTS[segment].shared_joint
    return [
        gtsam.ReferenceFrameFactorPoint3Pose3(
            keys.lever_of(joint), keys.pose + node, own.point + node, isotropic(3, sigma)
        )
        for keys, sigma in ((parent, PARENT_TIE_M), (own, sigma_m))
    ]


def shoulder_end(segment: str, node: int, knot: int, sigma_m: float) -> gtsam.ReferenceFrameFactorPoint3Pose3:
    """A segment that reaches the shoulder ends in a knot."""
    ends = keys_of(segment).lever_of("shoulder"), keys_of(segment).pose + node, S(knot)
    return gtsam.ReferenceFrameFactorPoint3Pose3(*ends, isotropic(3, sigma_m))


@lru_cache(maxsize=4096)
def isotropic(dimension: int, sigma: float) -> noiseModel.Isotropic:
    """One noise object for each sigma, however many factors use it."""
    return noiseModel.Isotropic.Sigma(dimension, sigma)


def robust_across(root_information: FloatArray, cauchy: float) -> noiseModel.Robust:
    """Cauchy's loss on a point of a camera without depth, whose square root of information is (3, 3)."""
    loss = noiseModel.mEstimator.Cauchy.Create(cauchy)
    return noiseModel.Robust.Create(loss, noiseModel.Gaussian.SqrtInformation(root_information))


@lru_cache(maxsize=4096)
def robust(sigma_m: float, cauchy: float) -> noiseModel.Robust:
    """Cauchy's loss on a point of the camera: what is far off pulls less the farther it is."""
    return noiseModel.Robust.Create(noiseModel.mEstimator.Cauchy.Create(cauchy), isotropic(3, sigma_m))
