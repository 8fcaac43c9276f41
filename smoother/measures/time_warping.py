"""Where a pattern occurs in a longer series, faster or slower: dynamic time warping with bounded tempo.

Own and minimal. Looked at: stumpy (matrix profiles) compares windows of one fixed length, so a round done
half as fast does not match, and brings numba and LLVM (some 150 MB); dtaidistance aligns whole series and
has the subsequence search in compiled extras; both would outweigh the forty lines below.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray, IntArray


def match_cost(pattern: FloatArray, series: FloatArray) -> tuple[FloatArray, IntArray]:
    """Least mean distance of the pattern to a part of the series that ends at each sample.

    Sakoe and Chiba, IEEE Trans Acoust Speech Signal Process 26:43-49 (1978), symmetric form with slope
    constraint P = 1 (tempo between half and double); the series' start is free (Mueller, Information
    Retrieval for Music and Motion, 2007, section 4.4). Steps: one sample of both; two of the series for one
    of the pattern; one of the series for two of the pattern.

    Parameters
    ----------
    pattern : ndarray, shape (m, k)
        What to look for.
    series : ndarray, shape (n, k)
        Where; nan where there is none.

    Returns
    -------
    cost : ndarray, shape (n,)
        Sum of the distances by their weight over the sum of the weights; inf where nothing can end.
    start : ndarray of int, shape (n,)
        Where that part begins.
    """
    n, columns = len(series), np.arange(len(series))
    distance = [np.nan_to_num(np.linalg.norm(series - row, axis=1), nan=np.inf) for row in pattern]
    # total cost, weight and start of the best path that ends at (row, column); two rows before are enough
    nowhere = (np.full(n, np.inf), np.ones(n), columns)
    before, last = nowhere, (distance[0], np.ones(n), columns)
    for i in range(1, len(pattern)):
        here, above = distance[i], distance[i - 1]
        diagonal, wide, tall = _moved(last, 1), _moved(last, 2), _moved(before, 1)
        totals = np.stack(
            [
                diagonal[0] + 2.0 * here,
                wide[0] + 2.0 * np.concatenate([[np.inf], here[:-1]]) + here,
                tall[0] + 2.0 * above + here,
            ]
        )
        weights = np.stack([diagonal[1] + 2.0, wide[1] + 3.0, tall[1] + 3.0])
        starts = np.stack([diagonal[2], wide[2], tall[2]])
        choice = np.argmin(totals / weights, axis=0)
        before, last = last, (totals[choice, columns], weights[choice, columns], starts[choice, columns])
    return last[0] / last[1], last[2].astype(np.int64)


def _moved(path: tuple[FloatArray, FloatArray, IntArray], by: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """The entries of so many columns before; where there are none no path ends."""
    total, weight, start = (_later(part, by) for part in path)
    total[:by] = np.inf
    return total, weight, start


def _later(row: NDArray, by: int) -> NDArray:
    """A row whose entry j is the one of j - by; the first ones stay."""
    moved = row.copy()
    moved[by:] = row[:-by]
    return moved
