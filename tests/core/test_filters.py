"""Filters against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from smoother.filters import gaussian_smoothed, moving_mean, moving_median


@pytest.mark.parametrize("width", [1, 2, 3, 8, 25])
def test_means_are_scipys(width: int) -> None:
    x = np.random.default_rng(width).normal(5.0, 1.0, 60)
    np.testing.assert_allclose(
        moving_mean(x, width), ndimage.uniform_filter1d(x, width, mode="nearest"), atol=1e-12
    )


@pytest.mark.parametrize("width", [3, 7])
def test_medians_are_scipys(width: int) -> None:
    x = np.random.default_rng(width).normal(size=(30, 3))
    np.testing.assert_array_equal(
        moving_median(x, width), ndimage.median_filter(x, size=(width, 1), mode="nearest")
    )


@pytest.mark.parametrize("derivative", [False, True])
@pytest.mark.parametrize("sigma", [0.8, 3.0, 6.2])
def test_gaussians_are_scipys(sigma: float, derivative: bool) -> None:
    x = np.random.default_rng(0).normal(size=(80, 2))
    theirs = ndimage.gaussian_filter1d(x, sigma, axis=0, order=int(derivative))
    np.testing.assert_allclose(gaussian_smoothed(x, sigma, derivative), theirs, atol=1e-12)
