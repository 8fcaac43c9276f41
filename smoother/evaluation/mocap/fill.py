"""Markers on the forearm that were hidden for a moment, filled in the axes of the IMU's plate."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
from ...linalg import runs
from ..align import STAMP_S

#: What is hidden for longer stays unknown, s.
LONGEST_S = 0.75
#: Visible time on each side that is fitted, s, and how much of it must be there.
SIDE_S, LEAST_SIDE_S = 0.25, 0.1


def fill_on_plate(
    t_s: FloatArray, position: FloatArray, R_E_P: FloatArray, p_E_P: FloatArray
) -> tuple[FloatArray, int]:
    """A marker's path, filled where it was hidden for a moment.

    As seen from the plate, a marker on the same bone hardly moves and one beyond the elbow moves smoothly:
    there a cubic is fitted to what was seen in the 0.25 s before and after.

    Parameters
    ----------
    t_s : ndarray, shape (n,), s
        Times.
    position : ndarray, shape (n, 3), m
        In {E}; nan where it was not seen.
    R_E_P, p_E_P : ndarray, shape (n, 3, 3) and (n, 3), m
        Pose of the plate; nan where it has none.

    Returns
    -------
    path : ndarray, shape (n, 3), m
        The path with what was filled.
    count : int
        Samples that were filled.
    """
    on_plate = np.einsum("nji,nj->ni", R_E_P, position - p_E_P)
    seen, known, has_plate = (
        np.asarray(np.isfinite(each).all(axis=1)) for each in (position, on_plate, p_E_P)
    )
    filled, count = position.copy(), 0
    for missing in runs(~seen):
        first, stop = missing.start, missing.stop
        if first == 0 or stop == len(t_s) or t_s[stop] - t_s[first - 1] > LONGEST_S:
            continue
        begin, end = t_s[first - 1], t_s[stop]
        before = known & (t_s >= begin - SIDE_S) & (t_s <= begin + STAMP_S)
        after = known & (t_s >= end - STAMP_S) & (t_s <= end + SIDE_S)
        if not all(side.any() and np.ptp(t_s[side]) >= LEAST_SIDE_S for side in (before, after)):
            continue
        middle = 0.5 * (begin + end)
        beside = np.flatnonzero(before | after)
        fit = np.polynomial.polynomial.polyfit(t_s[beside] - middle, on_plate[beside], 3)
        rows = np.arange(first, stop)[has_plate[first:stop]]
        there = np.polynomial.polynomial.polyval(t_s[rows] - middle, fit).T
        filled[rows] = np.einsum("nij,nj->ni", R_E_P[rows], there) + p_E_P[rows]
        count += len(rows)
    return filled, count
