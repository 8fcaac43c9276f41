"""An iteration of a lag window is Gauss-Newton's; what is eliminated goes on counting."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from smoother.graph.lag_elimination import in_order, iterate, marginalise, split

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


def walk() -> tuple[list[gtsam.NonlinearFactor], gtsam.Values]:
    """Four points in a row, each seen, and a fifth that nobody is tied to: linear, so all is exact."""
    rng, factors, values = np.random.default_rng(3), [], gtsam.Values()
    for k in range(5):
        factors.append(gtsam.PriorFactorPoint3(S(k), rng.normal(0.0, 1.0, 3), UNIT(3, 0.3 + 0.1 * k)))
        if 0 < k < 4:
            factors.append(gtsam.BetweenFactorPoint3(S(k - 1), S(k), rng.normal(0.0, 0.1, 3), UNIT(3, 0.1)))
        values.insert(S(k), rng.normal(0.0, 1.0, 3))
    return factors, values


def graph_of(factors: list[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    return graph


@pytest.mark.parametrize("leaving", [[S(0)], [S(0), S(1)], [S(2)], [S(4)], [S(1), S(3), S(4)]])
def test_the_rest_is_what_it_was(leaving: list[int]) -> None:
    factors, values = walk()
    whole = graph_of(factors)
    optimum = gtsam.GaussNewtonOptimizer(whole, values).optimize()
    before = gtsam.Marginals(whole, optimum)
    rest = marginalise(factors, values, leaving)
    assert not set(leaving) & set(values.keys())
    assert len(factors) == 8, "the list that was given stays"
    left = graph_of(rest)
    after = gtsam.GaussNewtonOptimizer(left, values).optimize()
    assert sorted(after.keys()) == sorted(set(optimum.keys()) - set(leaving))
    covariances = gtsam.Marginals(left, after)
    for key in set(optimum.keys()) - set(leaving):
        np.testing.assert_allclose(after.atPoint3(key), optimum.atPoint3(key), atol=1e-9)
        np.testing.assert_allclose(
            covariances.marginalCovariance(key), before.marginalCovariance(key), rtol=1e-9, atol=1e-12
        )


def test_what_does_not_touch_stays_as_it_is() -> None:
    factors, values = walk()
    rest = marginalise(factors, values, [S(0)])
    untouched = [factor for factor in factors if S(0) not in set(factor.keys())]
    assert all(a is b for a, b in zip(rest, untouched, strict=False)) and len(rest) == len(untouched) + 1
    assert isinstance(rest[-1], gtsam.LinearContainerFactor)
    assert split(factors, set()) == ([], factors)


def test_every_kind_of_variable_may_stay() -> None:
    """A pose leaves; what it was tied to are all variables that a lag window has."""
    factors, values = [], gtsam.Values()
    for k in range(2):
        values.insert(
            X(k), gtsam.Pose3(gtsam.Rot3.Expmap([0.1 * k, 0.2, 0.0]), np.array([0.1 * k, 0.0, 1.0]))
        )
        values.insert(V(k), np.zeros(3))
        factors.append(gtsam.PriorFactorPose3(X(k), values.atPose3(X(k)), UNIT(6, 0.1)))
        factors.append(gtsam.PriorFactorVector(V(k), np.zeros(3), UNIT(3, 0.1)))
    values.insert(B(0), gtsam.imuBias.ConstantBias())
    values.insert(G(0), gtsam.Unit3(np.array([0.0, 0.1, -1.0])))
    values.insert(L(2), np.array([0.1, 0.0, 0.0]))
    values.insert(S(0), np.array([0.0, 0.3, 1.0]))
    values.insert(U(0), 0.0)
    params = gtsam.PreintegrationParams(np.array([0.0, 0.0, -9.81]))
    pim = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
    pim.integrateMeasurement(np.array([0.0, 1.0, 9.7]), np.array([0.5, 0.0, 0.1]), 0.1)
    elbow = gtsam.Pose3(gtsam.Rot3(), np.array([-0.1, 0.0, 0.0]))
    factors += [
        gtsam.ImuFactorWithGravityDirection(X(0), V(0), X(1), V(1), B(0), G(0), pim, 9.81),
        gtsam.GPSFactorArmCalib(X(0), L(2), np.array([0.1, 0.0, 1.0]), UNIT(3, 0.01)),
        gtsam.RangeFactorWithTransformBias3D(X(0), S(0), U(0), 0.3, UNIT(1, 0.01), elbow),
        gtsam.PriorFactorConstantBias(B(0), gtsam.imuBias.ConstantBias(), UNIT(6, 0.1)),
        gtsam.PriorFactorPoint3(L(2), np.array([0.1, 0.0, 0.0]), UNIT(3, 0.02)),
        gtsam.PriorFactorPoint3(S(0), np.array([0.0, 0.3, 1.0]), UNIT(3, 0.05)),
        gtsam.PriorFactorDouble(U(0), 0.0, UNIT(1, 0.05)),
    ]
    before = gtsam.Marginals(graph_of(factors), values)
    expected = {key: before.marginalCovariance(key) for key in (X(1), V(1), B(0), L(2), S(0), U(0))}
    step = graph_of(factors).linearize(values).optimize()
    rest = graph_of(marginalise(factors, values, [X(0), V(0)]))
    linear = rest.linearize(values)
    after = gtsam.Marginals(linear, linear.optimize())
    for key, covariance in expected.items():
        np.testing.assert_allclose(after.marginalCovariance(key), covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(linear.optimize().at(key), step.at(key), atol=1e-9)
