"""A Gaussian on gravity means the same in whatever axes GTSAM counts its changes, which turn on the way."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import G, L
from scenes import arm, first_window

from smoother.graph.build import build
from smoother.graph.optimise import Optimum, optimise
from smoother.graph.shared_prior import gaussian_factor, gravity_axes, have_turned, turned_with_axes
from smoother.graph.solved import SolvedWindow
from smoother.window.problem import Window
from smoother.window.shared import Gaussian

#: Known far better to the left and right than to the front and back, and tied to a lever arm.
SPREAD_K = np.diag([0.001, 0.0, 0.03]) ** 2
BOUND = np.array([[0.0], [0.0], [0.015]]) @ np.array([[0.005, 0.002, -0.005]])


def values(down: np.ndarray) -> gtsam.Values:
    here = gtsam.Values()
    here.insert(G(0), gtsam.Unit3(down))
    here.insert(L(2), np.array([0.1, 0.0, 0.02]))
    return here


def known(at: gtsam.Values) -> gtsam.LinearContainerFactor:
    """A joint Gaussian of gravity and a lever arm, in the axes that there are."""
    covariance = np.zeros((5, 5))
    to_K = gravity_axes(at)
    covariance[:2, :2], covariance[2:, 2:] = to_K.T @ SPREAD_K @ to_K, np.eye(3) * 0.01**2
    covariance[:2, 2:] = to_K.T @ BOUND
    covariance[2:, :2] = covariance[:2, 2:].T
    information = np.linalg.inv(covariance)
    return gtsam.LinearContainerFactor(
        gaussian_factor([G(0), L(2)], [slice(0, 2), slice(2, 5)], information), at
    )


def covariance_K(factors: list[gtsam.NonlinearFactor], at: gtsam.Values) -> np.ndarray:
    """Covariance (6, 6) of down and lever arm in {K}."""
    graph, ordering = gtsam.NonlinearFactorGraph(), gtsam.Ordering()
    for factor in factors:
        graph.add(factor)
    for key in (G(0), L(2)):
        ordering.push_back(key)
    information, _ = graph.linearize(at).hessian(ordering)
    to_K = np.zeros((6, 5))
    to_K[:3, :2], to_K[3:, 2:] = gravity_axes(at), np.eye(3)
    return np.asarray(to_K @ np.linalg.inv(information) @ to_K.T)


BEFORE, AFTER = np.array([0.001, -1.0, 0.002]), np.array([0.002, -1.0, 0.001])


def test_a_gaussian_turns_with_them() -> None:
    factor, before, after = known(values(BEFORE)), values(BEFORE), values(AFTER)
    expected = covariance_K([factor], before)
    # without, what was known of one direction counts for the other
    wrong = covariance_K([factor], after)
    assert np.diag(wrong)[[0, 2]] == pytest.approx(np.diag(expected)[[2, 0]], rel=0.01)
    (turned,) = turned_with_axes([factor], after, gravity_axes(before))
    np.testing.assert_allclose(
        covariance_K([turned], after), expected, atol=2e-3 * expected.max()
    )  # down is another by 1.4 mrad


#: Of the prior, along its two axes and as correlation: anything but round, and tied to the accelerometer.
SIGMA_RAD, CORRELATION = (np.radians(5.0), np.radians(0.7)), 0.8


@pytest.fixture(scope="module")
def window() -> Window:
    """Its prior has gravity where GTSAM's axes are others than at the solution."""
    made = arm(3, protocol="random", duration_s=8.0, occlusion_lengths_s=(2.0,), occlusion_every_s=5.0)
    window = first_window(made.recording, made.calibration)
    layout, shared = window.priors.layout, window.priors.shared
    down = optimise(*build(window), window, 1e-8).values.atUnit3(G(0)).point3()
    across, along = (k for k in range(3) if k != int(np.argmax(np.abs(down))))
    swapped = down.copy()
    swapped[[across, along]] = down[[along, across]]
    mean, covariance = shared.mean.copy(), shared.covariance.copy()
    mean[layout.gravity] = layout.gravity_axes @ swapped
    rows = [layout.gravity.start, layout.gravity.start + 1, 0]
    sigma = np.array([*SIGMA_RAD, np.sqrt(covariance[0, 0])])
    ties = np.eye(3)
    ties[0, 2] = ties[2, 0] = CORRELATION
    covariance[rows, :] = covariance[:, rows] = 0.0
    covariance[np.ix_(rows, rows)] = ties * sigma * sigma[:, None]
    return replace(window, priors=replace(window.priors, shared=Gaussian(mean, covariance)))


def _cost(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, window: Window) -> float:
    """The graph's error with the prior of the window as it is stated, in the shared vector's coordinates."""
    factors = [graph.at(i) for i in range(graph.size())]
    error = sum(each.error(values) for each in factors if not isinstance(each, gtsam.LinearContainerFactor))
    shared = window.priors.shared
    off = SolvedWindow(window, graph, values, []).shared - shared.mean
    return float(error + 0.5 * off @ np.linalg.solve(shared.covariance, off))


def _slope_sigmas(optimum: Optimum, window: Window) -> float:
    """How far, in sigmas of the data and prior on it, gravity is from where the cost is lowest."""
    worst, step = 0.0, 1e-4
    for axis in np.eye(2):
        cost = []
        for sign in (-1.0, 0.0, 1.0):
            moved = gtsam.Values(optimum.values)
            moved.update(G(0), optimum.values.atUnit3(G(0)).retract(sign * step * axis))
            cost.append(_cost(optimum.graph, moved, window))
        slope, curvature = (cost[2] - cost[0]) / (2 * step), (cost[2] - 2 * cost[1] + cost[0]) / step**2
        worst = max(worst, abs(slope) / np.sqrt(curvature))
    return worst


def test_the_prior_is_that_which_was_stated(window: Window) -> None:
    """Not so where `optimise` leaves the axes as they turn: 0.1 sigma and more."""
    graph, values, groups = build(window)
    right = optimise(graph, values, groups, window, 1e-10)
    assert have_turned(gravity_axes(values), gravity_axes(right.values))
    assert _slope_sigmas(right, window) < 0.02
