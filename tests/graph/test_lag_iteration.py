"""One iteration of a lag window is Gauss-Newton's, and its covariance GTSAM's own."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, G, L, S, V, X

from smoother.graph.lag_iteration import in_order, iterate

UNIT = gtsam.noiseModel.Isotropic.Sigma


def chain() -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Three poses that turn, a point seen from each by a lever arm, wrong values at first."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    lever, rng = np.array([0.1, 0.02, 0.0]), np.random.default_rng(1)
    poses = [
        gtsam.Pose3(gtsam.Rot3.Expmap([0.3 * k, 0.1, 0.2]), np.array([0.2 * k, 0.1, 1.0])) for k in range(3)
    ]
    for k, pose in enumerate(poses):
        values.insert(X(k), pose.retract(rng.normal(0.0, 0.05, 6)))
        graph.add(gtsam.GPSFactorArmCalib(X(k), L(0), pose.transformFrom(lever), UNIT(3, 0.01)))
        if k:
            graph.add(gtsam.BetweenFactorPose3(X(k - 1), X(k), poses[k - 1].between(pose), UNIT(6, 0.02)))
    graph.add(gtsam.PriorFactorPose3(X(0), poses[0], UNIT(6, 0.1)))
    graph.add(gtsam.PriorFactorPoint3(L(0), lever, UNIT(3, 0.02)))
    values.insert(L(0), lever + 0.03)
    return graph, values


TIMES = {0: 0.0, 1: 0.1, 2: 0.2}


@pytest.mark.parametrize("asked", [[X(2)], [X(2), L(0), X(0)], [X(0), X(1), X(2), L(0)]])
def test_step_and_covariance_are_those_of_gtsam(asked: list[int]) -> None:
    graph, values = chain()
    iteration = iterate(graph, values, asked, TIMES)
    expected = values.retract(graph.linearize(values).optimize())
    for k in range(3):
        assert iteration.values.atPose3(X(k)).equals(expected.atPose3(X(k)), 1e-9)
    np.testing.assert_allclose(iteration.values.atPoint3(L(0)), expected.atPoint3(L(0)), atol=1e-9)
    marginals = gtsam.Marginals(graph, values)
    for key in asked:
        rows = iteration.columns[key]
        np.testing.assert_allclose(
            iteration.covariance[rows, rows], marginals.marginalCovariance(key), rtol=1e-6, atol=1e-10
        )
    if len(asked) > 1:
        first, second = iteration.columns[asked[0]], iteration.columns[asked[1]]
        joint = marginals.jointMarginalCovariance(gtsam.KeyVector(asked[:2]))
        np.testing.assert_allclose(
            iteration.covariance[first, second], joint.at(asked[0], asked[1]), rtol=1e-6, atol=1e-10
        )


def test_it_says_how_far_a_pose_moved() -> None:
    graph, values = chain()
    iteration = iterate(graph, values, [X(1)], TIMES)
    moved_m = values.atPose3(X(1)).range(iteration.values.atPose3(X(1)).translation())
    assert iteration.moved_m(X(1)) == pytest.approx(moved_m, rel=0.05)  # a chord for an arc
    settled = iteration.values
    for _ in range(5):
        settled = iterate(graph, settled, [X(1)], TIMES).values
    assert iterate(graph, settled, [X(1)], TIMES).moved_m(X(1)) < 1e-7


def test_what_nothing_holds_is_refused() -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    values.insert(X(0), gtsam.Pose3())
    graph.add(gtsam.GPSFactor(X(0), np.ones(3), UNIT(3, 0.01)))
    with pytest.raises(np.linalg.LinAlgError, match="left free"):
        iterate(graph, values, [X(0)], TIMES)


def test_the_order_is_that_of_time_and_what_lasts_comes_last() -> None:
    keys = [G(0), L(2), B(0), S(1), X(4), V(4), X(3), V(3), B(1)]
    # node 3 came late: it is the younger one by its number, not by its time
    times = {3: 0.2, 4: 0.1}
    assert in_order(keys, times) == [V(4), X(4), V(3), X(3), S(1), B(0), B(1), G(0), L(2)]
    assert in_order(reversed(keys), times) == in_order(keys, times)
