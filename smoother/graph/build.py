"""The factor graph of one window (GTSAM), in the camera's frame with gravity's direction unknown.

Variables: X pose `T_K_A` and V velocity a node, B bias every few seconds, G gravity's direction,
L lever arms of the joints in {A}, S shoulder knots, U correction of the upper-arm length; with an IMU on
the upper arm C its bias and M the lever arms in {B} (the rest of it: `chain`).
All factors are GTSAM's own; see each function for the class. Preintegration: Forster et al., TRO 2017.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import B, C, G, L, M, S, U, V, X

from ..recording import JOINTS, FloatArray, IntArray
from ..window.problem import JointMeasurements, Window
from ..window.shared import SharedLayout

#: A bias variable for about so long, s: one for a recording is too stiff to follow scale errors.
BIAS_LENGTH_S = 4.0
#: Error of the integration itself, m^2/s: a millimetre in a second, and intervals of some milliseconds do
#: not become so much stiffer than the rest that the solver calls the rest free.
INTEGRATION_VARIANCE = 1e-6
#: IMU noise goes up in steps of this factor, so that intervals share their parameters.
DENSITY_STEP = 1.25


def bias_of_intervals(window: Window) -> IntArray:
    """Which bias variable each of a window's intervals uses, (n - 1,)."""
    duration = window.t[-1] - window.t[0]
    count = max(1, round(duration / BIAS_LENGTH_S))
    middle = 0.5 * (window.t[1:] + window.t[:-1]) - window.t[0]
    return np.minimum((middle / duration * count).astype(int), count - 1)


def build(window: Window) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph of a window and its initial values.

    Parameters
    ----------
    window : Window

    Returns
    -------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Every variable of the graph.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    biases = bias_of_intervals(window)
    _add_states(values, window)
    # in this order: `error_columns` counts rows
    add_increments(graph, window, biases)
    _add_joints(graph, window)
    if window.shoulder is not None:
        _add_shoulder(graph, values, window)
    _add_constant_velocity(graph, window)
    _add_attitude(graph, window)
    _add_field(graph, window)
    _add_shared(graph, values, window, biases)
    return graph, values


def _add_states(values: gtsam.Values, window: Window) -> None:
    states = window.start
    for i in range(len(window.t)):
        values.insert(X(i), Pose3(Rot3(states.R[i]), states.p[i]))
        values.insert(V(i), states.v[i])


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
    pose, velocity, bias_of = symbols
    increments = window.increments
    bias = gtsam.imuBias.ConstantBias(increments.bias[:3], increments.bias[3:])
    acc = increments.acc + increments.bias[:3]
    gyro = increments.gyro + increments.bias[3:]
    first = increments.first
    levels = _noise_levels(window)
    params = {level: _parameters(window, *level) for level in set(levels)}
    for i in range(len(window.t) - 1):
        pim = gtsam.PreintegratedImuMeasurements(params[levels[i]], bias)
        for step in range(first[i], first[i + 1]):
            pim.integrateMeasurement(acc[step, 0], gyro[step], increments.h[step])
            pim.integrateMeasurement(acc[step, 1], gyro[step], increments.h[step])
        a, b = first_node + i, first_node + i + 1
        states = pose(a), velocity(a), pose(b), velocity(b)
        graph.add(
            gtsam.ImuFactorWithGravityDirection(
                *states, bias_of(biases[i]), G(0), pim, window.gravity_magnitude
            )
        )


def _noise_levels(window: Window) -> list[tuple[int, int]]:
    """Noise of each interval above the still sensor's, (accelerometer, gyroscope) in `DENSITY_STEP`s."""
    increments, noise = window.increments, window.noise
    count = np.diff(increments.first)
    force = np.linalg.norm(increments.acc.mean(axis=1), axis=1) - window.gravity_magnitude
    rate = np.linalg.norm(increments.gyro, axis=1)
    moving = np.add.reduceat(np.abs(force), increments.first[:-1]) / count
    turning = np.add.reduceat(rate, increments.first[:-1]) / count
    impacts = increments.velocity_error / np.sqrt(np.diff(window.t))
    acc = np.hypot(
        np.hypot(1.0, noise.accelerometer_share / noise.accelerometer_density * moving),
        impacts / noise.accelerometer_density,
    )
    gyro = np.hypot(1.0, noise.gyroscope_share / noise.gyroscope_density * turning)
    level = np.round(np.log(np.stack([acc, gyro], axis=1)) / np.log(DENSITY_STEP)).astype(int)
    return [(int(a), int(g)) for a, g in level]


