"""Shifts of blocks of camera samples, steps of camera and mounting: found where they are, nowhere else."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scenes import arm, first_window
from small_window import small_window

from smoother.array_types import FloatArray, IntArray
from smoother.graph import changes
from smoother.graph.build import build
from smoother.graph.changes import (
    APART_S,
    ENDS_S,
    SLOW_M,
    WIDTH,
    Cells,
    block_columns,
    block_shifts,
    moments,
    step_columns,
)
from smoother.graph.columns import constant_error_columns, stamp_columns
from smoother.graph.linear_system import Jacobian
from smoother.graph.solve import optimise_window, solution_of
from smoother.graph.solved import SolvedWindow, levers_of
from smoother.window.problem import Window
from smoother.window.shared import SIZE


@pytest.fixture(scope="module")
def window() -> Window:
    """Of 12 s with a gap of 2 s."""
    made = arm(3, protocol="random", duration_s=12.0, occlusion_lengths_s=(2.0,), occlusion_every_s=6.0)
    return first_window(made.recording, made.calibration)


def shifted(window: Window, start_s: float, end_s: float, shift_m: list[float]) -> Window:
    """The forearm's samples between two times, moved."""
    moved = []
    for each in window.joint_measurements:
        inside = ((each.t_s >= start_s) & (each.t_s <= end_s))[:, None]
        moved.append(replace(each, position=each.position + inside * np.array(shift_m)))
    return replace(window, joint_measurements=tuple(moved))


@pytest.mark.parametrize("is_considered", [False, True])
def test_shifts_are_those_of_dense_least_squares(
    is_considered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "CELL_S", 0.06)
    window = small_window()
    window = replace(window, core_start_s=window.t[0], core_end_s=window.t[-1] + 0.1)
    graph, values, groups = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    solved, cells = SolvedWindow(window, graph, values, groups), Cells.of_window(window)
    columns, considered = block_columns(solved, cells), window.considered if is_considered else None
    errors = [constant_error_columns(solved)] if is_considered else []
    system = solved.system([*errors, columns])
    A, blocks = np.hstack([system.jacobian.toarray(), *errors]), cells.blocks()
    prior = np.zeros((A.shape[1] + 3, A.shape[1] + 3))
    if considered is not None:
        prior[-SIZE - 3 : -3, -SIZE - 3 : -3] = np.linalg.inv(considered.covariance)
    assert len(blocks) > len(cells) >= 4
    for shift, block in zip(block_shifts(system, considered, cells), blocks, strict=True):
        wide = np.column_stack([A, columns.reshape(len(A), -1, 3)[:, block].sum(axis=1)])
        inverse = np.linalg.inv(wide.T @ wide + prior)
        expected = (inverse @ wide.T @ system.jacobian.rhs)[-3:]
        # a ridge of 1e-6 of the information keeps what nothing is known of finite
        np.testing.assert_allclose(shift.shift_m, expected, atol=1e-4 + 1e-3 * np.abs(expected).max())
        score = expected @ np.linalg.solve(inverse[-3:, -3:] + np.diag(SLOW_M**2), expected) / 3.0
        assert shift.score == pytest.approx(score, rel=0.02, abs=1e-3)


