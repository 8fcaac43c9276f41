"""A measure in two sessions: what is called a change, what is not, and what cannot be said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNCLEAR,
    UNKNOWN,
    SessionValue,
    change_between,
    together,
    without_like_movements,
)


def value(
    number: float, sigma: float = 2.0, draws: int = 64, session: str = "1", **more: float
) -> SessionValue:
    low, high = number - 1.96 * sigma, number + 1.96 * sigma
    return SessionValue(session, 0.0, number, low, high, sigma, 0.2, draws, **more)


@pytest.mark.parametrize(
    ("first", "last", "mdc95", "word"),
    [
        (value(60), value(75), math.nan, MORE),
        (value(75), value(60), math.nan, LESS),
        (value(60), value(63), math.nan, UNCLEAR),
        (value(60), value(75), 20.0, UNCLEAR),  # larger than the interval, not than what can be detected
        (value(60), value(75), 5.0, MORE),
        (value(60), value(63), 10.0, UNCLEAR),
        (value(60, 20.0), value(75, 20.0), 5.0, UNKNOWN),  # five would matter, fifty would be seen
        (value(60), value(math.nan), math.nan, UNKNOWN),
        (value(60, math.nan, 0), value(75), math.nan, UNKNOWN),
    ],
)
def test_words(first: SessionValue, last: SessionValue, mdc95: float, word: str):
    change = change_between(first, last, mdc95)
    assert change.word == word
    assert change.limits or word in (MORE, LESS, UNCLEAR)
    if word in (MORE, LESS):
        assert change.low * change.high > 0 and change.detectable < abs(change.difference)


def test_no_draws_is_said():
    change = change_between(value(60, math.nan, 0), value(75), 5.0)
    assert math.isnan(change.p)
    # a measure without an interval does not tell whether none or too few motions were drawn
    assert "without drawn motions, or they are too few (20 are needed, --draws 64)" in change.limits[0]
    change = change_between(value(60), SessionValue("4", 30.0, math.nan, note="no hand"), math.nan)
    assert change.limits == ("session 4 has no value (no hand)",)


def test_what_rests_on_recovered_samples_is_said():
    change = change_between(value(60), replace(value(61), recovered_share=0.7))
    assert change.limits == ("more than half of session 1 rests on recovered samples",)


@pytest.mark.parametrize("draws", [6, 20, 64])
def test_false_alarms_are_one_in_twenty(draws: int):
    """Two sessions of an unchanged arm, each with the sigma that so many draws estimate."""
    rng = np.random.default_rng(draws)
    tries, alarms = 4000, 0
    for _ in range(tries):
        values = []
        for sigma in (2.0, 3.0):
            number = 60 + rng.normal(0, sigma)
            estimate = float(np.std(number + rng.normal(0, sigma, draws), ddof=1))
            values.append(SessionValue("s", 0.0, number, math.nan, math.nan, estimate, 0.1, draws))
        alarms += change_between(*values).word in (MORE, LESS)
    # Welch's approximation and 3 sigmas of a share of 0.05 over 4000
    assert alarms / tries == pytest.approx(0.05, abs=0.011)


def test_a_change_of_four_sigmas_is_nearly_always_called():
    rng = np.random.default_rng(5)
    calls = 0
    for _ in range(500):
        first, last = 60 + rng.normal(0, 2), 60 + 4 * 2 * math.sqrt(2) + rng.normal(0, 2)
        calls += change_between(value(first), value(last)).word == MORE
    assert calls / 500 > 0.95  # the power is 0.98


def test_an_interval_to_one_side_counts_as_error():
    lopsided = SessionValue("1", 0.0, 60.0, 59.9, 72.0, 3.0, 0.1, 64)
    assert lopsided.spread == pytest.approx(12 / 1.96, rel=1e-3)
    assert change_between(lopsided, value(72)).word == UNCLEAR
    outside = change_between(SessionValue("1", 0.0, 60.0, 61.0, 66.0, 1.0, 0.1, 64), value(62))
    assert "session 1: the value lies outside its own interval" in outside.limits


def test_counts_on_which_all_draws_agree():
    def reached(number: float, draws: int = 64) -> SessionValue:
        return SessionValue("1", 0.0, number, number, number, 0.0, 0.1, draws)

    assert change_between(reached(0), reached(1)).word == MORE
    assert change_between(reached(1), reached(1)).word == UNCLEAR
    assert change_between(reached(0, 20), reached(1, 20)).word == UNCLEAR  # too few draws to be sure


@pytest.mark.parametrize(
    ("counts", "word", "said"),
    [((5, 5), MORE, False), ((10, 9), MORE, True), ((3, 2), UNKNOWN, True), ((math.nan, 2), MORE, False)],
)
def test_means_over_other_movements(counts: tuple[float, float], word: str, said: bool):
    change = without_like_movements(change_between(value(60), value(75)), *counts)
    assert change.word == word and bool(change.limits) is said


def test_many_comparisons_together():
    changes = [replace(change_between(value(60), value(60)), p=p) for p in (0.01, math.nan, 0.04, 0.03)]
    # Holm's steps by hand: 3 x 0.01, then max(., 2 x 0.03), then max(., 1 x 0.04)
    assert together(changes) == pytest.approx([0.03, math.nan, 0.06, 0.06], nan_ok=True)
