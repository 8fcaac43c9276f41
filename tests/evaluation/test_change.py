"""What is called a change: of measures, of curves, and reliability against published examples."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNCLEAR,
    UNKNOWN,
    PersonProgress,
    Series,
    SessionValue,
    change_between,
    reliability_of,
    together,
    without_like_movements,
)
from smoother.evaluation.statistics import (
    detectable_change,
    icc_a1,
    limits_of_agreement,
    mean_squares,
    pair_agreement,
    sem_agreement,
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


@pytest.mark.slow
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
    ("counts", "shares", "reason"),
    [
        (((5, 5, 5), (5, 5, 5)), (0.2, 0.2), ""),
        (((10, 10, 10), (9, 9, 10)), (0.2, 0.2), ""),
        (((11, 11, 13), (13, 12, 14)), (0.2, 0.2), r"11 \(11 to 13\) and 13 \(12 to 14\)"),
        (((3, 3, 3), (2, 2, 2)), (0.2, 0.2), "have 3 and 2 movements"),
        (((5, 4, 7), (5, 5, 5)), (0.2, 0.2), r"5 \(4 to 7\) and 5"),  # the same number, but found by luck
        (((5, math.nan, math.nan), (5, 5, 5)), (0.2, 0.2), ""),
        (((math.nan,) * 3, (2, 2, 2)), (0.2, 0.2), "not known"),
        ((None, (2, 2, 2)), (0.2, 0.2), "not known"),
        (((5, 5, 5), (5, 5, 5)), (0.0, 0.8), "0 % .* 80 %"),
    ],
)
def test_means_over_other_movements(
    counts: tuple[tuple[float, float, float] | None, ...], shares: tuple[float, float], reason: str
):
    first, last = (
        None if count is None else SessionValue("1", 0.0, *map(float, count), 0.0, 0.2, 64)
        for count in counts
    )
    sessions = (replace(value(v), recovered_share=share) for v, share in zip((60, 75), shares, strict=True))
    before = change_between(*sessions)
    change = without_like_movements(before, first, last)
    if not reason:
        assert change == before and change.word == MORE
    else:
        assert change.word == UNKNOWN and math.isnan(change.p) and math.isnan(change.difference)
        assert re.search(reason, change.limits[0])


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
    assert found["pairs"] == 17
    assert found["bias"] == pytest.approx(-2.1, abs=0.05)
    assert found["sem"] == pytest.approx(38.8, abs=0.05)  # the paper's standard deviation of the differences
    # the paper takes 2 standard deviations (-79.7 and 75.5), this 1.96
    assert found["limits_low"] == pytest.approx(-79.7 + 0.04 * 38.8, abs=0.1)
    assert found["limits_high"] == pytest.approx(75.5 - 0.04 * 38.8, abs=0.1)


def test_error_and_minimal_difference_of_weirs_example():
    sem = float(np.sqrt(mean_squares(WEIR_A)[2]))
    assert sem == pytest.approx(7.6, abs=0.05)  # page 236
    assert detectable_change(sem) == pytest.approx(21, abs=0.5)  # 7.6 x 1.96 x sqrt 2
    assert icc_a1(WEIR_A)[0] == pytest.approx(0.95, abs=0.005)  # page 234, ICC(2,1)


def test_few_pairs_and_pairs_without_a_value():
    assert pair_agreement(np.array([]), np.array([]))["bias"] is None
    two = pair_agreement(np.array([1.0, 2.0, np.nan]), np.array([0.5, 1.5, 3.0]))
    assert (two["pairs"], two["bias"], two["icc"], two["mdc95"]) == (2, 0.5, None, None)
    same = pair_agreement(np.arange(4.0), np.arange(4.0))
    assert same["icc"] == pytest.approx(1) and same["mdc95"] == 0


#: Shrout and Fleiss (1979), table 2: six targets by four judges.
RATINGS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float
)
FLEXION = "elbow_flexion_range_deg"


def test_the_example_of_shrout_and_fleiss():
    """Their table 4 has ICC(2,1) = 0.29."""
    assert round(icc_a1(RATINGS)[0], 2) == 0.29
    # intervals as R's psych::ICC prints them of the same table
    np.testing.assert_allclose(icc_a1(RATINGS)[1:], (0.019, 0.761), atol=6e-4)
    # mean squares of their table 3: between judges 32.49, error 1.02
    assert sem_agreement(RATINGS)[0] == pytest.approx(np.sqrt((32.49 - 1.02) / 6 + 1.02), abs=0.01)


def progress_over(values: np.ndarray, sessions: tuple[str, ...]) -> list[PersonProgress]:
    persons = []
    for row, each in enumerate(values):
        found = tuple(SessionValue(name, 0.0, value) for name, value in zip(sessions, each, strict=True))
        series = Series(f"p{row}", "right", "", FLEXION, "elbow flexion", "deg", found)
        persons.append(PersonProgress(f"p{row}", sessions, (0.0,) * len(sessions), (series,)))
    return persons


def test_who_takes_part():
    assert sem_agreement(np.ones((3, 2))) == (0.0, 0.0, 0.0)
    values = np.arange(8.0).reshape(4, 2)
    assert reliability_of(progress_over(values[:2], ("a", "b"))) == []  # two persons
    assert reliability_of(progress_over(values[:, :1], ("a",))) == []  # one session
    values[0, 1] = np.nan
    (one,) = reliability_of(progress_over(values, ("a", "b")))
    assert one["persons"] == 3
    assert one["sem_agreement_low"] <= one["sem_agreement"] <= one["sem_agreement_high"]


def test_intervals_of_the_limits_hold():
    """The limits are mean -+ 1.96 SD; of ten pairs, each interval holds the true limit in 95 of 100 cases."""
    rng = np.random.default_rng(7)
    differences = rng.normal(1.0, 3.0, (3000, 10))
    found = [limits_of_agreement(each) for each in differences]
    true_low, true_high = 1.0 - 1.96 * 3.0, 1.0 + 1.96 * 3.0
    shares = [
        np.mean([each[f"{name}{low}"] <= true <= each[f"{name}{high}"] for each in found])
        for name, low, high, true in (
            ("limits_low", "_from", "_to", true_low),
            ("limits_high", "_from", "_to", true_high),
            ("bias", "_low", "_high", 1.0),
        )
    ]
    assert all(abs(share - 0.95) < 0.012 for share in shares), shares  # three standard errors
    one = differences[0]
    pairs = pair_agreement(one, np.zeros(10))
    assert pairs["limits_high"] == pytest.approx(one.mean() + 1.96 * one.std(ddof=1))
    assert pairs["limits_high_from"] < pairs["limits_high"] < pairs["limits_high_to"]
    assert pairs["limits_low_from"] == pytest.approx(2 * pairs["bias"] - pairs["limits_high_to"])
