"""Drawn motions of a window against GTSAM's own covariance: exactly, as draws are linear in their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import S, V, X, Y
from scenes import arm, section_windows
from small_window import UPPER_FIRST, UPPER_NODES, small_window

import smoother.graph.build
import smoother.graph.sampling
import smoother.graph.solve
from smoother.array_types import FloatArray
from smoother.graph.build import build
from smoother.graph.sampling import sample_window
from smoother.graph.solve import solve
from smoother.graph.solved import SolvedWindow
from smoother.window.draw_plan import DrawPlan, samples_apart
from smoother.window.problem import Window


@dataclass(frozen=True)
class BasisPlan(DrawPlan):
    """In place of random numbers: the n-th draw has a one as the n-th number and zeros as all others.

    Sums over draws are then what averages over endless draws would be.
    """

    places: dict[tuple[int, int], slice] = field(default_factory=dict)

    def _normals(self, stream: int, numbers: Sequence[int], width: int) -> FloatArray:
        normals = np.zeros((len(numbers), self.count, width))
        for number, own in zip(numbers, normals, strict=True):
            start = max((place.stop for place in self.places.values()), default=0)
            place = self.places.setdefault((stream, number), slice(start, start + width))
            assert place.stop - place.start == width and place.stop <= self.count
            own[place] = np.eye(width)
        return normals


def basis(window: Window) -> BasisPlan:
    # any covariance will do in place of what all windows say: a window's own is what comes out
    return BasisPlan(700, 0, "right", 4, 0.5 * window.priors.shared.covariance, window.considered)


def same(drawn: FloatArray, stated: FloatArray) -> None:
    scale = np.sqrt(np.diag(stated))
    drawn = drawn.reshape(len(drawn), -1)
    np.testing.assert_allclose(
        drawn.T @ drawn / scale / scale[:, None], stated / scale / scale[:, None], atol=1e-5
    )


def test_covariances_and_those_between_times_are_those_of_gtsam(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of both IMUs, three biases of each, and of the shoulder, in a gap and outside."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", 0.18)
    monkeypatch.setattr(smoother.graph.sampling, "_SLICE_S", 0.05)
    window = replace(small_window()[0], considered=None)
    graph, values, groups = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    solved = SolvedWindow(window, graph, values, groups)
    assert solved.biases[-1] == 2
    draws = sample_window(solved, solved.system(), basis(window), np.zeros((3, 3)))
    upper = np.arange(UPPER_FIRST, UPPER_FIRST + UPPER_NODES)
    nodes, knots = [0, 3, 5, 9], [1, 2, 3]
    keys = [X(i) for i in nodes] + [V(i) for i in nodes] + [S(k) for k in knots] + [Y(i) for i in upper]
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys)
    turns = {key: slice(0, 3) for key in keys[-UPPER_NODES:]}  # of the upper arm turns alone are drawn
    all_of = slice(None)
    expected = np.block(
        [[joint.at(a, b)[turns.get(a, all_of), turns.get(b, all_of)] for b in keys] for a in keys]
    )

    def in_body(turned: FloatArray, key: int) -> FloatArray:
        return np.asarray(turned @ values.atPose3(key).rotation().matrix())

    parts = [
        np.concatenate([in_body(drawn[:, i], X(i)) for drawn in (draws.rotation, draws.position)], axis=1)
        for i in nodes
    ]
    parts += [draws.velocity[:, i] for i in nodes]
    parts += [draws.shoulder[:, window.shoulder.node[k]] for k in knots]
    parts += [in_body(draws.turns["upper_arm"][:, i], Y(i)) for i in upper]
    same(np.concatenate(parts, axis=1), expected)
    assert np.isnan(draws.turns["upper_arm"][:, np.setdiff1d(np.arange(len(window.t)), upper)]).all()


def test_they_have_the_covariance_that_the_window_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """Considered errors included, at nodes whose covariance is computed."""
    for name in ("COVARIANCE_S", "COVARIANCE_NEAR_S", "SHOULDER_COVARIANCE_S", "CHAIN_COVARIANCE_S"):
        monkeypatch.setattr(smoother.graph.solve, name, 1e-6)
    window = small_window()[0]
    solution = solve(window, with_covariance=True, plan=basis(window))
    draws, forearm = solution.draws, solution.forearm
    for node in range(len(window.t)):
        pose = np.concatenate([draws.position[:, node], draws.rotation[:, node]], axis=1)
        same(pose, forearm.pose_covariance[node])
        same(draws.velocity[:, node], forearm.velocity_covariance[node])
    for node in window.shoulder.node:
        same(draws.shoulder[:, node], solution.shoulder_covariance[node])


def test_neighbouring_sections_draw_the_same_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that their blend keeps its variance: positions nearly, turns for the most part."""
    monkeypatch.setattr("smoother.recovery.sections.SECTION_S", 10.0)
    made = arm(3, protocol="random", duration_s=20.0, occlusion_lengths_s=(2.0,), occlusion_every_s=6.0)
    one, two = (job.window for job in section_windows(made.recording, made.calibration))
    plan = DrawPlan(100, 5, "right", 4, one.priors.shared.covariance, one.considered)
    first, second = (solve(each, with_covariance=True, plan=plan).draws for each in (one, two))
    there = np.abs(two.t - two.core_start_s) < 0.5
    at = np.searchsorted(one.t, two.t[there] - 1e-6)
    for name, least in (("position", 0.97), ("velocity", 0.93), ("rotation", 0.8)):
        a, b = getattr(first, name)[:, at], getattr(second, name)[:, there]
        correlation = (a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum())
        assert correlation > least, (name, correlation)


@pytest.mark.parametrize(("rate", "every"), [(100.0, 4), (25.0, 1), (60.0, 2), (1000.0, 40), (10.0, 1)])
def test_drawn_times_are_25_a_second_or_more(rate: float, every: int) -> None:
    assert samples_apart(np.arange(300) / rate) == samples_apart(np.arange(500_000) / rate) == every
    assert samples_apart(np.zeros(1)) == 1
