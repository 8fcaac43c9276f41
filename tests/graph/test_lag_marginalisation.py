"""What is eliminated goes on counting: the rest of a graph has the optimum and the covariance that it had."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from smoother.graph.lag_marginalisation import marginalise, split

UNIT = gtsam.noiseModel.Isotropic.Sigma


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