def test_columns_are_the_derivative_of_the_data() -> None:
    """Camera turned and moved, sensor turned and shifted, frames late, from either of two moments on.

    Frames that are late by a line between knots: each joint is shown where it was, its own velocity ago.
    """
    window, measured = small_window(upper=False), []
    for each in window.joint_measurements:  # one sample a node, with its own velocity
        _, rows = np.unique(each.node, return_index=True)
        names = ("t_s", "node", "position", "sigma_m", "shift", "velocity")
        measured.append(replace(each, **{name: getattr(each, name)[rows] for name in names}))
    noise = replace(window.noise, cauchy=1e6)  # weights that stay
    window = replace(window, considered=None, joint_measurements=tuple(measured), noise=noise)
    built = build(window)
    solved, by = SolvedWindow(window, *built), 1e-4 * np.random.default_rng(2).normal(size=(2, WIDTH))
    states, levers = solved.states["forearm"], levers_of(solved.shared, window.priors.layout)
    at_s, centre = window.t[[3, 6]] - 1e-6, states.p.mean(axis=0)
    steps = np.where((window.t > at_s[0])[:, None], by[(window.t > at_s[1]).astype(int)], 0.0)
    knots, late_s = (
        np.linspace(window.t[0] - 0.1, window.t[-1] + 0.1, 4),
        1e-4 * np.array([1.0, -2.0, 3.0, 0.5]),
    )
    lines = np.zeros_like(steps)
    lines[:, 12] = np.interp(window.t, knots, late_s)

    def shift(change: FloatArray, nodes: IntArray, joint: str, velocity: FloatArray) -> FloatArray:
        turn, move, mount, off, late = np.split(change[nodes], [3, 6, 9, 12], axis=1)
        R, lever = states.R[nodes], levers.get(joint, np.zeros(3))
        place = solved.shoulder[nodes] if joint == "shoulder" else states.p[nodes] + R @ lever
        on_arm = np.einsum("nij,nj->ni", R, np.cross(mount, lever) + off) if joint in levers else 0.0
        return np.cross(turn, place - centre) + move + on_arm + late * velocity

    for change, columns in (
        (steps, step_columns(solved, at_s) @ by.ravel()),
        (lines, stamp_columns(solved, knots) @ late_s),
    ):
        seen = [
            replace(x, position=x.position - shift(change, x.node, x.joint, states.v[x.node] + x.velocity))
            for x in window.joint_measurements
        ]
        knot, position = window.shoulder.node, window.shoulder.position
        position = position - shift(change, knot, "shoulder", np.zeros(3))
        shoulder = replace(window.shoulder, position=position)
        graph = build(replace(window, joint_measurements=tuple(seen), shoulder=shoulder)).graph
        moved = solved.jacobian.rhs - Jacobian.of(graph, built.values).rhs
        np.testing.assert_allclose(columns, moved, atol=1e-6 * np.abs(moved).max())


def test_steps_are_looked_for_in_the_middle_of_gaps_where_the_shoulder_jumps_and_now_and_then(
    window: Window,
) -> None:
    seen = window.joint_measurements
    t = np.unique(np.concatenate([each.t_s for each in seen]))
    hidden = int(np.argmax(np.diff(t)))
    (at_s,) = moments(window)
    assert at_s == pytest.approx(0.5 * (t[hidden] + t[hidden + 1]))
    long = tuple(replace(each, t_s=10.0 * each.t_s) for each in seen)
    many = moments(replace(window, joint_measurements=long, shoulder=None))
    assert len(many) > 5 and np.abs(many - 10.0 * at_s).min() < 1e-9
    assert np.diff(many).max() < 2.0 * APART_S
    assert 10.0 * t[0] + ENDS_S < many[0] and many[-1] < 10.0 * t[-1] - ENDS_S
    knots, position = window.t[window.shoulder.node], window.shoulder.position.copy()
    jump = int(np.searchsorted(knots, t[hidden] + 0.5))
    position[jump:] += 0.3
    jumped = moments(replace(window, shoulder=replace(window.shoulder, position=position)))
    assert np.abs(jumped - 0.5 * (knots[jump - 1] + knots[jump])).min() < 1e-9
    assert abs(at_s - 0.5 * (knots[jump - 1] + knots[jump])) > 0.1


def test_a_block_that_was_moved_is_found_and_none_in_a_sound_window(window: Window) -> None:
    gap = np.flatnonzero(np.isfinite(window.velocity_change))
    start_s = float(window.t[gap[-1] + 1])
    for one in (window, shifted(window, start_s, start_s + 1.5, [0.0, 0.0, -0.18])):
        shifts = solution_of(optimise_window(one), with_covariance=True, with_blocks=True).shifts
        worst = max(shifts, key=lambda shift: shift.score)
        if one is window:
            assert len(shifts) > 10 and worst.score < 1.0
        else:
            assert worst.score > 3.0 and start_s - 0.1 < worst.end_s and worst.start_s < start_s + 1.6


def test_pieces_end_at_gaps_and_jumps(window: Window) -> None:
    gap = np.flatnonzero(np.isfinite(window.velocity_change))
    first_s, last_s = float(window.t[gap[0]]), float(window.t[gap[-1] + 1])
    cells = Cells.of_window(window)
    assert not ((cells.start_s < first_s - 1e-6) & (cells.end_s > last_s + 1e-6)).any()
    assert cells.of(np.array([cells.start_s[0], 0.5 * (first_s + last_s)])).tolist() == [0, -1]
    t = window.joint_measurements[0].t_s
    jump_s = float(t[len(t) // 4])
    cut = Cells.of_window(shifted(window, jump_s, jump_s + 0.5, [0.3, 0.0, 0.0]))
    assert np.isclose(cut.start_s, jump_s).any()
    assert len(np.unique(cut.segment)) > len(np.unique(cells.segment))