def _parameters(window: Window, acc: int, gyro: int) -> gtsam.PreintegrationParams:
    """Noise of the preintegration at a level."""
    noise = window.noise
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, -window.gravity_magnitude]))
    params.setAccelerometerCovariance(np.eye(3) * (DENSITY_STEP**acc * noise.accelerometer_density) ** 2)
    params.setGyroscopeCovariance(np.eye(3) * (DENSITY_STEP**gyro * noise.gyroscope_density) ** 2)
    params.setIntegrationCovariance(np.eye(3) * INTEGRATION_VARIANCE)
    return params


def shared_keys(window: Window, biases: IntArray) -> list[int]:
    """Keys of the shared variables in the order of the shared vector; the bias of the window's middle.

    Parameters
    ----------
    window : Window
    biases : ndarray of int, shape (n - 1,)
        From `bias_of_intervals`.

    Returns
    -------
    keys : list of int
        As many as there are shared quantities.
    """
    layout = window.priors.layout
    keys = [B((int(biases[-1]) + 1) // 2), G(0)]
    keys += [U(0)] if layout.has_upper_arm else []
    keys += [L(JOINTS.index(joint)) for joint in layout.joints]
    if layout.has_upper_imu:
        keys += [M(JOINTS.index(joint)) for joint in layout.upper_levers]
        keys += [C((int(biases[-1]) + 1) // 2)]
    return keys


def shared_jacobian(layout: SharedLayout, down: Unit3) -> FloatArray:
    """Shared vector's change for a change of GTSAM's own coordinates.

    They differ for gravity (its tangent basis, `Unit3.basis`) and for the upper arm: the range factor's
    error is range + U - length, so the length falls as U grows.

    Parameters
    ----------
    layout : SharedLayout
    down : gtsam.Unit3
        Gravity's direction in {K}.

    Returns
    -------
    jacobian : ndarray, shape (s, s)
    """
    jacobian = np.eye(layout.size)
    jacobian[layout.upper_arm, layout.upper_arm] *= -1.0
    jacobian[layout.gravity, layout.gravity] = layout.gravity_axes @ down.basis()
    return jacobian


def _add_shared(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window, biases: IntArray
) -> None:
    """One joint Gaussian prior (`HessianFactor`), a random walk of the biases (`BetweenFactor..`)."""
    priors, layout, mean = window.priors, window.priors.layout, window.priors.shared.mean
    bias = gtsam.imuBias.ConstantBias(mean[:3], mean[3:6])
    count = int(biases[-1]) + 1
    for k in range(count):
        values.insert(B(k), bias)
    walk = noiseModel.Diagonal.Sigmas(priors.bias_walk * np.sqrt((window.t[-1] - window.t[0]) / count))
    for k in range(count - 1):
        graph.add(gtsam.BetweenFactorConstantBias(B(k), B(k + 1), gtsam.imuBias.ConstantBias(), walk))
    down = Unit3(layout.down(mean))
    values.insert(G(0), down)
    if layout.has_upper_arm:
        values.insert(U(0), 0.0)
    for joint in layout.joints:
        values.insert(L(JOINTS.index(joint)), mean[layout.lever(joint)])
    if layout.has_upper_imu:
        upper_bias = gtsam.imuBias.ConstantBias(*np.split(mean[layout.upper_bias], 2))
        for k in range(count):
            values.insert(C(k), upper_bias)
        for k in range(count - 1):
            graph.add(gtsam.BetweenFactorConstantBias(C(k), C(k + 1), gtsam.imuBias.ConstantBias(), walk))
        for joint, rows in layout.upper_levers.items():
            values.insert(M(JOINTS.index(joint)), mean[rows])
    # the prior's mean is the initial value, so only its information matrix is needed
    jacobian = shared_jacobian(layout, down)
    information = jacobian.T @ np.linalg.inv(priors.shared.covariance) @ jacobian
    keys = shared_keys(window, biases)
    factor = _gaussian_factor(keys, _blocks(layout), 0.5 * (information + information.T))
    at = gtsam.Values()
    at.insert(keys[0], bias)
    at.insert(G(0), down)
    if layout.has_upper_arm:
        at.insert(U(0), 0.0)
    for joint in layout.joints:
        at.insert(L(JOINTS.index(joint)), mean[layout.lever(joint)])
    if layout.has_upper_imu:
        at.insert(keys[-1], upper_bias)
        for joint, rows in layout.upper_levers.items():
            at.insert(M(JOINTS.index(joint)), mean[rows])
    graph.add(gtsam.LinearContainerFactor(factor, at))


def _blocks(layout: SharedLayout) -> list[slice]:
    upper_arm = [layout.upper_arm] if layout.has_upper_arm else []
    levers = [layout.lever(joint) for joint in layout.joints]
    upper_imu = [*layout.upper_levers.values(), layout.upper_bias] if layout.has_upper_imu else []
    return [layout.bias, layout.gravity, *upper_arm, *levers, *upper_imu]


def _gaussian_factor(keys: list[int], blocks: list[slice], information: FloatArray) -> gtsam.HessianFactor:
    """A zero-mean Gaussian over any number of variables, put together from its pairs."""
    pairs = gtsam.GaussianFactorGraph()
    for i, (key, rows) in enumerate(zip(keys, blocks, strict=True)):
        size = rows.stop - rows.start
        pairs.add(gtsam.HessianFactor(key, information[rows, rows], np.zeros(size), 0.0))
        for other, columns in zip(keys[i + 1 :], blocks[i + 1 :], strict=True):
            width = columns.stop - columns.start
            pairs.add(
                gtsam.HessianFactor(
                    key,
                    other,
                    np.zeros((size, size)),
                    information[rows, columns],
                    np.zeros(size),
                    np.zeros((width, width)),
                    np.zeros(width),
                    0.0,
                )
            )
    return gtsam.HessianFactor(pairs)


def _add_joints(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`GPSFactorArmCalib` (the lever arm is a variable) or `GPSFactorArm` at the IMU itself."""
    for measured in window.joint_measurements:
        is_lever = measured.joint in window.priors.layout.joints
        key = L(JOINTS.index(measured.joint))
        for node, position, sigma in zip(*stacked_measurements(measured, window.noise.cauchy), strict=True):
            model = robust(float(sigma), window.noise.cauchy)
            if is_lever:
                graph.add(gtsam.GPSFactorArmCalib(X(node), key, position, model))
            else:
                graph.add(gtsam.GPSFactorArm(X(node), position, np.zeros(3), model))


def stacked_measurements(
    measured: JointMeasurements, cauchy: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """A joint's samples node by node.

    Samples that share a node are averaged, each weighted by Cauchy's loss about their median, so that one
    that is far off costs itself and not the others.

    Parameters
    ----------
    measured : JointMeasurements
    cauchy : float
        Length of a residual, in sigmas, where its weight is halved.

    Returns
    -------
    node : ndarray of int, shape (m,)
        Increasing, each once.
    position : ndarray, shape (m, 3), m
        The joint at the node in {K}.
    sigma_m : ndarray, shape (m,), m
        Standard deviation an axis.
    """
    at_node = measured.position - measured.shift
    node, first, count = np.unique(measured.node, return_index=True, return_counts=True)
    if len(node) == len(measured.node):
        return measured.node, at_node, measured.sigma_m
    rank = np.arange(len(measured.node)) - np.repeat(first, count)
    group = np.repeat(np.arange(len(node)), count)
    table = np.full((len(node), int(count.max()), 3), np.inf)  # short groups: the rest sorts last
    table[group, rank] = at_node
    table.sort(axis=1)
    median = table[np.arange(len(node)), (count - 1) // 2]
    off = np.linalg.norm(at_node - median[group], axis=1) / measured.sigma_m
    off[np.repeat(count, count) < 3] = 0.0  # two cannot outvote each other
    weight = 1.0 / (1.0 + (off / cauchy) ** 2) / measured.sigma_m**2
    total = np.bincount(group, weight)
    mean = np.stack([np.bincount(group, weight * at_node[:, axis]) for axis in range(3)], axis=1)
    return node, mean / total[:, None], np.round(1.0 / np.sqrt(total), 6)


def _add_shoulder(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> None:
    """Smooth knots (`BetweenFactorPoint3`), camera samples (`PriorFactorPoint3`), the upper arm's length."""
    shoulder, noise = window.shoulder, window.noise
    assert shoulder is not None
    for k in range(len(shoulder.node)):
        values.insert(S(k), shoulder.start[k])
        if np.isfinite(shoulder.position[k, 0]):
            model = robust(float(shoulder.sigma_m[k]), noise.cauchy)
            graph.add(gtsam.PriorFactorPoint3(S(k), shoulder.position[k], model))
    for k, dt in enumerate(np.diff(window.t[shoulder.node])):
        walk = isotropic(3, round(noise.shoulder_walk * float(np.sqrt(dt)), 6))
        graph.add(gtsam.BetweenFactorPoint3(S(k), S(k + 1), np.zeros(3), walk))
    if not np.isfinite(shoulder.position[:, 0]).any():
        graph.add(gtsam.PriorFactorPoint3(S(0), shoulder.start[0], isotropic(3, 1.0)))
    if window.priors.layout.has_upper_arm:
        for k in range(len(shoulder.node)):
            graph.add(upper_arm_factor(window, k, noise.upper_arm_sigma_m))


def upper_arm_factor(window: Window, knot: int, sigma_m: float) -> gtsam.RangeFactorWithTransformBias3D:
    """The elbow's distance from a shoulder knot; the length's correction is the variable U.

    Parameters
    ----------
    window : Window
        With a shoulder, and an upper arm among the shared quantities.
    knot : int
        Of the shoulder.
    sigma_m : float, m
        How far from constant the length is.

    Returns
    -------
    factor : gtsam.RangeFactorWithTransformBias3D
    """
    assert window.shoulder is not None
    layout, mean = window.priors.layout, window.priors.shared.mean
    length, at_elbow = float(mean[layout.upper_arm][0]), Pose3(Rot3(), mean[layout.lever("elbow")])
    model = isotropic(1, sigma_m)
    node = int(window.shoulder.node[knot])
    return gtsam.RangeFactorWithTransformBias3D(X(node), S(knot), U(0), length, model, at_elbow)


def _add_constant_velocity(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`BetweenFactorVector` on the velocities inside gaps: a still arm keeps its velocity."""
    for i in np.flatnonzero(np.isfinite(window.velocity_change)).tolist():
        model = isotropic(3, float(window.velocity_change[i]))
        graph.add(gtsam.BetweenFactorVector(V(i), V(i + 1), np.zeros(3), model))


def _add_attitude(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`PoseRotationPrior3D`: the initial orientation, weakly, at one node."""
    R = window.attitude
    covariance = R.T @ window.attitude_covariance @ R
    graph.add(gtsam.PoseRotationPrior3D(X(window.attitude_node), Rot3(R), gaussian(covariance)))


def _add_field(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`AttitudeFactorPose3`: a calibrated magnetometer's directions, robust against a magnet near one."""
    if window.field is None:
        return
    field = window.field
    loss = noiseModel.mEstimator.Cauchy.Create(window.noise.cauchy)
    model = noiseModel.Robust.Create(loss, isotropic(2, round(field.sigma_rad, 5)))
    for node, in_A in zip(field.node.tolist(), field.in_A, strict=True):
        graph.add(gtsam.AttitudeFactorPose3(X(node), Unit3(field.in_K), model, Unit3(in_A)))


def gaussian(covariance: FloatArray) -> noiseModel.Gaussian:
    """A full-covariance noise model."""
    return noiseModel.Gaussian.Covariance(covariance)


@lru_cache(maxsize=4096)
def isotropic(dimension: int, sigma: float) -> noiseModel.Isotropic:
    """One noise object for each sigma, however many factors use it."""
    return noiseModel.Isotropic.Sigma(dimension, sigma)


@lru_cache(maxsize=4096)
def robust(sigma_m: float, cauchy: float) -> noiseModel.Robust:
    """Cauchy's loss on a point of the camera: what is far off pulls less the farther it is."""
    return noiseModel.Robust.Create(noiseModel.mEstimator.Cauchy.Create(cauchy), isotropic(3, sigma_m))
