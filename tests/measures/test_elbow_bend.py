"""The elbow's flexion without what noise adds to it."""

from __future__ import annotations

import numpy as np
import pytest
from measured_arms import recovery_of, with_draws

from smoother.joint_angles import elbow_bend, recovery_angles
from smoother.measures import measure
from smoother.measures.definitions import MeasureDefinition, interval
from smoother.measures.motion import ElbowBend, lessened

T = np.arange(0.0, 20.0, 0.1)
WHATS = {"max": np.max, "min": np.min, "median": np.median, "range": np.ptp}


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
    signed = 0.3 * np.sin(1.3 * T)
    recovery = recovery_of(T, swinging(signed, T))
    bend = elbow_bend(recovery)
    assert bend is not None
    flexion = recovery_angles(recovery)["elbow_flexion"]
    np.testing.assert_allclose(np.degrees(np.linalg.norm(bend, axis=1)), flexion, atol=1e-9)
    np.testing.assert_allclose(bend[:, 2], -signed, atol=1e-9)  # from y towards x is about -z
    assert elbow_bend(recovery_of(T, {"wrist": np.zeros((len(T), 3))})) is None


def slow_errors(rng: np.random.Generator, count: int, sigma: float) -> np.ndarray:
    """Errors (count, n, 2) of the bend with a memory of a second, and that standard deviation an axis."""
    waves = np.stack([f(np.outer(np.arange(12), 0.4 * T)) for f in (np.cos, np.sin)])
    return sigma / np.sqrt(12) * np.einsum("nabk,abt->ntk", rng.normal(size=(count, 2, 12, 2)), waves)


@pytest.mark.parametrize("stated", [0.8, 1.0, 1.25])
def test_a_straight_elbow_is_held_by_its_intervals(stated: float):
    """100 answers that are a bend of 0 to 7 degrees and an error of 3 degrees, stated well or not so well."""
    rng = np.random.default_rng(3)
    truth = np.radians(3.5 * (1.0 + np.sin(0.8 * T)))
    error = np.radians(3.0)
    held, held_before = dict.fromkeys(WHATS, 0), dict.fromkeys(WHATS, 0)
    off: dict[str, list[float]] = {what: [] for what in WHATS}
    off_before: dict[str, list[float]] = {what: [] for what in WHATS}
    for _ in range(100):
        answer = np.stack([truth, 0.0 * T], axis=1) + slow_errors(rng, 1, error)[0]
        errors = slow_errors(rng, 40, stated * error)
        flexion, drawn = (np.degrees(np.linalg.norm(each, axis=-1)) for each in (answer, answer + errors))
        square = float(np.mean(np.sin(np.radians(flexion)) ** 2))
        bend = ElbowBend(square, 0.5 * float(np.mean((errors**2).sum(axis=2))))
        parts = [bend.left(float(u)) * bend.of_draws for u in rng.uniform(size=40)]
        for what, of in WHATS.items():
            exact = float(of(np.degrees(truth)))
            definition = MeasureDefinition(what, "deg", 0.0, 180.0)
            value = float(of(lessened(flexion, bend.left(0.5))))
            draws = np.array([of(lessened(each, part)) for each, part in zip(drawn, parts, strict=True)])
            low, high, _ = interval(value, draws, definition)
            low = low if what == "range" else bend.lower(low)
            held[what] += low - 1e-9 <= exact <= high + 1e-9
            off[what].append(value - exact)
            value_before = float(of(flexion))
            low, high, _ = interval(value_before, np.array([of(each) for each in drawn]), definition)
            held_before[what] += low <= exact <= high
            off_before[what].append(value_before - exact)
    assert min(held[what] for what in ("max", "min", "range")) >= 85, held
    assert held["median"] >= 75, held
    assert max(held_before["max"], held_before["range"]) <= 60  # what the correction is for
    for what in ("max", "range"):
        assert abs(np.mean(off[what])) < 0.6 * np.mean(off_before[what]), what


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
    recovery = recovery_of(T, swinging(1.0 + 0.5 * np.sin(T), T))
    bare, sure = measure(recovery).by_key, measure(with_draws(recovery, sigma_m=0.0)).by_key
    for what in ("range", "min", "max", "p50"):
        key = f"elbow_flexion_{what}_deg"
        assert sure[key].value == pytest.approx(bare[key].value, abs=1e-9)
        assert (sure[key].low, sure[key].high) == pytest.approx((bare[key].value,) * 2, abs=1e-9)
