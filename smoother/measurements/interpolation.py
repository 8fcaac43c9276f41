"""Samples that a program put into a gap and called tracked: they lie on one polynomial, which no camera's do.

Programs that export skeletons fill gaps by straight lines or cubics (Pose2Sim, many a motion capture suite),
some before a low pass, which leaves a long filling a polynomial but for its ends. The fourth difference of a
line or a cubic is zero; that of what a camera saw has the camera's noise.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..linalg import runs

#: A fourth difference counts as none below this part of the joint's usual one, and of the step from sample
#: to sample: cameras that smooth (Kinect v1) are nearly free of noise where an arm rests, not where it moves.
PART, PART_OF_STEP = 0.02, 0.01
#: So many in a row are no accident.
IN_A_ROW = 4
#: Samples that the fourth difference is made of.
STENCIL = 5
#: Stencils that reach farther than this, in usual ones, are left out.
LONGEST = 1.5
#: A joint whose usual fourth difference is smaller has no noise to tell by, m.
NOISELESS_M = 1e-5


def interpolated(t_s: FloatArray, position: FloatArray, accepted: BoolArray) -> BoolArray:
    """Samples of one joint that were filled in.

    Parameters
    ----------
    t_s : ndarray, shape (f,), s
        Frame times, increasing.
    position : ndarray, shape (f, 3), m
    accepted : ndarray of bool, shape (f,)
        Samples that call themselves tracked.

    Returns
    -------
    filled : ndarray of bool, shape (f,)
        The last sample before and the first after a filling are the camera's own.
    """
    filled = np.zeros(len(t_s), dtype=bool)
    rows = np.flatnonzero(accepted)
    if len(rows) < 4 * STENCIL:
        return filled
    x, t = position[rows], t_s[rows]
    step = np.linalg.norm(np.diff(x, axis=0), axis=1)
    usual_step = sliding_window_view(step, STENCIL - 1).mean(axis=1)
    reach = t[STENCIL - 1 :] - t[: 1 - STENCIL]
    broken = reach > LONGEST * np.median(reach)  # over a gap a difference by time is small for its own reason
    for difference in (np.diff(x, STENCIL - 1, axis=0), _by_time(t, x)):
        size = np.where(broken, np.inf, np.abs(difference).max(axis=1))
        usual = float(np.median(size))
        if usual < NOISELESS_M:
            continue
        for run in runs(np.asarray(size < np.minimum(PART * usual, PART_OF_STEP * usual_step))):
            first, last = run.start, run.stop + STENCIL - 2  # samples on the polynomial, both ends its own
            if run.stop - run.start >= IN_A_ROW:
                filled[rows[first + 1 : last]] = True
    return filled


def _by_time(t: FloatArray, x: FloatArray) -> FloatArray:
    """Fourth differences (n - 4, 3) m for uneven times: divided ones at the usual spacing."""
    step = float(np.median(np.diff(t)))
    difference = x
    for order in range(1, STENCIL):
        difference = np.diff(difference, axis=0) / ((t[order:] - t[:-order]) / (order * step))[:, None]
    return difference
