"""How well two measurements agree, and how reliable repeated ones are: limits of agreement, ICC, SEM, MDC.

Sources: Bland and Altman, Lancet 327:307-310 (1986), limits of agreement; Shrout and Fleiss, Psychological
Bulletin 86:420-428 (1979), ICC(2,1), which is ICC(A,1) of McGraw and Wong, Psychological Methods 1:30-46
(1996), tables 4 and 7: two-way, absolute agreement, single measurement; Weir, J Strength Cond Res 19:231-240
(2005), SEM and minimal difference; de Vet et al., J Clin Epidemiol 59:1033-1039 (2006), SEM_agreement.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..angles.definitions import wrapped_deg
from ..array_types import FloatArray

#: Half width of the limits of agreement in standard deviations.
LIMITS = 1.96
#: The upper end of an interval of 95 %.
_HIGH = 0.975
#: Samples are no longer alike where their autocorrelation has fallen to this.
FORGOTTEN = 0.05
#: Fewer pairs have a mean difference and nothing else.
FEWEST_PAIRS = 3

#: Agreement of an answer with a reference, in the unit of both, by name; None where samples are too few.
Agreement = dict[str, Any]
_ICC = ("icc", "icc_low", "icc_high")
_LIMITS = ("bias", "limits_low", "limits_high")


def agreement(answer: FloatArray, reference: FloatArray, *, degrees: bool = False) -> Agreement:  # (n,)
    """Agreement of two series in time; a pair with nan is left out.

    `independent`: samples as the interval of the ICC counts them, as neighbours in time are not independent.
    """
    good = np.isfinite(answer) & np.isfinite(reference)
    answer, reference = answer[good], reference[good]
    if degrees:
        answer, reference = unwound_deg(answer, reference)
    count, difference = len(answer), answer - reference
    found: Agreement = {"samples": count, "independent": float(count)}
    if count < FEWEST_PAIRS:
        return found | dict.fromkeys(("rmse", *_LIMITS, *_ICC))
    found |= {"independent": count / memory(reference), "rmse": float(np.sqrt(np.mean(difference**2)))}
    icc = icc_a1(np.column_stack([answer, reference]), found["independent"])
    return found | limits_of_agreement(difference) | dict(zip(_ICC, icc, strict=True))


def limits_of_agreement(difference: FloatArray) -> dict[str, float]:  # difference (n,)
    """Mean difference and limits of agreement (-+ 1.96 standard deviations)."""
    bias, half = float(difference.mean()), LIMITS * float(difference.std(ddof=1))
    return dict(zip(_LIMITS, (bias, bias - half, bias + half), strict=True))


def unwound_deg(answer: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles without jumps of a full turn, from sample to sample, the answer beside the reference."""
    wound = np.unwrap(reference, period=360.0)
    if len(wound):
        wound = wound - 360.0 * np.round(np.median(wound) / 360.0)
    return wound + wrapped_deg(answer - reference), wound


def memory(values: FloatArray) -> float:
    """How many samples in a row are equivalent to one (integrated autocorrelation time), 1 or more."""
    x = values - values.mean()
    count = len(x)
    if not x.any():
        return float(count)
    correlation = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * count)) ** 2)[:count]
    correlation = correlation / correlation[0]
    below = np.flatnonzero(correlation < FORGOTTEN)
    last = below[0] if len(below) else count
    return float(min(count / 2.0, max(1.0, 1.0 + 2.0 * correlation[1:last].sum())))


def mean_squares(ratings: FloatArray) -> tuple[float, float, float]:  # ratings (n, k)
    """Between rows (persons), between columns (sessions, raters), and of the error."""
    n, k = ratings.shape
    rows, columns, grand = ratings.mean(axis=1), ratings.mean(axis=0), ratings.mean()
    residual = ratings - rows[:, None] - columns + grand
    error = (residual**2).sum() / ((n - 1) * (k - 1))
    return float(k * ((rows - grand) ** 2).sum() / (n - 1)), float(n * columns.var(ddof=1)), float(error)


def icc_a1(
    ratings: FloatArray,
    independent: float | None = None,  # ratings (n, k)
) -> tuple[float | None, float | None, float | None]:
    """ICC(A,1) and its interval."""
    from scipy.stats import f as f_distribution

    n, k = ratings.shape
    between_rows, between_columns, error = mean_squares(ratings)
    whole = between_rows + (k - 1) * error + k / n * (between_columns - error)
    if whole <= 0:
        return None, None, None
    icc = (between_rows - error) / whole
    m = max(float(n if independent is None else independent), 3.0)
    between_columns *= m / n
    if error <= 0 or icc >= 1:
        return icc, icc, icc
    a = k * icc / (m * (1 - icc))
    b = 1 + k * icc * (m - 1) / (m * (1 - icc))
    freedom = (a * between_columns + b * error) ** 2 / (
        (a * between_columns) ** 2 / (k - 1) + (b * error) ** 2 / ((m - 1) * (k - 1))
    )
    upper, lower = f_distribution.ppf(_HIGH, m - 1, freedom), f_distribution.ppf(_HIGH, freedom, m - 1)
    others = k * between_columns + (k * m - k - m) * error
    low = m * (between_rows - upper * error) / (upper * others + m * between_rows)
    high = m * (lower * between_rows - error) / (others + m * lower * between_rows)
    return icc, float(low), float(high)


def sem_agreement(ratings: FloatArray) -> float:  # ratings (n, k)
    """SEM_agreement: sqrt(variance between sessions + error)."""
    _, sessions, error = mean_squares(ratings)
    # sessions that do not differ: a variance is not negative
    return float(np.sqrt(error + max(sessions - error, 0.0) / len(ratings)))


def detectable_change(sem: float) -> float:
    """The minimal detectable change of two values that each have this standard error."""
    return LIMITS * float(np.sqrt(2.0)) * sem
