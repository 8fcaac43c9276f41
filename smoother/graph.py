"""The factor graph of one window (GTSAM), in the camera's frame with gravity's direction unknown.

Variables: X pose `T_K_A` and V velocity a node, B bias every few seconds, G gravity's direction,
L lever arms of the joints in {A}, S shoulder knots, U correction of the upper-arm length.
All factors are GTSAM's own; see each function for the class.
"""

from __future__ import annotations

from functools import lru_cache

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from .recording import FloatArray, IntArray
from .window import Gaussian, Window

#: A bias variable for about so long, s: one for a recording is too stiff to follow scale errors.
BIAS_SPAN_S = 4.0
#: Accelerometer noise goes up in steps of this factor, so that intervals share their parameters.
DENSITY_STEP = 1.25


def bias_of_intervals(window: Window) -> IntArray:
    """Which bias variable each interval uses, (n - 1,)."""
    duration = window.t[-1] - window.t[0]
    count = max(1, round(duration / BIAS_SPAN_S))
    middle = 0.5 * (window.t[1:] + window.t[:-1]) - window.t[0]
    return np.minimum((middle / duration * count).astype(int), count - 1)


def build(window: Window) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph of a window and its start values."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    biases = bias_of_intervals(window)
    _add_states(values, window)
    _add_inertia(graph, window, biases)
    _add_bias(graph, values, window, biases)
    _add_gravity(graph, values, window)
    _add_joints(graph, values, window)
    if window.shoulder is not None:
        _add_shoulder(graph, values, window)
    _add_attitude(graph, window)
    return graph, values


def _add_states(values: gtsam.Values, window: Window) -> None:
    states = window.start
    for i in range(len(window.t)):
        values.insert(X(i), Pose3(Rot3(states.R[i]), states.p[i]))
        values.insert(V(i), states.v[i])


def _add_inertia(graph: gtsam.NonlinearFactorGraph, window: Window, biases: IntArray) -> None:
    """`ImuFactorWithGravityDirection` between neighbours."""
    inertia, noise = window.inertia, window.noise
    removed = gtsam.imuBias.ConstantBias(inertia.bias[:3], inertia.bias[3:])
    acc = inertia.acc + inertia.bias[:3]
    gyro = inertia.gyro + inertia.bias[3:]
    first = inertia.first
    density = np.hypot(noise.accelerometer_density, inertia.velocity_error / np.sqrt(np.diff(window.t)))
    level = np.round(np.log(density / noise.accelerometer_density) / np.log(DENSITY_STEP)).astype(int)
    params = {step: _parameters(window, DENSITY_STEP**step) for step in np.unique(level).tolist()}
    for i in range(len(window.t) - 1):
        pim = gtsam.PreintegratedImuMeasurements(params[int(level[i])], removed)
        for block in range(first[i], first[i + 1]):
            pim.integrateMeasurement(acc[block, 0], gyro[block], inertia.h[block])
            pim.integrateMeasurement(acc[block, 1], gyro[block], inertia.h[block])
        graph.add(
            gtsam.ImuFactorWithGravityDirection(
                X(i), V(i), X(i + 1), V(i + 1), B(biases[i]), G(0), pim, window.gravity_magnitude
            )
        )


def _parameters(window: Window, factor: float) -> gtsam.PreintegrationParams:
    """Noise of the preintegration, the accelerometer's density times a factor."""
    noise = window.noise
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, -window.gravity_magnitude]))
    params.setAccelerometerCovariance(np.eye(3) * (factor * noise.accelerometer_density) ** 2)
    params.setGyroscopeCovariance(np.eye(3) * noise.gyroscope_density**2)
    params.setIntegrationCovariance(np.eye(3) * 1e-8)
    return params


