"""A clock that was set back while a sensor or a camera ran: where, and times that go on."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...array_types import FloatArray, IntArray

#: A clock is set by more than this many usual intervals, and this long, s; what is less is jitter.
_INTERVALS, _LEAST_S = 2.5, 0.05
#: More steps back in a file are no clock that somebody set.
_MOST = 6
#: So many steps on both sides are regular: this share of them lies within these parts of the usual interval.
_BESIDE, _REGULAR = 12, (0.25, 3.0, 0.8)
#: Fewer than this on one side tell nothing.
_FEWEST = 4
#: The level of the stamps is compared over so many rows; it falls by the step, to this part of it.
_LEVEL, _SAME = 50, 0.3


def clock_resets(
    t_s: FloatArray, values: FloatArray | None = None
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Times of a clock that was set back, made to go on at the usual interval.

    Rows out of order are left alone: what was written late fills what is missing before it. So are rows that
    are there twice.

    Parameters
    ----------
    t_s : ndarray, shape (n,), s
        Stamps in the order of the rows.
    values : ndarray, shape (n, k), optional
        What was measured; rows that repeat an earlier time and its values are there twice.

    Returns
    -------
    t_s : ndarray, shape (n,), s
        The same array where no clock was set back.
    steps : list of (float, float), s
        By how much it was set back, and how long after the first row.
    """
    dt = np.diff(t_s)
    if len(dt) < 2 * _FEWEST or not (dt < 0).any():
        return t_s, []
    usual = float(np.median(dt[dt > 0])) if (dt > 0).any() else 0.0
    least = max(_INTERVALS * usual, _LEAST_S)
    rows = np.flatnonzero(usual - dt > least) + 1
    if not usual > 0 or not 0 < len(rows) <= _MOST or _fill_up(t_s, dt, usual, least):
        return t_s, []
    edges = [0, *rows.tolist(), len(t_s)]
    added, steps = np.zeros(len(t_s)), []
    for before, row, after in zip(edges, edges[1:], edges[2:], strict=False):
        by = usual - float(dt[row - 1])
        if _lasts(t_s, slice(before, row), slice(row, after), usual, by) and not _again(t_s, values, row):
            steps.append((by, float(t_s[row - 1] + added[row - 1] - t_s[0])))
            added[row:] += by
    return (t_s + added, steps) if steps else (t_s, [])


def begins_frames(time: FloatArray, kind: IntArray) -> bool:
    """Whether a table of a row a joint holds frame after frame though its times go back here and there.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Of each row; those of one frame stand together.
    kind : ndarray of int, shape (n,)
        Joint and body of each row: where times go back, a frame begins with what the first row holds. A file
        that lists one joint or body after the other begins with another there.
    """
    back = np.flatnonzero(np.diff(time) < 0) + 1
    return 0 < len(back) <= _MOST and len(np.unique(kind)) > 1 and bool((kind[back] == kind[0]).all())


def resets_message(steps: list[tuple[float, float]], what: str) -> str:
    """A sentence on steps of a clock; `what` are the rows behind them."""
    back = ", ".join(f"by {by:.{1 if by >= 0.95 else 2}f} s at {at:.1f} s" for by, at in steps)
    return (
        f"The clock was set back {back}: the {what} behind {'it go' if len(steps) == 1 else 'them go'} on"
        " after the ones before at the usual interval."
    )


def _fill_up(t_s: FloatArray, dt: FloatArray, usual: float, least: float) -> bool:
    """Whether the rows between jumps, put in order, leave fewer jumps and no overlap: pages out of order."""
    jumps = np.flatnonzero((usual - dt > least) | (dt > least)) + 1
    if len(jumps) > 20 * _MOST:
        return False
    pages = [t_s[first:last] for first, last in pairwise([0, *jumps.tolist(), len(t_s)])]
    ends = sorted((float(page.min()), float(page.max())) for page in pages)
    between = np.array([later[0] - earlier[1] for earlier, later in pairwise(ends)])
    return bool((between > -0.5 * usual).all() and (between > least).sum() < len(jumps))


def _lasts(t_s: FloatArray, before: slice, after: slice, usual: float, by: float) -> bool:
    """Whether stamps run evenly on both sides of a step, and stay down behind it."""
    earlier, later = t_s[before][-_LEVEL:], t_s[after][:_LEVEL]
    if min(len(earlier), len(later)) <= _FEWEST:
        return False
    for steps in (np.diff(earlier)[-_BESIDE:], np.diff(later)[:_BESIDE]):
        low, high, share = _REGULAR
        if ((steps > low * usual) & (steps < high * usual)).mean() < share:
            return False
    rows = np.arange(-len(earlier), len(later))
    level = np.concatenate([earlier, later]) - usual * rows
    fall = np.median(level[: len(earlier)]) - np.median(level[len(earlier) :])
    return bool(abs(fall - by) < _SAME * by)


def _again(t_s: FloatArray, values: FloatArray | None, row: int) -> bool:
    """Whether the rows from one on repeat earlier ones, times and values."""
    if values is None:
        return False
    rows = slice(row, row + _BESIDE)
    moving = values[rows][np.isfinite(values[rows]).all(axis=1)]
    if not len(moving) or (moving == moving[0]).all():  # hidden, or held: nothing tells them apart
        return False
    for at in np.flatnonzero(np.abs(t_s[:row] - t_s[row]) < 1e-9).tolist():
        earlier = slice(at, at + len(t_s[rows]))
        if np.allclose(t_s[earlier], t_s[rows], rtol=0, atol=1e-9) and np.array_equal(
            values[earlier], values[rows], equal_nan=True
        ):
            return True
    return False
