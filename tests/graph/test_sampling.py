"""Drawn motions of a window against GTSAM's own covariance: exactly, as draws are linear in their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from unittest.mock import patch

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import S, V, X, Y
from scenes import arm, first_window, section_windows
from small_window import UPPER_FIRST, UPPER_NODES, small_window

import smoother.graph.build
import smoother.graph.sampling
import smoother.graph.solve
from smoother.array_types import FloatArray
from smoother.graph.build import build
from smoother.graph.sampling import sample_window
from smoother.graph.solve import solve
from smoother.graph.solved import SolvedWindow
from smoother.window.draw_plan import DrawPlan
from smoother.window.problem import Window
from smoother.window.solution import WindowDraws

COUNT = 2200


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


@pytest.fixture(scope="module")
def window() -> Window:
    """Of 6 s with a gap of 1.5 s, and with errors that are considered."""
    made = arm(3, protocol="random", duration_s=6.0, occlusion_lengths_s=(1.5,), occlusion_every_s=4.0)
    return first_window(made.recording, made.calibration)


def basis(window: Window) -> BasisPlan:
    # any covariance will do in place of what all windows say: a window's own is what comes out
    pooled = 0.5 * window.priors.shared.covariance
    return BasisPlan(COUNT, 0, "right", 4, pooled, window.considered)


def optimum(window: Window) -> SolvedWindow:
    graph, values, groups = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return SolvedWindow(window, graph, values, groups)


def covariance(draws: FloatArray, others: FloatArray | None = None) -> FloatArray:
    return draws.T @ (draws if others is None else others)


def test_covariances_and_those_between_times_are_those_of_gtsam(window: Window) -> None:
    """Poses half a second apart, velocities and the shoulder, in the gap and outside."""
    solved = optimum(replace(window, considered=None))
    graph, values = solved.graph, solved.values
    plan = replace(basis(window), considered=None)
    draws = sample_window(solved, solved.system(), plan, np.zeros((3, 3)))
    reference = gtsam.Marginals(graph, values)
    in_gap = int(np.flatnonzero(np.isfinite(window.velocity_change))[3])
    for i in (4, in_gap):
        j = int(np.searchsorted(window.t, window.t[i] + 0.5))
        knot = int(np.searchsorted(window.shoulder.node, i))
        keys = [X(i), X(j), V(i), S(knot)]
        joint = reference.jointMarginalCovariance(keys)
        expected = np.block([[joint.at(a, b) for b in keys] for a in keys])
        R = [values.atPose3(key).rotation().matrix() for key in keys[:2]]
        drawn = np.concatenate(
            [
                *(body(draws, node, of_node) for node, of_node in zip((i, j), R, strict=True)),
                draws.velocity[:, i],
                draws.shoulder[:, window.shoulder.node[knot]],
            ],
            axis=1,
        )
        scale = np.sqrt(np.diag(expected))
        correlation = expected / scale / scale[:, None]
        assert np.abs(correlation[:6, 6:12]).max() > 0.5  # there is something to get right
        # two eliminations of one system, as tests/graph/test_linear_system.py has it
        np.testing.assert_allclose(covariance(drawn) / scale / scale[:, None], correlation, atol=1e-5)


def test_both_imus_and_their_biases(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small window with an IMU on the upper arm and three biases of each, drawn one given the others."""
    monkeypatch.setattr(smoother.graph.build, "BIAS_LENGTH_S", 0.18)
    monkeypatch.setattr(smoother.graph.sampling, "_SLICE_S", 0.05)
    window = replace(small_window()[0], considered=None)
    solved = optimum(window)
    graph, values = solved.graph, solved.values
    assert solved.biases[-1] == 2
    draws = sample_window(solved, solved.system(), basis(window), np.zeros((3, 3)))
    rows = range(UPPER_FIRST, UPPER_FIRST + UPPER_NODES)
    keys = [key for i in rows for key in (Y(i), V(i))]
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys)
    expected = np.block([[joint.at(a, b)[:3, :3] for b in keys] for a in keys])
    turned = draws.turns["upper_arm"]
    assert turned.shape[2] == 3
    drawn = np.concatenate(
        [
            each
            for i in rows
            for each in (
                turned[:, i] @ values.atPose3(Y(i)).rotation().matrix(),
                draws.velocity[:, i],
            )
        ],
        axis=1,
    )
    same(covariance(drawn), expected)
    hidden = np.setdiff1d(np.arange(len(window.t)), rows)
    assert np.isnan(turned[:, hidden]).all()


def body(draws: WindowDraws, node: int, R: FloatArray) -> FloatArray:
    """Back to GTSAM's (rotation, translation) in the body's axes."""
    return np.concatenate([draws.rotation[:, node] @ R, draws.position[:, node] @ R], axis=1)


def test_they_have_the_covariance_that_the_window_states(window: Window) -> None:
    """Considered errors included, at nodes whose covariance is computed."""
    assert window.considered is not None
    with patch.multiple(smoother.graph.solve, COVARIANCE_S=1e-6, SHOULDER_COVARIANCE_S=1e-6):
        solution = solve(window, with_covariance=True, plan=basis(window))
    draws = solution.draws
    for node in range(0, len(window.t), 5):
        pose = np.concatenate([draws.position[:, node], draws.rotation[:, node]], axis=1)
        same(covariance(pose), solution.forearm.pose_covariance[node])
        same(covariance(draws.velocity[:, node]), solution.forearm.velocity_covariance[node])
    for node in window.shoulder.node[::5]:
        same(covariance(draws.shoulder[:, node]), solution.shoulder_covariance[node])


def same(drawn: FloatArray, stated: FloatArray) -> None:
    scale = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(drawn / scale / scale[:, None], stated / scale / scale[:, None], atol=1e-5)


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
