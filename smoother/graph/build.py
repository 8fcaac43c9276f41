"""The factor graph of one window (GTSAM), in the camera's frame with gravity's direction unknown.

Variables: X pose `T_K_A` and V velocity a node, B bias every few seconds, G gravity's direction,
L lever arms of the joints in {A}, S shoulder knots, U correction of the upper-arm length; with an IMU on
the upper arm C its bias and M the lever arms in {B} (the rest of it: `chain`).
All factors are GTSAM's own; see each function for the class.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import L, S, U, V, X

from ..array_types import FloatArray, IntArray
from ..recording import JOINTS
from ..window.problem import JointMeasurements, Window
from .imu_factors import add_increments
from .shared_prior import add_shared

#: A bias variable for about so long, s: one for a recording is too stiff to follow scale errors.
BIAS_LENGTH_S = 4.0
#: A window has no more of them: they take part in every step of the solution. In gaps of minutes, where alone
#: windows are that long, the arm's reach says more than the integrated IMU.
MOST_BIASES = 24


def bias_of_intervals(window: Window) -> IntArray:
    """Which bias variable each of a window's intervals uses, (n - 1,)."""
    duration = window.t[-1] - window.t[0]
    count = min(max(1, round(duration / BIAS_LENGTH_S)), MOST_BIASES)
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
    add_shared(graph, values, window, biases)
    return graph, values


def _add_states(values: gtsam.Values, window: Window) -> None:
    start, pose, velocity = window.start, X(0), V(0)  # keys of a letter follow each other
    for i, (R, p, v) in enumerate(zip(start.R, start.p, start.v, strict=True)):
        values.insert(pose + i, Pose3(Rot3(R), p))
        values.insert(velocity + i, v)


def _add_joints(graph: gtsam.NonlinearFactorGraph, window: Window) -> None:
    """`GPSFactorArmCalib` (the lever arm is a variable) or `GPSFactorArm` at the IMU itself."""
    for measured in window.joint_measurements:
        is_lever = measured.joint in window.priors.layout.joints
        pose, key, nowhere = X(0), L(JOINTS.index(measured.joint)), np.zeros(3)
        nodes, positions, sigmas = stacked_measurements(measured, window.noise.cauchy)
        for node, position, sigma in zip(nodes.tolist(), positions, sigmas.tolist(), strict=True):
            model = robust(sigma, window.noise.cauchy)
            if is_lever:
                graph.add(gtsam.GPSFactorArmCalib(pose + node, key, position, model))
            else:
                graph.add(gtsam.GPSFactorArm(pose + node, position, nowhere, model))


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
    still = np.zeros(3)
    for k, length in enumerate(np.sqrt(np.diff(window.t[shoulder.node])).tolist()):
        walk = isotropic(3, round(noise.shoulder_walk * length, 6))
        graph.add(gtsam.BetweenFactorPoint3(S(k), S(k + 1), still, walk))
    if not np.isfinite(shoulder.position[:, 0]).any():
        graph.add(gtsam.PriorFactorPoint3(S(0), shoulder.start[0], isotropic(3, 1.0)))
    if window.priors.layout.has_upper_arm:
        for factor in upper_arm_factors(window, np.full(len(shoulder.node), noise.upper_arm_sigma_m)):
            graph.add(factor)


def upper_arm_factors(
    window: Window, sigma_m: FloatArray, knots: IntArray | None = None
) -> Iterator[gtsam.RangeFactorWithTransformBias3D]:
    """The elbow's distance from shoulder knots; the length's correction is the variable U.

    Parameters
    ----------
    window : Window
        With a shoulder, and an upper arm among the shared quantities.
    sigma_m : ndarray, shape (k,), m
        How far from constant the length is, at each knot.
    knots : ndarray of int, shape (k,), optional
        Of the shoulder; all where None.

    Yields
    ------
    factor : gtsam.RangeFactorWithTransformBias3D
        One a knot.
    """
    assert window.shoulder is not None
    layout, mean = window.priors.layout, window.priors.shared.mean
    length, at_elbow = float(mean[layout.upper_arm][0]), Pose3(Rot3(), mean[layout.lever("elbow")])
    nodes = np.asarray(window.shoulder.node)
    knots = np.arange(len(nodes)) if knots is None else knots
    for knot, node, sigma in zip(knots.tolist(), nodes[knots].tolist(), sigma_m.tolist(), strict=True):
        model = isotropic(1, sigma)
        yield gtsam.RangeFactorWithTransformBias3D(X(node), S(knot), U(0), length, model, at_elbow)


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
