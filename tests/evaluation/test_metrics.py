"""The metrics against slow, independent implementations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from smoother.evaluation import metrics


def random_quaternions(count: int, seed: int) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_quat(scalar_first=True)


def test_orientation_error_is_the_published_measure():
    measured, gold = random_quaternions(50, 1), random_quaternions(50, 2)
    got = metrics.orientation_error_deg(measured, gold)
    for index in range(50):
        a = Rotation.from_quat(measured[index], scalar_first=True)
        b = Rotation.from_quat(gold[index], scalar_first=True)
        real = (a.inv() * b).as_quat(scalar_first=True)[0]
        published = math.acos(max(-1.0, min(1.0, real))) * 360 / math.pi
        published = min(published, 360 - published)
        assert got[index] == pytest.approx(published, abs=1e-6)
        assert got[index] == pytest.approx(math.degrees((a.inv() * b).magnitude()), abs=1e-9)


def test_orientation_error_keeps_tiny_angles_and_ignores_sign_and_norm():
    q = random_quaternions(1, 3)
    turned = (Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec([1e-9, 0, 0])).as_quat(
        scalar_first=True
    )
    assert metrics.orientation_error_deg(q, -2 * turned)[0] == pytest.approx(math.degrees(1e-9), rel=1e-3)
    assert metrics.orientation_error_deg(q, -q)[0] == 0.0
    assert np.isnan(metrics.orientation_error_deg(q, np.zeros((1, 4)))[0])
    assert np.isnan(metrics.orientation_error_deg(q, np.full((1, 4), np.nan))[0])


def test_position_error_row_by_row():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 20, 3))
    slow = [math.dist(x, y) for x, y in zip(a, b, strict=True)]
    np.testing.assert_allclose(metrics.position_error(a, b), slow)


def test_squared_sigmas_against_the_inverse():
    rng = np.random.default_rng(1)
    error = rng.normal(size=(30, 3))
    root = rng.normal(size=(30, 3, 3))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3)
    slow = [float(e @ np.linalg.inv(P) @ e) for e, P in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(metrics.squared_sigmas(error, covariance), slow, rtol=1e-8)


def test_squared_sigmas_without_a_usable_covariance_are_nan():
    covariance = np.array([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.eye(3)])
    squared = metrics.squared_sigmas(np.ones((4, 3)), covariance)
    assert np.isnan(squared[:3]).all()
    assert squared[3] == pytest.approx(3.0)


def test_nees_and_coverage_of_honest_errors():
    rng = np.random.default_rng(2)
    root = np.array([[0.02, 0, 0], [0.01, 0.03, 0], [0.0, -0.02, 0.01]])
    error = rng.normal(size=(40_000, 3)) @ root.T
    squared = metrics.squared_sigmas(error, np.repeat((root @ root.T)[None], len(error), axis=0))
    assert metrics.nees(squared) == pytest.approx(1.0, abs=0.02)
    assert metrics.coverage_95(squared) == pytest.approx(0.95, abs=0.005)
    overconfident = metrics.squared_sigmas(2 * error, np.repeat((root @ root.T)[None], len(error), axis=0))
    assert metrics.nees(overconfident) == pytest.approx(4.0, abs=0.1)


def test_chi_square_constant():
    assert pytest.approx(stats.chi2(3).ppf(0.95)) == metrics.CHI2_95_3


def test_summaries_leave_nan_out_and_say_none_for_nothing():
    values = np.array([3.0, np.nan, 4.0])
    assert metrics.rms(values) == pytest.approx(math.sqrt(12.5))
    assert metrics.maximum(values) == 4.0
    assert metrics.percentile(values, 50) == 3.5
    nothing = np.full(3, np.nan)
    for summary in (metrics.rms, metrics.maximum, metrics.nees, metrics.coverage_95):
        assert summary(nothing) is None
    assert metrics.percentile(nothing, 95) is None
    assert metrics.summarise(nothing, nothing, nothing).samples == 0
