"""Filters along a series as SciPy's `ndimage` has them, which takes longer to load than they take to run."""

from __future__ import annotations

import numpy as np

from .array_types import FloatArray


def moving_mean(x: FloatArray, width: int) -> FloatArray:
    """Mean over neighbouring samples; beyond its ends the series goes on with its end values.

    Parameters
    ----------
    x : ndarray, shape (n,)
    width : int
        Samples, from `width // 2` before each one on.

    Returns
    -------
    mean : ndarray, shape (n,)
    """
    padded = np.pad(x - x[0], (width // 2, width - 1 - width // 2), mode="edge")  # small sums lose less
    total = np.concatenate(([0.0], np.cumsum(padded)))
    return np.asarray(x[0] + (total[width:] - total[:-width]) / width)


def moving_median(x: FloatArray, width: int) -> FloatArray:
    """Median over neighbouring samples, column by column; the ends go on with their values.

    Parameters
    ----------
    x : ndarray, shape (n, k)
    width : int
        Samples, odd.

    Returns
    -------
    median : ndarray, shape (n, k)
    """
    padded = np.pad(x, ((width // 2, width // 2), (0, 0)), mode="edge")
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, width, axis=0), axis=-1))


def gaussian_smoothed(x: FloatArray, sigma: float, derivative: bool = False) -> FloatArray:
    """Smoothed by a Gaussian, or its first derivative a sample; mirrored at the ends.

    Parameters
    ----------
    x : ndarray, shape (n, k)
    sigma : float
        Of the Gaussian, samples; it is cut off at four of them.
    derivative : bool

    Returns
    -------
    y : ndarray, shape (n, k)
    """
    radius = int(4.0 * sigma + 0.5)
    offset = np.arange(-radius, radius + 1)
    weight = np.exp(-0.5 * (offset / sigma) ** 2)
    weight /= weight.sum()
    if derivative:
        weight *= offset / sigma**2
    padded = np.pad(x, ((radius, radius), (0, 0)), mode="symmetric")
    return np.stack([np.correlate(column, weight, mode="valid") for column in padded.T], axis=1)
