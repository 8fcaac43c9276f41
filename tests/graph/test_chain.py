"""The graph of a window with two IMUs: the elbow is one point, and its covariance is that of the samples."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import E, L, M, S, X, Y
from scenes import arm, first_window

from smoother.body import UPPER_ARM
from smoother.graph.build import bias_of_intervals, build
from smoother.graph.shared_prior import shared_keys
from smoother.graph.solve import solve
from smoother.recording import JOINTS
from smoother.window.problem import Window

ELBOW, SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")


@pytest.fixture(scope="module")
def window() -> Window:
    """The only window of 8 s with a gap of 3 s."""
    made = arm(
        3,
        imus="wrist,upper-arm",
        protocol="random",
        duration_s=9.0,
        occlusion_lengths_s=(3.0,),
        occlusion_every_s=6.0,
    )
    return first_window(made.recording, made.calibration)


def optimum(window: Window) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    graph, values, _ = build(window)
    return graph, gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()


def test_both_bodies_meet_in_the_elbow_and_the_upper_one_in_the_shoulder(window: Window) -> None:
    (run,) = window.further
    assert (run.first, len(run.start.p)) == (0, len(window.t))
    _, values = optimum(window)
    on_forearm, on_upper = values.atPoint3(L(ELBOW)), values.atPoint3(M(ELBOW))
    for node in range(len(window.t)):
        elbow = values.atPoint3(E(node))
        assert np.linalg.norm(values.atPose3(X(node)).transformFrom(on_forearm) - elbow) < 0.005
        assert np.linalg.norm(values.atPose3(Y(node)).transformFrom(on_upper) - elbow) < 0.005
    for knot, node in enumerate(window.shoulder.node.tolist()):
        end = values.atPose3(Y(node)).transformFrom(values.atPoint3(M(SHOULDER)))
        assert np.linalg.norm(end - values.atPoint3(S(knot))) < 0.015


def test_the_second_imu_leaves_less_open(window: Window) -> None:
    """In the middle of the gap, and nowhere more than without it."""
    both = solve(window, with_covariance=True)
    alone = solve(replace(window, bodies=(window.forearm,)), with_covariance=True)
    with_two, with_one = (
        np.einsum("nii->n", each[:, :3, :3])
        for each in (both.forearm.pose_covariance, alone.forearm.pose_covariance)
    )
    assert (with_two < 1.02 * with_one).all()
    middle = np.isfinite(window.velocity_change).nonzero()[0].mean().astype(int)
    assert with_two[middle] < 0.5 * with_one[middle]


def test_all_that_windows_share(window: Window) -> None:
    layout = window.priors.layout
    keys = shared_keys(window, bias_of_intervals(window))
    assert layout.further and len(set(keys)) == len(keys)
    assert {M(ELBOW), M(SHOULDER)} <= set(keys)
    found = solve(window, with_covariance=False)
    assert found.shared.shape == (layout.size,)
    assert layout.constants.stop == layout.bias_of(UPPER_ARM.name).start
    before = np.diag(window.priors.shared.covariance)
    for rows in (*layout.levers(UPPER_ARM.name).values(), layout.bias_of(UPPER_ARM.name)):
        off = (found.shared - window.priors.shared.mean)[rows] / np.sqrt(before[rows])
        assert np.abs(off).max() < 4.0