def _add_bias(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window, biases: IntArray
) -> None:
    """`PriorFactorConstantBias` in the middle, `BetweenFactorConstantBias` as a random walk."""
    prior, count = window.priors.bias, int(biases[-1]) + 1
    mean = gtsam.imuBias.ConstantBias(prior.mean[:3], prior.mean[3:])
    for k in range(count):
        values.insert(B(k), mean)
    graph.add(gtsam.PriorFactorConstantBias(B(count // 2), mean, gaussian(prior.covariance)))
    step = np.sqrt((window.t[-1] - window.t[0]) / count)
    walk = noiseModel.Diagonal.Sigmas(window.priors.bias_walk * step)
    for k in range(count - 1):
        graph.add(gtsam.BetweenFactorConstantBias(B(k), B(k + 1), gtsam.imuBias.ConstantBias(), walk))


def _add_gravity(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> None:
    """`PriorFactorUnit3`."""
    prior = window.priors.gravity
    down = Unit3(prior.mean)
    basis = down.basis()
    values.insert(G(0), down)
    graph.add(gtsam.PriorFactorUnit3(G(0), down, gaussian(basis.T @ prior.covariance @ basis)))


def _add_joints(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> None:
    """`GPSFactorArmCalib` (lever arm a variable with a prior) or `GPSFactorArm` at the IMU itself."""
    for number, sight in enumerate(window.sights):
        lever = window.priors.levers.get(sight.joint)
        if lever is not None:
            values.insert(L(number), lever.mean)
            graph.add(gtsam.PriorFactorPoint3(L(number), lever.mean, gaussian(lever.covariance)))
        for node, position, sigma in zip(sight.node, sight.position, sight.sigma_m, strict=True):
            model = robust(float(sigma), window.noise.huber)
            if lever is None:
                graph.add(gtsam.GPSFactorArm(X(node), position, np.zeros(3), model))
            else:
                graph.add(gtsam.GPSFactorArmCalib(X(node), L(number), position, model))


def _add_shoulder(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> None:
    """Smooth knots (`BetweenFactorPoint3`), seen by the camera, an upper arm away from the elbow."""
    shoulder, noise = window.shoulder, window.noise
    assert shoulder is not None
    for k in range(len(shoulder.node)):
        values.insert(S(k), shoulder.start[k])
        if np.isfinite(shoulder.position[k, 0]):
            model = robust(float(shoulder.sigma_m[k]), noise.huber)
            graph.add(gtsam.PriorFactorPoint3(S(k), shoulder.position[k], model))
    gaps = np.diff(window.t[shoulder.node])
    for k, gap_s in enumerate(gaps):
        walk = isotropic(3, round(noise.shoulder_walk * float(np.sqrt(gap_s)), 6))
        graph.add(gtsam.BetweenFactorPoint3(S(k), S(k + 1), np.zeros(3), walk))
    elbow, upper_arm = window.priors.levers.get("elbow"), window.priors.upper_arm
    if elbow is None or upper_arm is None:
        if not np.isfinite(shoulder.position[:, 0]).any():
            graph.add(gtsam.PriorFactorPoint3(S(0), shoulder.start[0], isotropic(3, 1.0)))
        return
    # `RangeFactorWithTransformBias3D`: the length's correction is the variable U
    length = float(upper_arm.mean[0])
    values.insert(U(0), 0.0)
    graph.addPriorDouble(U(0), 0.0, gaussian(upper_arm.covariance))
    model = isotropic(1, noise.upper_arm_sigma_m)
    at_elbow = Pose3(Rot3(), elbow.mean)
    for k, node in enumerate(shoulder.node):
        graph.add(gtsam.RangeFactorWithTransformBias3D(X(node), S(k), U(0), length, model, at_elbow))


def _add_attitude(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`PoseRotationPrior3D`: the start orientation, weakly, at one node."""
    R = window.start.R[window.attitude_node]
    covariance = R.T @ window.attitude_covariance @ R
    graph.add(gtsam.PoseRotationPrior3D(X(window.attitude_node), Rot3(R), gaussian(covariance)))


def gaussian(covariance: FloatArray) -> noiseModel.Gaussian:
    """A full-covariance noise model."""
    return noiseModel.Gaussian.Covariance(covariance)


@lru_cache(maxsize=4096)
def isotropic(dimension: int, sigma: float) -> noiseModel.Isotropic:
    """One noise object for each sigma, however many factors use it."""
    return noiseModel.Isotropic.Sigma(dimension, sigma)


@lru_cache(maxsize=4096)
def robust(sigma_m: float, huber: float) -> noiseModel.Robust:
    """Huber's loss on a point of the camera (Huber, Ann. Math. Statist. 1964)."""
    return noiseModel.Robust.Create(noiseModel.mEstimator.Huber.Create(huber), isotropic(3, sigma_m))


def gravity_covariance(direction: Unit3, covariance: FloatArray) -> Gaussian:
    """A `Unit3` marginal (2 x 2 in its own basis) as mean (3,) and covariance (3, 3) in {K}."""
    basis = direction.basis()
    return Gaussian(direction.point3(), basis @ covariance @ basis.T)
