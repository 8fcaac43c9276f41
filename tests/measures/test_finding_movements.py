"""Movements, their thresholds and the repetitions of an exercise, on motions that are known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from measured_arms import minimum_jerk, recovery_of, simulated

from smoother.measures import MeasureSettings, measure
from smoother.measures.measure import MatchingRepetitions, SegmentingMovements
from smoother.measures.motion import grid_of, motion_of
from smoother.measures.movements import find_movements, find_repetitions, match_cost
from smoother.result import Recovery

T = np.arange(0.0, 20.0, 0.01)


def to_and_fro(times: list[tuple[float, float]]) -> Recovery:
    """A hand that moves 0.3 m to and fro, from one time to the other, and rests between."""
    way = sum((-1) ** k * minimum_jerk(T, *each) for k, each in enumerate(times))
    hand = 0.3 * np.asarray(way)[:, None] * np.array([0.6, 0.0, 0.8])
    return recovery_of(T, {"wrist": hand})


def test_movements_begin_and_end_where_the_speed_passes_5_percent():
    times = [(2.0, 3.0), (6.0, 8.0), (12.0, 12.8)]
    recovery = to_and_fro(times)
    settings = MeasureSettings()
    grid = grid_of(recovery, settings.smoothing)
    motion = motion_of(recovery, grid, 6.0)
    places = find_movements(motion.speed, grid, settings.movements)
    assert len(places) == 3
    for place, (start, end) in zip(places, times, strict=True):
        peak = 1.875 * 0.3 / (end - start)
        rest = max(0.03, 0.05 * peak)
        u = np.linspace(0, 0.5, 2001)
        early = u[np.argmax(16 * (u**2 - 2 * u**3 + u**4) >= rest / peak)] * (end - start)
        # a filter of 6 Hz spreads an onset by some hundredths of a second
        assert grid.t_s[place.start] == pytest.approx(start + early, abs=0.04)
        assert grid.t_s[place.stop - 1] == pytest.approx(end - early, abs=0.04)


def test_what_is_slow_or_short_is_no_movement():
    grid = grid_of(to_and_fro([(2.0, 3.0)]), MeasureSettings().smoothing)
    slow = np.where((T > 2) & (T < 9), 0.09, 0.0)
    short = np.where((T > 2) & (T < 2.2), 0.5, 0.0)
    for speed in (slow, short, np.zeros_like(T), np.full_like(T, np.nan)):
        assert find_movements(speed[: len(grid.t_s)], grid, SegmentingMovements()) == []


def test_a_dip_that_is_no_rest_does_not_part_a_movement():
    grid = grid_of(to_and_fro([(2.0, 3.0)]), MeasureSettings().smoothing)
    speed = np.where((T > 2) & (T < 5), 0.6, 0.0)
    speed[(T > 3.4) & (T < 3.6)] = 0.06  # above 5 % of the peak
    assert len(find_movements(speed[: len(grid.t_s)], grid, SegmentingMovements())) == 1
    speed[(T > 3.4) & (T < 3.6)] = 0.0
    assert len(find_movements(speed[: len(grid.t_s)], grid, SegmentingMovements())) == 2


def brute_force(pattern: np.ndarray, series: np.ndarray, end: int) -> float:
    """The least cost of all chains of steps that end at a sample, by trying all of them."""
    best = np.inf
    m = len(pattern)
    d = np.linalg.norm(pattern[:, None] - series[None], axis=2)
    for count in range((m - 1) // 2, m):
        for steps in itertools.product(((1, 1), (1, 2), (2, 1)), repeat=count):
            if sum(i for i, _ in steps) != m - 1:
                continue
            i, j, cost, weight = 0, end - sum(step for _, step in steps), 0.0, 1.0
            if j < 0:
                continue
            cost = d[0, j]
            for down, right in steps:
                if (down, right) == (1, 2):
                    cost += 2 * d[i + 1, j + 1]
                if (down, right) == (2, 1):
                    cost += 2 * d[i + 1, j + 1]
                i, j = i + down, j + right
                cost += d[i, j] * (2 if (down, right) == (1, 1) else 1)
                weight += down + right
            best = min(best, cost / weight)
    return best


def test_warping_is_no_better_than_all_chains_and_exact_where_the_pattern_is():
    rng = np.random.default_rng(0)
    pattern, series = rng.normal(size=(6, 2)), rng.normal(size=(12, 2))
    series[4:10] = pattern
    cost, start = match_cost(pattern, series)
    assert cost[9] == 0.0 and start[9] == 4
    for end in range(12):
        # the best chain to each column is kept by its mean so far: never below the least of all
        least = brute_force(pattern, series, end)
        assert cost[end] >= least - 1e-12
        assert cost[end] <= 1.3 * least + 1e-12 or not np.isfinite(cost[end])


def exercise(tempo: list[float], pause_s: float = 0.5) -> tuple[Recovery, list[tuple[float, float]]]:
    """A hand that draws the same closed figure, each time at another tempo."""
    times, at = [], 1.0
    for seconds in tempo:
        times.append((at, at + seconds))
        at += seconds + pause_s
    t = np.arange(0.0, at + 1.0, 0.02)
    turn = 2 * np.pi * sum(minimum_jerk(t, *each) for each in times)
    hand = 0.25 * np.stack([1 - np.cos(turn), np.sin(turn), 0.5 * np.sin(2 * turn)], axis=1)
    return recovery_of(t, {"wrist": hand}), times


def test_repetitions_at_another_tempo():
    recovery, times = exercise([4.0, 4.4, 3.6, 5.0, 3.4, 4.0])
    grid = grid_of(recovery, MeasureSettings().smoothing)
    motion = motion_of(recovery, grid, 6.0)
    rounds = find_repetitions(motion, MatchingRepetitions())
    assert len(rounds) == len(times)
    middles = np.array([0.5 * (each.start_s + each.end_s) for each in rounds])
    lengths = np.diff([0.5 * (a + b) for a, b in times])
    # a closed figure may be counted from any of its points: rounds follow each other as the true ones do
    assert np.abs(np.diff(middles) - lengths).max() < 1.0
    first = MatchingRepetitions(start_s=times[0][0], end_s=times[0][1])
    named = find_repetitions(motion, first)
    assert len(named) == len(times)
    for each, (start, end) in zip(named, times, strict=True):
        assert each.start_s == pytest.approx(start, abs=0.7) and each.end_s == pytest.approx(end, abs=0.7)


def test_a_motion_that_does_not_come_again_has_no_repetitions():
    recovery = simulated(3, protocol="random", duration_s=30.0)
    measures = measure(recovery)
    assert measures.repetitions == ()
    assert measures.by_key["repetition_count"].value == 0.0
    assert "comes again" in measures.by_key["repetition_duration_s"].note


def test_the_simulated_protocol_is_done_twice():
    measures = measure(simulated(0))
    assert measures.by_key["repetition_count"].value == 2.0
    first, second = measures.repetitions
    assert 9.0 < first.length_s < 15.0 and 9.0 < second.length_s < 15.0
    assert second.start_s >= first.end_s - 2.0
