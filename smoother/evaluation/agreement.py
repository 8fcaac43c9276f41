"""How well two measurements of the same agree: bias, limits of agreement, ICC(A,1).

Sources: Bland and Altman, Lancet 327:307-310 (1986); McGraw and Wong, Psychological Methods 1:30-46
(1996), ICC(A,1) of their tables 4 and 7: two-way, absolute agreement, single measurement.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import wrapped_deg

#: Half width of the limits of agreement in standard deviations.
LIMITS = 1.96
#: The confidence of the interval of the ICC.
CONFIDENCE = 0.95
#: Samples are no longer alike where their autocorrelation has fallen to this.
FORGOTTEN = 0.05


@dataclass(frozen=True)
class Agreement:
    """Agreement of an answer with a reference, in the unit of both; None where there are too few samples.

    Attributes
    ----------
    rmse : float or None
        Root mean square of answer minus reference.
    bias : float or None
        Mean of answer minus reference.
    limits_low, limits_high : float or None
        Limits of agreement, bias -+ 1.96 standard deviations.
    icc, icc_low, icc_high : float or None
        ICC(A,1) with its 95 % interval.
    samples : int
        How many were compared.
    independent : float
        Samples as the interval counts them: neighbours in time are not independent.
    """

    rmse: float | None
    bias: float | None
    limits_low: float | None
    limits_high: float | None
    icc: float | None
    icc_low: float | None
    icc_high: float | None
    samples: int
    independent: float

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self)


def agreement(answer: FloatArray, reference: FloatArray, *, degrees: bool = False) -> Agreement:
    """Agreement of two series; a pair with nan is left out.

    Parameters
    ----------
    answer, reference : ndarray, shape (n,)
        In the order of time.
    degrees : bool
        Angles, whose differences are taken the short way round.
    """
    good = np.isfinite(answer) & np.isfinite(reference)
    answer, reference = answer[good], reference[good]
    if degrees:
        answer, reference = unwound_deg(answer, reference)
    count = len(answer)
    if count < 3:
        return Agreement(None, None, None, None, None, None, None, count, float(count))
    difference = answer - reference
    bias, spread = float(difference.mean()), float(difference.std(ddof=1))
    independent = count / memory(reference)
    icc, low, high = icc_a1(np.column_stack([answer, reference]), independent)
    return Agreement(
        rmse=float(np.sqrt(np.mean(difference**2))),
        bias=bias,
        limits_low=bias - LIMITS * spread,
        limits_high=bias + LIMITS * spread,
        icc=icc,
        icc_low=low,
        icc_high=high,
        samples=count,
        independent=independent,
    )


def unwound_deg(answer: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles without jumps of a full turn, from sample to sample, the answer beside the reference."""
    wound = np.unwrap(reference, period=360.0)
    if len(wound):
        wound = wound - 360.0 * np.round(np.median(wound) / 360.0)
    return wound + wrapped_deg(answer - reference), wound


def memory(values: FloatArray) -> float:
    """How many samples in a row count as one (integrated autocorrelation time), 1 or more."""
    x = values - values.mean()
    count = len(x)
    if not x.any():
        return float(count)
    spectrum = np.abs(np.fft.rfft(x, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count]
    correlation = correlation / correlation[0]
    below = np.flatnonzero(correlation < FORGOTTEN)
    last = below[0] if len(below) else count
    return float(min(count / 2.0, max(1.0, 1.0 + 2.0 * correlation[1:last].sum())))


def icc_a1(
    ratings: FloatArray, independent: float | None = None
) -> tuple[float | None, float | None, float | None]:
    """ICC(A,1) and its 95 % interval.

    Parameters
    ----------
    ratings : ndarray, shape (n, k)
        n subjects (here samples) by k raters.
    independent : float, optional
        Number of independent subjects for the interval; n if None.
    """
    from scipy.stats import f as f_distribution

    n, k = ratings.shape
    rows, columns, grand = ratings.mean(axis=1), ratings.mean(axis=0), ratings.mean()
    between_rows = k * ((rows - grand) ** 2).sum() / (n - 1)
    column_variance = ((columns - grand) ** 2).sum() / (k - 1)
    residual = ratings - rows[:, None] - columns + grand
    error = (residual**2).sum() / ((n - 1) * (k - 1))
    icc = _icc(between_rows, n * column_variance, error, n, k)
    if icc is None:
        return None, None, None
    m = max(float(n if independent is None else independent), 3.0)
    between_columns = m * column_variance
    if error <= 0 or icc >= 1:
        return icc, icc, icc
    a = k * icc / (m * (1 - icc))
    b = 1 + k * icc * (m - 1) / (m * (1 - icc))
    freedom = (a * between_columns + b * error) ** 2 / (
        (a * between_columns) ** 2 / (k - 1) + (b * error) ** 2 / ((m - 1) * (k - 1))
    )
    tail = 0.5 * (1 + CONFIDENCE)
    upper, lower = f_distribution.ppf(tail, m - 1, freedom), f_distribution.ppf(tail, freedom, m - 1)
    others = k * between_columns + (k * m - k - m) * error
    low = m * (between_rows - upper * error) / (upper * others + m * between_rows)
    high = m * (lower * between_rows - error) / (others + m * lower * between_rows)
    return icc, float(low), float(high)


def _icc(rows: float, columns: float, error: float, n: int, k: int) -> float | None:
    whole = rows + (k - 1) * error + k / n * (columns - error)
    return float((rows - error) / whole) if whole > 0 else None
