"""The upper arm in a window's graph: a second IMU between shoulder and elbow (GTSAM).

More variables: Y pose `T_K_B` and W velocity of the upper-arm IMU at the nodes that it covers, E the elbow
there. Two rigid bodies share the elbow, and the upper one ends in the shoulder, so that an error of position
does not grow with the time that the camera sees nothing of the forearm. Soft tissue moves an IMU against its
bone; that is the sigma of elbow and shoulder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import C, E, L, M, S, W, X, Y

from ..array_types import FloatArray, IntArray
from ..linalg import interpolate
from ..recording import JOINTS
from ..window.problem import States, UpperRun, Window
from ..window.solution import UpperSolution
from .build import bias_of_intervals, build, gaussian, isotropic
from .imu_factors import add_increments

_ELBOW, _SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")
#: The elbow on the forearm's side: the strap sits firmer at the wrist, and its lever arm is a variable, m.
FOREARM_TIE_M = 0.005
#: How long a movement of the tissue lasts, s.
TISSUE_S = 1.0


def build_arm(window: Window) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The graph of a window with all of its IMUs, and its initial values.

    Parameters
    ----------
    window : Window

    Returns
    -------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Every variable of the graph.
    """
    graph, values = build(window)
    biases = bias_of_intervals(window)
    for run in window.upper:
        _add_states(values, run)
        nodes = slice(run.first, run.first + len(run.start.p))
        own = replace(window, t=window.t[nodes], increments=run.increments)
        add_increments(graph, own, biases[nodes.start : nodes.stop - 1], (Y, W, C), run.first)
        _add_elbow(graph, values, window, run)
        _add_shoulder(graph, window, run)
        _add_attitude(graph, run)
    return graph, values


def _add_states(values: gtsam.Values, run: UpperRun) -> None:
    for k in range(len(run.start.p)):
        values.insert(Y(run.first + k), Pose3(Rot3(run.start.R[k]), run.start.p[k]))
        values.insert(W(run.first + k), run.start.v[k])


def _add_elbow(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window, run: UpperRun
) -> None:
    """`ReferenceFrameFactorPoint3Pose3` (lever, pose, point): one point on both bodies."""
    layout, mean = window.priors.layout, window.priors.shared.mean
    lever = mean[layout.upper_levers["elbow"]]
    sigma = _tissue(window, np.arange(run.first, run.first + len(run.start.p)))
    for k in range(len(run.start.p)):
        node = run.first + k
        forearm, tissue = isotropic(3, FOREARM_TIE_M), isotropic(3, sigma[k])
        values.insert(E(node), run.start.p[k] + run.start.R[k] @ lever)
        graph.add(gtsam.ReferenceFrameFactorPoint3Pose3(L(_ELBOW), X(node), E(node), forearm))
        graph.add(gtsam.ReferenceFrameFactorPoint3Pose3(M(_ELBOW), Y(node), E(node), tissue))


def _add_shoulder(graph: gtsam.NonlinearFactorGraph, window: Window, run: UpperRun) -> None:
    """`ReferenceFrameFactorPoint3Pose3`: the upper arm ends in the shoulder's knots."""
    if window.shoulder is None:
        return
    for knot, sigma in enumerate(_tissue(window, window.shoulder.node)):
        node, tissue = int(window.shoulder.node[knot]), isotropic(3, sigma)
        if run.first <= node < run.first + len(run.start.p):
            graph.add(gtsam.ReferenceFrameFactorPoint3Pose3(M(_SHOULDER), Y(node), S(knot), tissue))


def _tissue(window: Window, nodes: IntArray) -> list[float]:
    """Sigma of a point in {B} at nodes (k,): tissue moves slowly, so what is denser does not say more."""
    step = np.gradient(window.t[nodes]) if len(nodes) > 1 else np.full(len(nodes), TISSUE_S)
    sigma = window.noise.tissue_m * np.sqrt(np.maximum(TISSUE_S / step, 1.0))
    return [float(each) for each in np.round(sigma, 3)]


def _add_attitude(graph: gtsam.NonlinearFactorGraph, run: UpperRun) -> None:
    """`PoseRotationPrior3D`: the initial orientation, weakly, at one node."""
    covariance = run.attitude.T @ run.attitude_covariance @ run.attitude
    node = run.first + run.attitude_node
    graph.add(gtsam.PoseRotationPrior3D(Y(node), Rot3(run.attitude), gaussian(covariance)))


def upper_solution(
    values: gtsam.Values,
    covariances_of: Callable[[Sequence[int]], FloatArray] | None,
    window: Window,
    biases: IntArray,
    nodes: IntArray | None,
) -> UpperSolution | None:
    """What a solved graph says of the upper-arm IMU.

    Parameters
    ----------
    values : gtsam.Values
        The solution.
    covariances_of : callable or None
        Gives variables' covariances at the solution; None where they are not asked for.
    window : Window
    biases : ndarray of int, shape (n - 1,)
        From `bias_of_intervals`.
    nodes : ndarray of int, shape (k,), or None
        Where covariances are computed, interpolated in between; None likewise.

    Returns
    -------
    solution : UpperSolution or None
        None where the recording has no such IMU.
    """
    if not window.priors.layout.has_upper_imu:
        return None
    n = len(window.t)
    known = np.zeros(n, dtype=bool)
    R, p, v = np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    pose = None if nodes is None else np.full((n, 6, 6), np.nan)
    for run in window.upper:
        rows = np.arange(run.first, run.first + len(run.start.p))
        known[rows] = True
        poses = [values.atPose3(Y(i)) for i in rows]
        R[rows] = [each.rotation().matrix() for each in poses]
        p[rows] = [each.translation() for each in poses]
        v[rows] = [values.atVector(W(i)) for i in rows]
        if pose is not None and nodes is not None and covariances_of is not None:
            own = np.union1d(nodes[(nodes >= rows[0]) & (nodes <= rows[-1])], rows[[0, -1]])
            covariance = covariances_of([Y(i) for i in own])
            pose[rows] = interpolate(window.t[own], in_camera(covariance, R[own]), window.t[rows])
    bias = np.array([values.atConstantBias(C(k)).vector() for k in range(int(biases[-1]) + 1)])
    return UpperSolution(known, States(R, p, v), pose, bias[np.append(biases, biases[-1])])


def in_camera(covariance: FloatArray, R: FloatArray) -> FloatArray:
    """From GTSAM's (rotation, translation) in the body's axes to (position, rotation) in {K}, (n, 6, 6)."""
    order = np.array([3, 4, 5, 0, 1, 2])
    body = covariance[:, order][:, :, order]
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    return np.asarray(turn @ body @ np.swapaxes(turn, 1, 2))
