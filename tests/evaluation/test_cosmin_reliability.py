"""ICC, SEM and limits of agreement: a published example, a variance model, coverage by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.evaluation.agreement import icc_a1, limits_of_agreement, pair_agreement
from smoother.evaluation.progress import PersonProgress, Series, SessionValue
from smoother.evaluation.reliability import icc_c1, reliability_of, sem_agreement

#: Shrout and Fleiss (1979), table 2: six targets by four judges.
RATINGS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float
)
FLEXION = "elbow_flexion_range_deg"


def test_the_example_of_shrout_and_fleiss():
    """Their table 4 has ICC(2,1) = 0.29 and ICC(3,1) = 0.71."""
    assert round(icc_a1(RATINGS)[0], 2) == 0.29 and round(icc_c1(RATINGS)[0], 2) == 0.71
    # intervals as R's psych::ICC prints them of the same table
    np.testing.assert_allclose(icc_a1(RATINGS)[1:], (0.019, 0.761), atol=6e-4)
    np.testing.assert_allclose(icc_c1(RATINGS)[1:], (0.342, 0.946), atol=6e-4)
    # mean squares of their table 3: between judges 32.49, error 1.02
    assert sem_agreement(RATINGS)[0] == pytest.approx(np.sqrt((32.49 - 1.02) / 6 + 1.02), abs=0.01)


def test_sem_by_least_squares_and_its_interval():
    """SEM_consistency is the residual of persons and sessions as dummies; SEM_agreement finds the model's."""
    rng = np.random.default_rng(5)
    inside, trials, shift = 0, 400, 1.5
    for _ in range(trials):
        ratings = rng.normal(50, 8, (12, 1)) + rng.normal(0, 2.0, (12, 2))
        value, low, high = sem_agreement(ratings)
        inside += low <= 2.0 <= high
    assert 0.92 <= inside / trials <= 0.98  # 0.95 +- 2.75 standard errors
    ratings = rng.normal(50, 8, (4000, 1)) + rng.normal(0, 2.0, (4000, 2)) + [0.0, shift]
    value, *_ = sem_agreement(ratings)
    assert value == pytest.approx(np.hypot(2.0, shift / np.sqrt(2)), rel=0.02)
    n, k = 9, 3
    some = rng.normal(size=(n, k))
    design = np.column_stack([np.repeat(np.eye(n), k, axis=0), np.tile(np.eye(k), (n, 1))])
    left = some.ravel() - design @ np.linalg.lstsq(design, some.ravel(), rcond=None)[0]
    person = progress_over(some, ("s1", "s2", "s3"))
    (one,) = reliability_of(person)
    assert one.sem_consistency == pytest.approx(np.sqrt(left @ left / ((n - 1) * (k - 1))))
    assert one.sdc == pytest.approx(1.96 * np.sqrt(2) * one.sem_agreement)
    assert (one.persons, one.sessions) == (n, k) and one.sdc_group == pytest.approx(one.sdc / 3)
    assert one.bias == pytest.approx((some[:, 1] - some[:, 0]).mean())


def progress_over(values: np.ndarray, sessions: tuple[str, ...]) -> list[PersonProgress]:
    return [
        PersonProgress(
            f"p{row}",
            sessions,
            (0.0,) * len(sessions),
            (
                Series(
                    f"p{row}",
                    "right",
                    "",
                    FLEXION,
                    "elbow flexion",
                    "deg",
                    tuple(SessionValue(name, 0.0, value) for name, value in zip(sessions, each, strict=True)),
                ),
            ),
        )
        for row, each in enumerate(values)
    ]


def test_who_takes_part():
    values = np.arange(8.0).reshape(4, 2)
    assert reliability_of(progress_over(values[:2], ("a", "b"))) == []  # two persons
    assert reliability_of(progress_over(values[:, :1], ("a",))) == []  # one session
    values[0, 1] = np.nan
    (one,) = reliability_of(progress_over(values, ("a", "b")))
    assert one.persons == 3 and one.sem_agreement_low <= one.sem_agreement <= one.sem_agreement_high


def test_intervals_of_the_limits_hold():
    """The limits are mean -+ 1.96 SD; of ten pairs, each interval holds the true limit in 95 of 100 cases."""
    rng = np.random.default_rng(7)
    differences = rng.normal(1.0, 3.0, (3000, 10))
    found = [limits_of_agreement(each) for each in differences]
    true_low, true_high = 1.0 - 1.96 * 3.0, 1.0 + 1.96 * 3.0
    shares = (
        np.mean([each.low_from <= true_low <= each.low_to for each in found]),
        np.mean([each.high_from <= true_high <= each.high_to for each in found]),
        np.mean([each.bias_low <= 1.0 <= each.bias_high for each in found]),
    )
    assert all(abs(share - 0.95) < 0.012 for share in shares), shares  # three standard errors
    one = differences[0]
    pairs = pair_agreement(one, np.zeros(10))
    assert pairs.limits_high == pytest.approx(one.mean() + 1.96 * one.std(ddof=1))
    assert pairs.limits_high_from < pairs.limits_high < pairs.limits_high_to
    assert pairs.limits_low_from == pytest.approx(2 * pairs.bias - pairs.limits_high_to)
