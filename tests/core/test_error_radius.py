"""The distance within which an error lies: against many random errors, and where it is known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smoother.error_radius import error_radius, pooled_radius, within_words


def rotation(seed: int) -> np.ndarray:
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return q * np.sign(np.diag(r))


@pytest.mark.parametrize(
    "shares", [(1, 1, 1), (1, 1, 0), (1, 0, 0), (1, 0.5, 0.5), (1, 0.3, 0.02), (1, 0.8, 0.1)]
)
def test_a_share_of_random_errors_lies_within_it(shares: tuple[float, float, float]):
    turn = rotation(3)
    covariance = turn @ np.diag(shares) @ turn.T * 0.02**2
    errors = np.random.default_rng(1).multivariate_normal(np.zeros(3), covariance, 400_000)
    distance = np.linalg.norm(errors, axis=1)
    assert error_radius(covariance) == pytest.approx(np.quantile(distance, 0.95), rel=0.01)
    assert error_radius(covariance, 0.5) == pytest.approx(np.quantile(distance, 0.5), rel=0.03)


def test_it_is_exact_where_one_two_or_three_axes_are_equal():
    exact = [1.959964, math.sqrt(-2 * math.log(0.05)), 2.795483]
    covariance = np.stack([np.diag([1.0, 0, 0]), np.diag([1.0, 1, 0]), np.eye(3)])
    assert error_radius(covariance) == pytest.approx(exact, rel=1e-5)


def test_nothing_known_is_nan_and_no_error_is_zero():
    covariance = np.stack([np.full((3, 3), np.nan), np.zeros((3, 3))])
    assert np.isnan(error_radius(covariance)[0]) and error_radius(covariance)[1] == 0
    assert pooled_radius(np.full((4, 3, 3), np.nan)) is None


def test_pooled_samples_are_as_many_errors_together():
    rng = np.random.default_rng(2)
    covariance = np.stack(
        [rotation(k) @ np.diag([1, 0.4, 0.1]) @ rotation(k).T * s for k, s in enumerate((1, 2, 9))]
    )
    errors = np.concatenate([rng.multivariate_normal(np.zeros(3), each, 200_000) for each in covariance])
    there = np.concatenate([covariance, np.full((1, 3, 3), np.nan)])
    assert pooled_radius(there) == pytest.approx(np.quantile(np.linalg.norm(errors, axis=1), 0.95), rel=0.02)


def test_in_words():
    assert within_words(0.0207) == "within 2.1 cm in 95 of 100 cases"
    assert within_words(1.3) == "within 130 cm in 95 of 100 cases"
