"""Filters along a series as SciPy's `ndimage` has them, which takes longer to load than they take to run."""

from __future__ import annotations

import numpy as np

from .array_types import FloatArray


def moving_mean(x: FloatArray, width: int) -> FloatArray:  # x (n,) -> (n,)
    """Mean over neighbouring samples; beyond its ends the series goes on with its end values."""
    padded = np.pad(x - x[0], (width // 2, width - 1 - width // 2), mode="edge")  # small sums lose less
    total = np.concatenate(([0.0], np.cumsum(padded)))
    return np.asarray(x[0] + (total[width:] - total[:-width]) / width)


def moving_median(x: FloatArray, width: int) -> FloatArray:  # x (n, k) -> (n, k)
    """Median over neighbouring samples, column by column; the ends go on with their values."""
    padded = np.pad(x, ((width // 2, width // 2), (0, 0)), mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width, axis=0), axis=-1))


def gaussian_smoothed(x: FloatArray, sigma: float, derivative: bool = False) -> FloatArray:
    """Columns (n, k) smoothed by a Gaussian, or its first derivative a sample; mirrored at the ends."""
    radius = int(4.0 * sigma + 0.5)
    offset = np.arange(-radius, radius + 1)
    weight = np.exp(-0.5 * (offset / sigma) ** 2)
    weight /= weight.sum()
    if derivative:
        weight *= offset / sigma**2
    padded = np.pad(x, ((radius, radius), (0, 0)), mode="symmetric")
    return np.stack([np.correlate(column, weight, mode="valid") for column in padded.T], axis=1)
