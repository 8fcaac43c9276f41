"""Fewer points for the eye: long recordings must still open, and gaps must keep their shape."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation

from ..array_types import BoolArray, FloatArray, IntArray
from ..linalg import runs

#: Most points of one drawn line.
MOST_POINTS = 4000
#: Share of them that the gaps may take.
GAP_SHARE = 0.6


def decimate(important: BoolArray, most: int = MOST_POINTS) -> IntArray:
    """Samples to draw: at most `most`, evenly spaced, closer together where it is important.

    Parameters
    ----------
    important : ndarray of bool, shape (n,)
        Samples that matter most (the occluded ones).

    most : int
        Samples to draw.

    Returns
    -------
    index : ndarray of int, shape (m,)
        In rising order; first and last sample are among them.
    """
    count = len(important)
    if count <= most:
        return np.arange(count)
    wide = binary_dilation(important, np.ones(21))  # with their edges
    inside, outside = np.flatnonzero(wide), np.flatnonzero(~wide)
    budget_inside = min(len(inside), int(GAP_SHARE * most))
    ends = np.array([0, count - 1])
    chosen = [_every(inside, budget_inside), _every(outside, most - budget_inside - 2), ends]
    return np.unique(np.concatenate(chosen))


def _every(index: IntArray, most: int) -> IntArray:
    if len(index) <= most or most <= 0:
        return index[: max(most, 0)]
    return index[np.linspace(0, len(index) - 1, most).round().astype(np.int64)]


def split_line(values: FloatArray, occluded: BoolArray) -> tuple[FloatArray, FloatArray]:
    """A line's visible and its occluded part (N, ...), nan where it is the other; they meet at the edges."""
    edge = occluded.copy()
    edge[:-1] |= occluded[1:]
    edge[1:] |= occluded[:-1]
    shape = (-1,) + (1,) * (values.ndim - 1)
    visible = np.where(occluded.reshape(shape), np.nan, values)
    hidden = np.where(edge.reshape(shape), values, np.nan)
    return visible, hidden


def band(t_s: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outline (x, y) of the area between two curves: a closed loop each run without nan, nan between."""
    finite = np.isfinite(low) & np.isfinite(high) & np.isfinite(t_s)
    x: list[FloatArray] = []
    y: list[FloatArray] = []
    for part in runs(finite):
        x += [t_s[part], t_s[part][::-1], np.array([np.nan])]
        y += [high[part], low[part][::-1], np.array([np.nan])]
    if not x:
        return np.zeros(0), np.zeros(0)
    return np.concatenate(x), np.concatenate(y)
