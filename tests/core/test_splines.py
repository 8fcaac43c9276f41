"""Piecewise cubics against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from smoother.splines import PiecewiseCubic, cubic_spline


@pytest.mark.parametrize("count", [2, 3, 4, 5, 50])
def test_spline_is_scipys(count: int) -> None:
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.01, 0.4, count))
    value = rng.normal(size=(count, 3))
    at = np.concatenate([np.linspace(t[0], t[-1], 301), t, [t[0] - 0.01, t[-1] + 0.01]])
    ours, theirs = cubic_spline(t, value), CubicSpline(t, value)
    scale = np.abs(theirs(at, 1)).max() + 1.0  # rounding, of values and slopes of this size
    np.testing.assert_allclose(ours(at), theirs(at), atol=1e-11 * scale)
    np.testing.assert_allclose(ours(at, 1), theirs(at, 1), atol=1e-10 * scale)


@pytest.mark.parametrize("count", [2, 3, 4, 12, 13, 50])
def test_natural_spline_is_scipys(count: int) -> None:
    rng = np.random.default_rng(count)
    t = np.cumsum(rng.uniform(0.01, 0.4, count))
    value = rng.normal(size=(count, 3))
    at = np.concatenate([np.linspace(t[0], t[-1], 301), t])
    ours, theirs = cubic_spline(t, value, natural=True), CubicSpline(t, value, bc_type="natural")
    scale = np.abs(theirs(at, 1)).max() + 1.0
    np.testing.assert_allclose(ours(at), theirs(at), atol=1e-11 * scale)
    np.testing.assert_allclose(ours(at, 1), theirs(at, 1), atol=1e-10 * scale)


def test_hermite_is_scipys() -> None:
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.01, 0.4, 20))
    value, slope = rng.normal(size=(2, 20, 3))
    at = rng.uniform(t[0], t[-1], (7, 11))
    ours, theirs = PiecewiseCubic(t, value, slope), CubicHermiteSpline(t, value, slope)
    np.testing.assert_allclose(ours(at), theirs(at), atol=1e-11)
    np.testing.assert_allclose(ours(at, 1), theirs(at, 1), atol=1e-9)


def test_knots_that_stand_still() -> None:
    with pytest.raises((np.linalg.LinAlgError, ValueError)), np.errstate(all="ignore"):
        cubic_spline(np.zeros(5), np.zeros((5, 1)))
