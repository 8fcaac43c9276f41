"""Movements and repetitions, their smoothness, and the flexion without what noise adds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from measured_arms import minimum_jerk, recovery_of, simulated, with_draws

from smoother.angles.definitions import forearm_axes, recovery_angles
from smoother.measures import MeasureSettings, measure
from smoother.measures.definitions import BY_MOVEMENT
from smoother.measures.figures import log_dimensionless_jerk, spectral_arc_length, velocity_peaks
from smoother.measures.measure import MatchingRepetitions, SegmentingMovements
from smoother.measures.motion import ElbowBend, elbow_bend, grid_of, lessened, motion_of
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


def dipping(least_m_s: float) -> Recovery:
    """A hand that moves to and fro, then along a line, slowing once to about the speed of rest."""
    peak = np.sin(np.pi * (T - 12.0) / 4.0) * (0.3 + 0.05 * (T > 14.0))
    dip = (peak - least_m_s) * np.exp(-(((T - 14.0) / 0.2) ** 2))
    speed = np.where((T > 12.0) & (T < 16.0), peak - dip, 0.0)
    way = 0.3 * (minimum_jerk(T, 2.0, 3.2) - minimum_jerk(T, 6.0, 7.6)) + np.cumsum(speed) * 0.01
    return recovery_of(T, {"wrist": way[:, None] * np.array([0.6, 0.0, 0.8])})


@pytest.mark.slow
@pytest.mark.parametrize(("found", "true", "counts"), [(0.036, 0.024, (3, 4)), (0.024, 0.036, (4, 3))])
def test_an_interval_of_a_mean_includes_which_movements_were_found(
    found: float, true: float, counts: tuple[int, int]
):
    answer, truth = measure(with_draws(dipping(found), 64, 0.004)), measure(dipping(true))
    assert tuple(one.by_key["movement_count"].value for one in (answer, truth)) == counts
    for key in (*BY_MOVEMENT, "movement_count"):
        row, there = answer.by_key[key], truth.by_key[key].value
        slack = 0.03 * abs(there)  # the draws' errors are none that this truth may have
        assert row.low - slack <= there <= row.high + slack and row.low <= row.value <= row.high, key
    assert any("3 to 4 movements" in note for note in answer.notes)
    # a movement's own measures are over the same samples in every draw
    assert answer.of("movement", 1)["hand_path_length_m"].sigma < 0.01
    certain = measure(with_draws(to_and_fro([(2.0, 3.0), (6.0, 8.0)]), 64, 0.002))
    assert certain.by_key["sparc"].sigma < 0.1 and not any("movements" in note for note in certain.notes)


def test_warping_is_exact_where_the_pattern_is():
    rng = np.random.default_rng(0)
    pattern, series = rng.normal(size=(6, 2)), rng.normal(size=(12, 2))
    series[4:10] = pattern
    cost, start = match_cost(pattern, series)
    assert cost[9] == 0.0 and start[9] == 4 and (cost[np.arange(12) != 9] > 0.0).all()


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
    assert "Too few repetitions" in measures.by_key["repetition_duration_s"].note


#: The worked example that the authors publish with their own program: a Gaussian speed profile at 100 Hz.
BELL = np.exp(-5.0 * np.arange(-1.0, 1.0, 0.01) ** 2)


def minimum_jerk_speed(seconds: float, rate_hz: float, peak: float = 1.0) -> np.ndarray:
    u = np.arange(0.0, 1.0 + 1e-9, 1.0 / (seconds * rate_hz))
    return peak * 16.0 * (u**2 - 2 * u**3 + u**4)


def test_the_published_examples():
    assert spectral_arc_length(BELL, 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert log_dimensionless_jerk(BELL, 100.0) == pytest.approx(-5.81636, abs=5e-6)


def test_a_stop_between_makes_a_movement_less_smooth():
    one = minimum_jerk_speed(1.0, 100.0)
    two = np.concatenate([one, np.zeros(20), one])
    assert spectral_arc_length(two, 100.0) < spectral_arc_length(one, 100.0) - 0.5
    assert log_dimensionless_jerk(two, 100.0) < log_dimensionless_jerk(one, 100.0) - 1.0
    assert len(velocity_peaks(one, 100.0, 0.02, 0.15)) == 1
    assert velocity_peaks(two, 100.0, 0.02, 0.15).tolist() == [50, 171]


def test_peaks_that_do_not_stand_out_do_not_count():
    t = np.arange(0.0, 1.0, 0.01)
    bell = np.sin(np.pi * t)
    assert len(velocity_peaks(bell + 0.005 * np.sin(2 * np.pi * 9 * t), 100.0, 0.02, 0.15)) == 1
    assert len(velocity_peaks(bell + 0.2 * np.sin(2 * np.pi * 3 * t), 100.0, 0.02, 0.15)) > 1


@pytest.mark.parametrize("speed", [np.zeros(100), np.ones(5), np.full(50, np.nan)])
def test_what_has_no_smoothness_is_nan(speed: np.ndarray):
    assert math.isnan(spectral_arc_length(speed, 100.0))
    assert math.isnan(log_dimensionless_jerk(speed, 100.0))


BEND_T = np.arange(0.0, 20.0, 0.1)


def swinging(flexion_rad: np.ndarray, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """An upper arm that swings, and a forearm that bends from it in the swing's plane."""
    swing = 0.7 * np.sin(0.9 * t_s)

    def along(angle: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(angle), np.cos(angle), np.zeros(len(angle))], axis=1)

    elbow = 0.3 * along(swing)
    return {
        "shoulder": np.zeros_like(elbow),
        "elbow": elbow,
        "wrist": elbow + 0.25 * along(swing + flexion_rad),
    }


