"""Agreement of pairs against published worked examples: bias, limits, ICC(2,1), SEM, minimal change."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.evaluation.agreement import detectable_change, icc_a1, measurement_error, pair_agreement

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
