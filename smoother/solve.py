"""Solve one window: optimise its graph, read the answer and its covariance."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from .errors import SolveError
from .graph import bias_of_intervals, build, gravity_covariance
from .recording import FloatArray, IntArray
from .window import Gaussian, Message, Solution, States, Window

#: The optimiser stops when an iteration lowers the error by less than this part of it.
RELATIVE_TOLERANCE = 1e-4
MAX_ITERATIONS = 12


def solve(window: Window, with_covariance: bool) -> Solution:
    """Optimise a window with Levenberg-Marquardt and read its answer.

    Parameters
    ----------
    with_covariance : also the covariance of every node (a third of the time).

    Raises
    ------
    SolveError
        The window leaves something free; the text names the time.
    """
    graph, values = build(window)
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(MAX_ITERATIONS)
    params.setRelativeErrorTol(RELATIVE_TOLERANCE)
    params.setlambdaInitial(1e-9)  # a good start: close to Gauss-Newton from the first step
    try:
        optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
        values = optimizer.optimize()
        marginals = _marginals(graph, values)
    except RuntimeError as error:
        if "ndetermin" not in str(error):
            raise
        raise SolveError(
            f"the motion between {window.t[0]:.1f} s and {window.t[-1]:.1f} s is not determined by what"
            " the camera saw there"
        ) from error
    biases = bias_of_intervals(window)
    states = _states(values, len(window.t))
    pose_covariance = velocity_covariance = None
    if with_covariance:
        pose_covariance, velocity_covariance = _covariances(marginals, states.R)
    shoulder, shoulder_covariance = _shoulder(values, marginals, window, with_covariance)
    return Solution(
        index=window.index,
        states=states,
        pose_covariance=pose_covariance,
        velocity_covariance=velocity_covariance,
        shoulder=shoulder,
        shoulder_covariance=shoulder_covariance,
        message=_message(values, marginals, window, biases),
        bias=_bias(values, biases),
        residuals=_residuals(values, window, states),
        iterations=optimizer.iterations(),
        error=graph.error(values),
    )


def _marginals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Marginals:
    return gtsam.Marginals(graph, values)


def _states(values: gtsam.Values, count: int) -> States:
    poses = [values.atPose3(X(i)) for i in range(count)]
    return States(
        R=np.array([pose.rotation().matrix() for pose in poses]),
        p=np.array([pose.translation() for pose in poses]),
        v=np.array([values.atVector(V(i)) for i in range(count)]),
    )


def _covariances(marginals: gtsam.Marginals, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Marginals of every pose, turned from GTSAM's (rotation, translation) in {A} to (position, rotation) in {K}."""
    count = len(R)
    body = np.array([marginals.marginalCovariance(X(i)) for i in range(count)])
    velocity = np.array([marginals.marginalCovariance(V(i)) for i in range(count)])
    order = np.array([3, 4, 5, 0, 1, 2])
    body = body[:, order][:, :, order]
    turn = np.zeros((count, 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    return turn @ body @ np.swapaxes(turn, 1, 2), velocity


def _shoulder(
    values: gtsam.Values, marginals: gtsam.Marginals, window: Window, with_covariance: bool
) -> tuple[FloatArray | None, FloatArray | None]:
    if window.shoulder is None:
        return None, None
    knots = range(len(window.shoulder.node))
    position = np.array([values.atPoint3(S(k)) for k in knots])
    if not with_covariance:
        return position, None
    return position, np.array([marginals.marginalCovariance(S(k)) for k in knots])


def _bias(values: gtsam.Values, biases: IntArray) -> FloatArray:
    """Bias at the nodes, (n, 6)."""
    each = np.array([values.atConstantBias(B(k)).vector() for k in range(int(biases[-1]) + 1)])
    return each[np.append(biases, biases[-1])]


def _message(
    values: gtsam.Values, marginals: gtsam.Marginals, window: Window, biases: IntArray
) -> Message:
    middle = (int(biases[-1]) + 1) // 2
    gravity = values.atUnit3(G(0))
    levers = {
        sight.joint: Gaussian(values.atPoint3(L(k)), marginals.marginalCovariance(L(k)))
        for k, sight in enumerate(window.sights)
        if sight.joint in window.priors.levers
    }
    upper_arm = None
    if values.exists(U(0)):
        assert window.priors.upper_arm is not None
        upper_arm = Gaussian(
            window.priors.upper_arm.mean + values.atDouble(U(0)), marginals.marginalCovariance(U(0))
        )
    return Message(
        t_s=float(0.5 * (window.t[0] + window.t[-1])),
        bias=Gaussian(values.atConstantBias(B(middle)).vector(), marginals.marginalCovariance(B(middle))),
        gravity=gravity_covariance(gravity, marginals.marginalCovariance(G(0))),
        upper_arm=upper_arm,
        levers=levers,
    )


def _residuals(values: gtsam.Values, window: Window, states: States) -> dict[str, FloatArray]:
    residuals = {}
    for number, sight in enumerate(window.sights):
        lever = values.atPoint3(L(number)) if sight.joint in window.priors.levers else np.zeros(3)
        answer = states.p[sight.node] + states.R[sight.node] @ lever
        residuals[sight.joint] = sight.position - answer
    return residuals