def test_the_bend_is_as_long_as_the_flexion_and_passes_straight_smoothly():
    signed = 0.3 * np.sin(1.3 * BEND_T)
    recovery = recovery_of(BEND_T, swinging(signed, BEND_T))
    bend = elbow_bend(recovery.joints, forearm_axes(recovery.quaternion, np.eye(3)))
    flexion = recovery_angles(recovery)["elbow_flexion"]
    np.testing.assert_allclose(np.degrees(np.linalg.norm(bend, axis=1)), flexion, atol=1e-9)
    np.testing.assert_allclose(bend[:, 2], -signed, atol=1e-9)  # from y towards x is about -z
    assert elbow_bend({"wrist": np.zeros((len(BEND_T), 3))}, np.eye(3)) is None


def test_a_bent_elbow_stays_as_it_is():
    """Errors of 3 degrees take at most half a degree from an elbow that bends from 20 to 130."""
    flexion = np.linspace(20.0, 130.0, 500)
    bend = ElbowBend(float(np.mean(np.sin(np.radians(flexion)) ** 2)), np.radians(3.0) ** 2)
    less = lessened(flexion, bend.left(0.5))
    assert (less <= flexion + 1e-9).all() and (less > flexion - 0.5).all() and (np.diff(less) > 0.0).all()
    np.testing.assert_allclose(less[flexion >= 90.0], flexion[flexion >= 90.0], atol=1e-9)


def test_more_is_left_where_the_error_is_smaller():
    lefts = [ElbowBend(0.01, variance).left(0.5) for variance in (0.0, 1e-9, 1e-4, 1e-3, 1e-2, 1.0)]
    assert lefts[0] == 1.0 and lefts[1] == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(lefts) <= 0.0).all() and lefts[-1] < 0.5
    spread = [ElbowBend(0.01, 0.003).left(quantile) for quantile in (0.0, 0.025, 0.5, 0.975, 1.0)]
    assert (np.diff(spread) > 0.0).all() and spread[0] >= 0.0 and spread[-1] <= 1.0
    # the stated error explains all of the answer: anything from straight up may be true
    assert spread[1] < 0.3


def test_an_interval_reaches_down_by_the_error_across_the_bend():
    bend = ElbowBend(0.01, np.radians(3.0) ** 2)
    assert bend.lower(2.0) == 0.0 and bend.lower(-1.0) == -1.0
    assert bend.lower(5.0) == pytest.approx(4.0, abs=0.02)  # 3, 4, 5: on a small sphere nearly so
    assert bend.lower(100.0) == 100.0  # beyond a right angle an error across lessens the angle


def test_draws_that_agree_leave_the_measures_as_they_are():
    recovery = recovery_of(BEND_T, swinging(1.0 + 0.5 * np.sin(BEND_T), BEND_T))
    bare, sure = measure(recovery).by_key, measure(with_draws(recovery, sigma_m=0.0)).by_key
    for what in ("range", "min", "max", "p50"):
        key = f"elbow_flexion_{what}_deg"
        assert sure[key].value == pytest.approx(bare[key].value, abs=1e-9)
        assert (sure[key].low, sure[key].high) == pytest.approx((bare[key].value,) * 2, abs=1e-9)
