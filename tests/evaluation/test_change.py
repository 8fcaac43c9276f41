"""A measure: what is called a change; agreement of pairs against published worked examples."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from smoother.evaluation.agreement import detectable_change, icc_a1, measurement_error, pair_agreement
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
    # a measure without an interval does not show whether none or too few motions were drawn
    assert "without drawn motions, or they are too few (20 are needed, --draws 64)" in change.limits[0]
    change = change_between(value(60), SessionValue("4", 30.0, math.nan, note="no hand"), math.nan)
    assert change.limits == ("session 4 has no value (no hand)",)


def test_what_rests_on_recovered_samples_is_said():
    change = change_between(value(60), replace(value(61), recovered_share=0.7))
    assert change.limits == ("more than half of session 1 comes from recovered samples",)


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


#: Bland and Altman, Lancet 1986, table 1: first readings, l/min, of a Wright and a mini Wright meter.
WRIGHT = np.array(
    [494, 395, 516, 434, 476, 557, 413, 442, 650, 433, 417, 656, 267, 478, 178, 423, 427], dtype=float
)
MINI = np.array(
    [512, 430, 520, 428, 500, 600, 364, 380, 658, 445, 432, 626, 260, 477, 259, 350, 451], dtype=float
)
#: Weir, J Strength Cond Res 2005, data set A: two trials of eight subjects.
WEIR_A = np.array(
    [[146, 140], [148, 152], [170, 152], [90, 99], [157, 145], [156, 153], [176, 167], [205, 218]],
    dtype=float,
)


def test_limits_of_agreement_of_the_published_example():
    found = pair_agreement(WRIGHT, MINI)
    assert found.pairs == 17
    assert found.bias == pytest.approx(-2.1, abs=0.05)
    assert found.sem == pytest.approx(38.8, abs=0.05)  # the paper's standard deviation of the differences
    # the paper takes 2 standard deviations (-79.7 and 75.5), this 1.96
    assert found.limits_low == pytest.approx(-79.7 + 0.04 * 38.8, abs=0.1)
    assert found.limits_high == pytest.approx(75.5 - 0.04 * 38.8, abs=0.1)


def test_error_and_minimal_difference_of_weirs_example():
    sem = measurement_error(WEIR_A)
    assert sem == pytest.approx(7.6, abs=0.05)  # page 236
    assert detectable_change(sem) == pytest.approx(21, abs=0.5)  # 7.6 x 1.96 x sqrt 2
    assert icc_a1(WEIR_A)[0] == pytest.approx(0.95, abs=0.005)  # page 234, ICC(2,1)


def test_a_reference_without_error_leaves_all_of_it_to_the_answer():
    found = pair_agreement(WEIR_A[:, 0], WEIR_A[:, 1])
    assert found.sem == pytest.approx(np.sqrt(2) * measurement_error(WEIR_A))
    assert found.mdc95 == pytest.approx(detectable_change(found.sem))


def test_of_unchanged_pairs_95_of_100_differ_by_less():
    rng = np.random.default_rng(0)
    true = rng.normal(60, 15, 4000)
    found = pair_agreement(true + rng.normal(3, 2, 4000), true)
    first, second = (true + rng.normal(3, 2, 4000) for _ in range(2))
    # 4000 differences: 3 sigmas of a share of 0.95 are 0.01
    assert np.mean(np.abs(second - first) < found.mdc95) == pytest.approx(0.95, abs=0.011)
    assert found.mdc95_low < 1.96 * np.sqrt(2) * 2 < found.mdc95_high


def test_the_interval_of_the_minimal_change_holds_it_also_with_few_pairs():
    rng = np.random.default_rng(1)
    truth, inside = detectable_change(1.0), 0
    for _ in range(400):
        true = rng.normal(0, 5, 5)
        found = pair_agreement(true + rng.normal(0, 1, 5), true)
        inside += found.mdc95_low < truth < found.mdc95_high
    assert inside / 400 == pytest.approx(0.95, abs=0.033)  # 3 sigmas of a share of 0.95 over 400


def test_few_pairs_and_pairs_without_a_value():
    assert pair_agreement(np.array([]), np.array([])).bias is None
    two = pair_agreement(np.array([1.0, 2.0, np.nan]), np.array([0.5, 1.5, 3.0]))
    assert (two.pairs, two.bias, two.icc, two.mdc95) == (2, 0.5, None, None)
    same = pair_agreement(np.arange(4.0), np.arange(4.0))
    assert same.icc == pytest.approx(1) and same.mdc95 == 0
