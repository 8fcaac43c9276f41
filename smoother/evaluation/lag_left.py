"""The lag left in part of an answer, or in the camera's own samples: the peak of a cross-correlation.

`lag.lag_s` slides two whole signals over each other. Inside gaps that cuts every gap short at every lag.
Here the samples stay as they are and the reference, which is known everywhere, is read earlier or later:
the same samples take part at every lag, so short gaps do not bias the peak (Feng 2014, 4.5.3, unbiased).
"""

from __future__ import annotations

import numpy as np

from ..recording import FloatArray
from .align import linear_at
from .lag import FEWEST, LONGEST_S, peak

#: Lags are looked at in steps of this, then about the best one in finer steps, s.
COARSE_S, FINE_S = 0.02, 0.002
#: More samples than this make a lag no surer.
MOST = 20_000


def lag_left_s(
    t_s: FloatArray, samples: FloatArray, reference_t_s: FloatArray, reference: FloatArray
) -> float | None:
    """Lag of samples behind a reference, s; positive where they are late.

    None where nothing moves, too little is known, or the peak lies beyond half a second: then the
    samples do not follow the reference.

    Parameters
    ----------
    t_s : (N,) rising.
    samples : (N, 3) m; nan rows take no part.
    reference_t_s : (M,) rising, on the same clock.
    reference : (M, 3) m; nan where there is none.
    """
    known = np.flatnonzero(np.isfinite(samples).all(axis=1))
    known = known[:: max(1, len(known) // MOST)]
    if len(known) < FEWEST:
        return None
    t, a = t_s[known], samples[known]

    def correlation(lag_s: float) -> float:
        b = linear_at(reference_t_s, reference, t - lag_s)
        both = np.isfinite(b).all(axis=1)
        return _correlation(a[both], b[both]) if both.sum() >= FEWEST else float("nan")

    coarse = np.arange(-LONGEST_S, LONGEST_S + 0.5 * COARSE_S, COARSE_S)
    best = peak(coarse, np.array([correlation(float(lag)) for lag in coarse]))
    if best is None:
        return None
    fine = np.linspace(best - 10 * FINE_S, best + 10 * FINE_S, 21)
    return peak(fine, np.array([correlation(float(lag)) for lag in fine])) or best


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Over all columns together, each about its own mean; nan where one stands still."""
    x, y = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = float(np.sqrt((x * x).sum() * (y * y).sum()))
    return float((x * y).sum()) / scale if scale > 1e-9 * len(a) else float("nan")
