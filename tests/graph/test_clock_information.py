"""What a window says of the clock offset, against the dense information of the extended problem.

The twin knows nothing of factors: the window is built again with every camera sample moved along its joint's
velocity, and the offset's column comes from differences of the graph's gradient and of the loss.
"""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X
from scenes import arm, first_window, plain, point

import smoother.window.nodes
from smoother.array_types import FloatArray
from smoother.graph.build import build
from smoother.graph.columns import offset_information, stamp_columns
from smoother.graph.solved import SolvedWindow
from smoother.simulation import SimulatedArm
from smoother.window.problem import States, Window

#: The graph is linear in the samples' positions but for the robust loss: a large step would change its
#: weights, s.
STEP_S = 1e-3


def window_of(made: SimulatedArm, grouped: bool) -> Window:
    """The only window of a recording with white noise; several frames a node, or a node for every frame."""
    with patch.object(
        smoother.window.nodes, "GROUPED_S", smoother.window.nodes.GROUPED_S if grouped else 0.0
    ):
        return plain(first_window(made.recording, made.calibration))


def optimum(window: Window) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values, States]:
    graph, values, _ = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    poses = [values.atPose3(X(i)) for i in range(len(window.t))]
    states = States(
        np.array([pose.rotation().matrix() for pose in poses]),
        np.array([pose.translation() for pose in poses]),
        np.array([values.atVector(V(i)) for i in range(len(window.t))]),
    )
    return graph, values, states


def later(window: Window, states: States, offset_s: float) -> Window:
    """The window with every sample taken this much later: where its joint was that much earlier."""
    measured = tuple(
        replace(m, position=m.position - offset_s * (states.v[m.node] + m.velocity))
        for m in window.joint_measurements
    )
    return replace(window, joint_measurements=measured)


def bound(window: Window, states: States) -> float:
    """The offset's information if no state could follow, sample by sample."""
    return sum(
        float(np.sum((states.v[m.node] + m.velocity) ** 2 / m.sigma_m[:, None] ** 2))
        for m in window.joint_measurements
    )


def dense_information(window: Window, values: gtsam.Values, states: States) -> float:
    """The Schur complement of the dense information matrix with the offset as its last column."""

    def gradient(offset_s: float) -> FloatArray:
        return np.asarray(build(later(window, states, offset_s))[0].linearize(values).hessian()[1])

    information = np.asarray(build(window)[0].linearize(values).hessian()[0])
    column = (gradient(STEP_S) - gradient(-STEP_S)) / (2 * STEP_S)
    scale = 1.0 / np.sqrt(np.diag(information))
    root = np.linalg.solve(np.linalg.cholesky(information * scale[:, None] * scale), column * scale)
    return bound(window, states) - float(root @ root)


def stated_information(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> float:
    solved = SolvedWindow(window, graph, values, build(window).groups)
    return offset_information(solved, solved.system([stamp_columns(solved)]), 0)


def made(name: str) -> SimulatedArm:
    if name == "strap":
        return point(4, duration_s=2.0, occlusion_lengths_s=())
    white = {"protocol": "random", "occlusion_lengths_s": ()}
    if name == "precise":
        return arm(4, "clean", noise_m=0.001, duration_s=1.1, **white)
    return arm(3, duration_s=2.0, **white)


@pytest.mark.parametrize("name", ["arm", "precise", "strap"])
def test_a_node_for_every_frame(name: str) -> None:
    window = window_of(made(name), grouped=False)
    graph, values, states = optimum(window)
    stated = stated_information(graph, values, window)
    assert stated == pytest.approx(dense_information(window, values, states), rel=1e-6)  # measured 2e-9
    assert 0.0 < stated < bound(window, states)
    if name == "arm":  # its shoulder holds it
        nobody = replace(window, joint_measurements=())
        graph, values, _ = build(nobody)
        assert stated_information(graph, values, nobody) == 0.0


def test_frames_that_share_a_node() -> None:
    """To 1e-3: the sigma of a node's mean is rounded to a micrometre, 3e-4 of it."""
    window = window_of(arm(3, protocol="random", duration_s=4.0, occlusion_lengths_s=()), grouped=True)
    assert len(window.t) < len(window.joint_measurements[0].t_s)
    graph, values, states = optimum(window)
    stated = stated_information(graph, values, window)
    assert stated == pytest.approx(dense_information(window, values, states), rel=1e-3)
