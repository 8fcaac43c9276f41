"""Shifts of blocks of camera samples, steps of camera and mounting: found where they are, nowhere else."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scenes import arm, first_window

from smoother.graph.build import build
from smoother.graph.changes import SLOW_M, Cells, block_columns, block_shifts
from smoother.graph.solve import optimise_window, solution_of
from smoother.graph.solved import SolvedWindow
from smoother.window.problem import Window


@pytest.fixture(scope="module")
def window() -> Window:
    """Of 12 s with a gap of 2 s."""
    made = arm(3, protocol="random", duration_s=12.0, occlusion_lengths_s=(2.0,), occlusion_every_s=6.0)
    return first_window(made.recording, made.calibration)


def shifted(window: Window, start_s: float, end_s: float, shift_m: np.ndarray) -> Window:
    """The forearm's samples between two times, moved."""
    moved = tuple(
        replace(
            each,
            position=each.position
            + np.where(((each.t_s >= start_s) & (each.t_s <= end_s))[:, None], shift_m, 0.0),
        )
        for each in window.joint_measurements
    )
    return replace(window, joint_measurements=moved)


@pytest.mark.slow
def test_shifts_are_those_of_dense_least_squares(window: Window) -> None:
    window = replace(window, considered=None)
    graph, values, groups = build(window)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    solved, cells = SolvedWindow(window, graph, values, groups), Cells.of_window(window)
    columns = block_columns(solved, cells)
    system = solved.system([columns])
    A = system.jacobian.toarray()
    singles = {
        (float(start), float(end)): number
        for number, (start, end) in enumerate(zip(cells.start_s, cells.end_s, strict=True))
    }
    compared = 0
    for shift in block_shifts(system, None, cells):
        number = singles.get((shift.start_s, shift.end_s))
        if number is None:
            continue
        wide = np.column_stack([A, columns[:, 3 * number : 3 * number + 3]])
        normal = wide.T @ wide
        expected = np.linalg.solve(normal, wide.T @ system.jacobian.rhs)[-3:]
        covariance = np.linalg.inv(normal)[-3:, -3:] + np.diag(SLOW_M**2)
        # a ridge of 1e-6 of the information keeps what nothing is known of finite
        np.testing.assert_allclose(shift.shift_m, expected, atol=1e-4 + 1e-3 * np.abs(expected).max())
        score = expected @ np.linalg.solve(covariance, expected) / 3.0
        assert shift.score == pytest.approx(score, rel=0.02, abs=1e-3)
        compared += 1
    assert compared >= 5


def test_a_sound_window_has_no_suspicious_block(window: Window) -> None:
    shifts = solution_of(optimise_window(window), with_covariance=True, with_blocks=True).shifts
    assert len(shifts) > 10
    assert max(shift.score for shift in shifts) < 1.0


def test_a_block_that_was_moved_is_found_with_its_direction(window: Window) -> None:
    gap = np.flatnonzero(np.isfinite(window.velocity_change))
    start_s = float(window.t[gap[-1] + 1])
    moved = np.array([0.0, 0.0, -0.18])
    optimised = optimise_window(shifted(window, start_s, start_s + 1.5, moved))
    shifts = solution_of(optimised, with_covariance=True, with_blocks=True).shifts
    worst = max(shifts, key=lambda shift: shift.score)
    assert worst.score > 3.0
    assert start_s - 0.1 < worst.end_s
    assert worst.start_s < start_s + 1.6


def test_pieces_end_at_gaps_and_jumps(window: Window) -> None:
    measured = window.joint_measurements[0]
    gap = np.flatnonzero(np.isfinite(window.velocity_change))
    first_s, last_s = float(window.t[gap[0]]), float(window.t[gap[-1] + 1])
    cells = Cells.of_window(window)
    assert not ((cells.start_s < first_s - 1e-6) & (cells.end_s > last_s + 1e-6)).any()
    jump_s = float(measured.t_s[len(measured.t_s) // 4])
    cut = Cells.of_window(shifted(window, jump_s, jump_s + 0.5, np.array([0.3, 0.0, 0.0])))
    assert np.isclose(cut.start_s, jump_s).any()
    assert len(np.unique(cut.segment)) > len(np.unique(cells.segment))


def test_times_outside_all_pieces_belong_to_none() -> None:
    cells = Cells(np.array([0.0, 2.0]), np.array([1.0, 3.0]), np.array([0, 1]), np.zeros(2, int))
    assert cells.of(np.array([-0.5, 0.0, 1.0, 1.5, 2.5, 3.5])).tolist() == [-1, 0, 0, -1, 1, -1]
