"""The graph of a window with two IMUs: the elbow is one point, and its covariance is that of the samples."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import C, E, L, M, S, W, X, Y
from scenes import arm, last_pass

from smoother.body import UPPER_ARM
from smoother.graph.build import bias_of_intervals, build, node_of_variables
from smoother.graph.linear_system import LinearSystem
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
    (job,) = last_pass(made.recording, made.calibration)
    return job.window


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
    assert window.shoulder is not None
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


def test_the_answer_covers_the_nodes_with_samples(window: Window) -> None:
    """An IMU that pauses: orientation, position and covariance where it has samples, nan elsewhere."""
    (run,) = window.further
    half = len(window.t) // 2
    first = run.increments.first
    increments = replace(
        run.increments,
        acc=run.increments.acc[: first[half]],
        gyro=run.increments.gyro[: first[half]],
        h=run.increments.h[: first[half]],
        first=first[: half + 1],
        velocity_error=run.increments.velocity_error[:half],
    )
    states = replace(
        run.start, R=run.start.R[: half + 1], p=run.start.p[: half + 1], v=run.start.v[: half + 1]
    )
    part = replace(run, start=states, increments=increments, attitude_node=min(run.attitude_node, half))
    part = replace(part, attitude=states.R[part.attitude_node])
    _, upper = solve(replace(window, bodies=(window.forearm, part)), with_covariance=True).bodies
    assert upper.pose_covariance is not None
    np.testing.assert_array_equal(upper.known, np.arange(len(window.t)) <= half)
    for values in (upper.states.p, upper.states.v, upper.pose_covariance):
        finite = np.isfinite(values).reshape(len(values), -1)
        np.testing.assert_array_equal(finite.all(axis=1), upper.known)
        np.testing.assert_array_equal(finite.any(axis=1), upper.known)


def test_the_linear_system_knows_its_variables(window: Window) -> None:
    graph, values = optimum(window)
    system, reference = LinearSystem(graph, values, node_of_variables(window)), gtsam.Marginals(graph, values)
    for key in (Y(0), W(3), E(5), X(4)):
        expected = reference.marginalCovariance(key)
        np.testing.assert_allclose(system.covariances([key])[0], expected, atol=1e-6 * np.abs(expected).max())
    for key in (C(0), M(ELBOW)):
        expected = reference.marginalCovariance(key)
        np.testing.assert_allclose(
            system.shared_covariance([key]), expected, atol=1e-6 * np.abs(expected).max()
        )


def test_the_message_holds_all_that_windows_share(window: Window) -> None:
    layout = window.priors.layout
    keys = shared_keys(window, bias_of_intervals(window))
    assert layout.further and len(set(keys)) == len(keys)
    assert {M(ELBOW), M(SHOULDER)} <= set(keys)
    shared = solve(window, with_covariance=False).message.shared
    assert (
        shared.mean.shape == (layout.size,) and layout.constants.stop == layout.bias_of(UPPER_ARM.name).start
    )
    before, after = (np.diag(each.covariance) for each in (window.priors.shared, shared))
    for rows in (*layout.levers(UPPER_ARM.name).values(), layout.bias_of(UPPER_ARM.name)):
        assert (after[rows] < 1.0001 * before[rows]).all()
        off = (shared.mean - window.priors.shared.mean)[rows] / np.sqrt(before[rows])
        assert np.abs(off).max() < 4.0
