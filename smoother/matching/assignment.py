"""One assignment of all IMUs to limbs, and how probable each of its pairs is."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from ..array_types import FloatArray, IntArray

#: A limb that an IMU cannot be on costs this.
_NEVER = 1e6


def assign(weight: FloatArray, none: FloatArray) -> IntArray:
    """The assignment of largest total weight: each IMU to one limb or none, each limb to one IMU at most.

    Rectangular assignment (Crouse, IEEE Trans. Aerosp. Electron. Syst. 2016) by
    `scipy.optimize.linear_sum_assignment`; every IMU has a column `none` of its own.

    Parameters
    ----------
    weight : ndarray, shape (k, m)
        Log-posterior weight of IMU i on limb j.
    none : ndarray, shape (k,)
        Of IMU i on none.

    Returns
    -------
    limb : ndarray of int, shape (k,)
        -1 for none.
    """
    k, m = weight.shape
    columns = _with_none(weight, none)
    rows, chosen = linear_sum_assignment(-columns)
    limb = np.full(k, -1)
    limb[rows] = np.where(chosen < m, chosen, -1)
    return limb


def probabilities(weight: FloatArray, none: FloatArray) -> FloatArray:
    """How probable each pair is, over all assignments.

    For every IMU and every limb (or none) the best assignment that has this pair is found; an IMU's
    probabilities are in the ratio of these assignments' weights (max-marginals). IMUs that nothing tells
    apart therefore share a limb evenly, and a limb that another IMU fits better is no candidate any more.

    Parameters
    ----------
    weight, none
        As in `assign`.

    Returns
    -------
    probability : ndarray, shape (k, m + 1)
        Rows sum to one; the last column is `none`.
    """
    k, m = weight.shape
    columns = _with_none(weight, none)
    total = np.full((k, m + 1), -np.inf)
    for i in range(k):
        others = np.delete(columns, i, axis=0)
        for j in range(m + 1):
            # `none` takes nobody's limb; another IMU keeps its own `none`
            free = np.delete(others, j if j < m else m + i, axis=1)
            rows, chosen = linear_sum_assignment(-free)
            total[i, j] = (weight[i, j] if j < m else none[i]) + free[rows, chosen].sum()
    total -= total.max(axis=1, keepdims=True)
    share = np.exp(total)
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _with_none(weight: FloatArray, none: FloatArray) -> FloatArray:
    k = len(weight)
    own = np.full((k, k), -_NEVER)
    own[np.diag_indices(k)] = none
    return np.hstack([np.maximum(weight, -_NEVER), own])
