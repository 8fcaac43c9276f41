"""How late an answer is against a reference: the peak of their cross-correlation (Feng 2014, 4.5.3)."""

from __future__ import annotations

import numpy as np

from ..recording import BoolArray, FloatArray

#: Lags looked at, s.
LONGEST_S = 0.5
#: Fewer samples than this tell no lag.
FEWEST = 20


def lag_s(t_s: FloatArray, answer: FloatArray, reference: FloatArray) -> float | None:
    """Lag, s; positive where the answer is late. None where nothing moves, or too little is known.

    Both are read on an even grid; at every lag the correlation is taken over the samples that both have,
    over all columns together, and the peak is the vertex of the parabola through the three highest.

    Parameters
    ----------
    t_s : (N,) rising.
    answer, reference : (N, D) at these times; nan where there is none.
    """
    known: BoolArray = np.asarray(np.isfinite(answer).all(axis=1) & np.isfinite(reference).all(axis=1))
    if known.sum() < FEWEST:
        return None
    period = float(np.median(np.diff(t_s)))
    grid = np.arange(t_s[0], t_s[-1], period)
    nearest = np.clip(np.searchsorted(t_s, grid), 1, len(t_s) - 1)
    close = np.abs(
        np.where(grid - t_s[nearest - 1] < t_s[nearest] - grid, t_s[nearest - 1], t_s[nearest]) - grid
    )
    inside = (close <= period) & known[nearest] & known[nearest - 1]
    a, b = (
        np.where(
            inside[:, None], np.column_stack([np.interp(grid, t_s[known], c) for c in x[known].T]), np.nan
        )
        for x in (answer, reference)
    )
    most = max(2, round(LONGEST_S / period))
    shifts = np.arange(-most, most + 1)
    lags: FloatArray = np.asarray(period * shifts, dtype=np.float64)
    r = np.array([_correlation(a, b, int(shift)) for shift in shifts])
    return peak(lags, r)


def peak(lags: FloatArray, r: FloatArray) -> float | None:
    """The vertex of the parabola through the three highest; None at the ends."""
    if not np.isfinite(r).any():
        return None
    best = int(np.nanargmax(r))
    if not 0 < best < len(r) - 1 or not np.isfinite(r[best - 1 : best + 2]).all():
        return None
    before, at, after = r[best - 1 : best + 2]
    bend = before - 2 * at + after
    vertex = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(lags[best] + vertex * (lags[1] - lags[0]))


def _correlation(a: FloatArray, b: FloatArray, shift: int) -> float:
    """Correlation of a(t + shift) with b(t) over all columns, each about its own mean."""
    late = a[shift:] if shift >= 0 else a[:shift]
    early = b[: len(b) - shift] if shift >= 0 else b[-shift:]
    both = np.isfinite(late[:, 0]) & np.isfinite(early[:, 0])
    if both.sum() < FEWEST:
        return float("nan")
    x, y = late[both] - late[both].mean(axis=0), early[both] - early[both].mean(axis=0)
    scale = np.sqrt((x * x).sum() * (y * y).sum())
    return float((x * y).sum() / scale) if scale > 1e-12 else float("nan")
