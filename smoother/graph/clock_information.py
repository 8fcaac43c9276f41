"""Information of a window's samples on the clock offset, all other variables free to follow it."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import D

from ..recording import FloatArray
from ..window.problem import States, Window
from .build import stacked_measurements

#: Share of its bound that the information usually is; stands in where the elimination takes a weak direction
#: for a free one.
USUAL_SHARE = 0.3


def offset_information(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window, states: States
) -> float:
    """Information on one clock offset for the whole window, all other variables eliminated.

    A later offset moves every camera factor's error by the joint's velocity. The linearised graph gets that
    column as one more variable, and elimination (`GaussianFactorGraph.marginal`) gives what the other
    variables leave of it: states can follow a part of any shift. The robust loss counts with its weights at
    the solution.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        Of the window (`build`).
    values : gtsam.Values
        The solution.
    window : Window
    states : States
        The solution's, at the nodes.

    Returns
    -------
    information : float, 1/s^2
    """
    linear = graph.linearize(values)
    velocities, scatter = _velocities(window, states)
    velocity = iter(velocities)
    bound = 0.0
    extended = gtsam.GaussianFactorGraph()
    unit = gtsam.noiseModel.Unit.Create(3)
    for i in range(graph.size()):
        factor = linear.at(i)
        if isinstance(graph.at(i), gtsam.GPSFactorArm | gtsam.GPSFactorArmCalib):
            jacobian = gtsam.JacobianFactor(factor)
            keys, A = jacobian.keys(), jacobian.getA()
            weight = np.linalg.norm(A[:, 3:6]) / np.sqrt(3.0)  # whitened: a rotation times this
            column = weight * next(velocity)[:, None]
            bound += float(np.sum(column**2))
            pose, b = (keys[0], A[:, :6]), jacobian.getb()
            if len(keys) > 1:
                factor = gtsam.JacobianFactor(*pose, keys[1], A[:, 6:], D(0), column, b, unit)
            else:
                factor = gtsam.JacobianFactor(*pose, D(0), column, b, unit)
        extended.push_back(factor)
    if bound == 0.0:  # the camera saw nothing, or the arm was still
        return scatter
    try:
        marginal = extended.marginal([D(0)])
    except RuntimeError as error:
        if "ndetermin" not in str(error):
            raise
        return scatter + USUAL_SHARE * bound
    return scatter + float(sum(marginal.at(i).information()[0, 0] for i in range(marginal.size())))


def _velocities(window: Window, states: States) -> tuple[list[FloatArray], float]:
    """Velocity (3,) of the joint behind each camera factor, in the graph's order, m/s.

    And the information 1/s^2 in how samples that share a node differ in velocity, which no state follows.
    """
    velocities: list[FloatArray] = []
    scatter = 0.0
    for measured in window.joint_measurements:
        node, _, _ = stacked_measurements(measured, window.noise.cauchy)
        velocity = states.v[measured.node] + measured.velocity
        group = np.searchsorted(node, measured.node)
        total = np.stack([np.bincount(group, velocity[:, axis]) for axis in range(3)], axis=1)
        mean = total / np.bincount(group)[:, None]
        velocities += list(mean)
        scatter += float(np.sum((velocity - mean[group]) ** 2 / measured.sigma_m[:, None] ** 2))
    return velocities, scatter
