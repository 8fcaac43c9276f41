"""How late an answer, or the camera's own samples, are against a reference: the peak of their correlation.

Sliding two whole signals over each other cuts every gap short at every lag. Here the samples stay as they are
and the reference, which is known everywhere, is read earlier or later: the same samples take part at every
lag, so that short gaps do not bias the peak (Feng 2014, 4.5.3, unbiased).
"""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..linalg import parabola_vertex
from .align import linear_at

#: Lags looked at, s: up to this in coarse steps, then about the best one in finer steps.
LONGEST_S, COARSE_S, FINE_S = 0.5, 0.02, 0.002
#: From fewer samples no lag is read; more than the second make it no surer.
FEWEST, MOST = 20, 20_000


def lag_s(
    t_s: FloatArray,
    samples: FloatArray,
    reference: FloatArray,
    reference_t_s: FloatArray | None = None,
) -> float | None:
    """Lag of samples behind a reference.

    Parameters
    ----------
    t_s : ndarray, shape (n,), s
        Times of the samples, rising.
    samples : ndarray, shape (n, d)
        nan rows take no part.
    reference : ndarray, shape (m, d)
        In the same unit; nan where there is none.
    reference_t_s : ndarray, shape (m,), s, optional
        Its times, rising, on the same clock; those of the samples if None.

    Returns
    -------
    lag : float or None, s
        Positive where the samples are late. None where nothing moves, too little is known, or the peak lies
        beyond half a second: then the samples do not follow the reference.
    """
    t_reference = t_s if reference_t_s is None else reference_t_s
    coarse = _coarse_lags()
    roughly = _peak(coarse, _correlations(t_s, samples, reference, t_reference, coarse))
    if roughly is None:
        return None
    fine = np.linspace(roughly - 10 * FINE_S, roughly + 10 * FINE_S, 21)
    exactly = _peak(fine, _correlations(t_s, samples, reference, t_reference, fine))
    return roughly if exactly is None else exactly


def best_correlation(t_s: FloatArray, samples: FloatArray, reference: FloatArray) -> float | None:
    """The largest correlation of samples and a reference (n, d), both at times (n,) s, at any lag.

    None where nothing moves or too little is known.
    """
    r = _correlations(t_s, samples, reference, t_s, _coarse_lags())
    return float(np.nanmax(r)) if np.isfinite(r).any() else None


def _coarse_lags() -> FloatArray:
    return np.arange(-LONGEST_S, LONGEST_S + 0.5 * COARSE_S, COARSE_S)


def _correlations(
    t_s: FloatArray, samples: FloatArray, reference: FloatArray, t_reference: FloatArray, lags: FloatArray
) -> FloatArray:
    """Correlation at each lag (k,); nan where too little is known."""
    r = np.full(len(lags), np.nan)
    known = np.flatnonzero(np.isfinite(samples).all(axis=1))
    known = known[:: max(1, len(known) // MOST)]
    if len(known) < FEWEST:
        return r
    t, a = t_s[known], samples[known]
    for k, lag in enumerate(lags):
        b = linear_at(t_reference, reference, t - lag)
        both = np.isfinite(b).all(axis=1)
        if both.sum() >= FEWEST:
            r[k] = _correlation(a[both], b[both])
    return r


def _peak(lags: FloatArray, r: FloatArray) -> float | None:
    """The vertex of the parabola through the three highest; None at the ends."""
    best = int(np.nanargmax(r)) if np.isfinite(r).any() else 0
    around = slice(best - 1, best + 2)
    if not 0 < best < len(r) - 1 or not np.isfinite(r[around]).all():
        return None
    return parabola_vertex(lags[around], -r[around])


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Over all columns together, each about its own mean; nan where one stands still."""
    x, y = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = float(np.sqrt((x * x).sum() * (y * y).sum()))
    return float((x * y).sum()) / scale if scale > 1e-9 * len(a) else float("nan")
