"""The prior on gravity, a Gaussian that stays, where GTSAM's two axes across gravity turn on the way."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import G
from scenes import arm, last_pass

from smoother.graph import optimise as module
from smoother.graph.build import bias_of_intervals, build
from smoother.graph.optimise import optimise
from smoother.graph.shared_prior import gravity_axes, have_turned
from smoother.graph.solve import _message
from smoother.window.problem import Window
from smoother.window.shared import Gaussian

#: Of the prior, along its two axes and as correlation: anything but round, and tied to the accelerometer.
SIGMA_RAD, CORRELATION = (np.radians(5.0), np.radians(0.7)), 0.8


@pytest.fixture(scope="module")
def window() -> Window:
    """Its prior has gravity where GTSAM's axes are others than at the solution."""
    made = arm(3, protocol="random", duration_s=8.0, occlusion_lengths_s=(2.0,), occlusion_every_s=5.0)
    window = last_pass(made.recording, made.calibration)[0].window
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
    off = _message(values, None, window, bias_of_intervals(window)).shared.mean - shared.mean
    return float(error + 0.5 * off @ np.linalg.solve(shared.covariance, off))


def _slope_sigmas(optimum: module.Optimum, window: Window) -> float:
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


def test_the_prior_is_that_which_was_stated(window: Window, monkeypatch: pytest.MonkeyPatch) -> None:
    graph, values, groups = build(window)
    right = optimise(graph, values, groups, window, 1e-10)
    assert have_turned(gravity_axes(values), gravity_axes(right.values))
    assert _slope_sigmas(right, window) < 0.02
    monkeypatch.setattr(module, "MOST_TURNS", 0)
    wrong = optimise(graph, values, groups, window, 1e-10)
    assert _slope_sigmas(wrong, window) > 0.1  # what the test would show without
