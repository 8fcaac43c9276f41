"""Information of a window's samples on the clock offset, all other variables free to follow it.

A later offset moves every camera factor's error by the joint's velocity. The linearised system gets that
column as one more quantity, and its reduction gives what the variables leave of it: states can follow a part
of any shift. The robust loss counts with its weights at the solution.
"""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..window.problem import JointMeasurements, States, Window
from .build import stacked_measurements
from .error_columns import JOINT_ROWS, camera_rows
from .jacobian import Jacobian
from .linear_system import LinearSystem


def offset_column(jacobian: Jacobian, window: Window, states: States) -> FloatArray:
    """Column of the whitened Jacobian for a clock offset of the window's own.

    Parameters
    ----------
    jacobian : Jacobian
        Of the graph as `build` puts it together.
    window : Window
    states : States
        At its nodes.

    Returns
    -------
    column : ndarray, shape (r, 1), 1/s
        Of the first r rows; the offset is in no others.
    """
    by_joint = {measured.joint: measured for measured in window.joint_measurements}
    column = np.zeros((0, 1))
    for factors in camera_rows(jacobian, window):
        if factors.joint in by_joint:
            mean, _ = _velocity_at_nodes(by_joint[factors.joint], states, window.noise.cauchy)
            rows = np.zeros((factors.rows.stop, 1))
            rows[: len(column)] = column
            rows[factors.rows] = factors.weight[:, None] * mean.reshape(-1, 1)
            column = rows
    return column


def stamp_columns(jacobian: Jacobian, window: Window, states: States, knots: FloatArray) -> FloatArray:
    """Columns of the whitened Jacobian for errors of the frames' times, linear between knots.

    Parameters
    ----------
    jacobian : Jacobian
        Of the graph as `build` puts it together.
    window : Window
    states : States
        At its nodes.
    knots : ndarray, shape (m,), s
        Even, from before the first node to after the last.

    Returns
    -------
    columns : ndarray, shape (r, m), 1/s
        Of the first r rows; the errors are in no others.
    """
    column = offset_column(jacobian, window, states)
    columns = np.zeros((len(column), len(knots)))
    for factors in camera_rows(jacobian, window):
        if factors.rows.stop <= len(column):
            apart = np.abs(window.t[factors.nodes][:, None] - knots) / (knots[1] - knots[0])
            share = np.maximum(1.0 - apart, 0.0)
            columns[factors.rows] = column[factors.rows] * np.repeat(share, JOINT_ROWS, axis=0)
    return columns


def offset_information(system: LinearSystem, column: int, window: Window, states: States) -> float:
    """Information on one clock offset for the whole window, all variables eliminated.

    Parameters
    ----------
    system : LinearSystem
        With `offset_column` among its extra columns.
    column : int
        Its number among them; the others are held fixed.
    window : Window
    states : States
        The solution's, at the nodes.

    Returns
    -------
    information : float, 1/s^2
    """
    scatter = sum(
        _velocity_at_nodes(measured, states, window.noise.cauchy)[1] for measured in window.joint_measurements
    )
    return scatter + system.extra_information(column)


def _velocity_at_nodes(
    measured: JointMeasurements, states: States, cauchy: float
) -> tuple[FloatArray, float]:
    """A joint's mean velocity (m, 3) m/s at each of its camera factors, in their order.

    And the information 1/s^2 in how samples that share a node differ in velocity, which no state follows.
    """
    node, _, _ = stacked_measurements(measured, cauchy)
    velocity = states.v[measured.node] + measured.velocity
    group = np.searchsorted(node, measured.node)
    total = np.stack([np.bincount(group, velocity[:, axis]) for axis in range(3)], axis=1)
    mean = total / np.bincount(group)[:, None]
    return mean, float(np.sum((velocity - mean[group]) ** 2 / measured.sigma_m[:, None] ** 2))
