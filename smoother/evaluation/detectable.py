"""How well pairs of values agree, one pair a recording or movement, and what change can be told from noise.

Sources: Bland and Altman, Lancet 327:307-310 (1986), limits of agreement; Shrout and Fleiss, Psychological
Bulletin 86:420-428 (1979), ICC(2,1), which McGraw and Wong call ICC(A,1); Weir, Journal of Strength and
Conditioning Research 19:231-240 (2005), SEM and minimal difference.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..array_types import FloatArray
from .agreement import CONFIDENCE, LIMITS, icc_a1

#: Fewer pairs have a mean difference and nothing else.
FEWEST_PAIRS = 3


@dataclass(frozen=True)
class PairAgreement:
    """Agreement of pairs of values, in their unit; None where there are too few pairs.

    Attributes
    ----------
    pairs : int
        How many were compared.
    bias : float or None
        Mean of answer minus reference.
    limits_low, limits_high : float or None
        Limits of agreement, bias -+ 1.96 standard deviations.
    icc, icc_low, icc_high : float or None
        ICC(2,1) with its 95 % interval.
    sem : float or None
        Standard error of measurement of the answer: the standard deviation of the differences, since the
        reference counts as free of error.
    mdc95 : float or None
        Minimal detectable change, 1.96 sqrt(2) SEM: of two sessions without any change 95 % differ by less.
    mdc95_low, mdc95_high : float or None
        The 95 % interval of it: few pairs say little about a standard deviation.
    """

    pairs: int
    bias: float | None = None
    limits_low: float | None = None
    limits_high: float | None = None
    icc: float | None = None
    icc_low: float | None = None
    icc_high: float | None = None
    sem: float | None = None
    mdc95: float | None = None
    mdc95_low: float | None = None
    mdc95_high: float | None = None

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self)


def pair_agreement(answer: FloatArray, reference: FloatArray) -> PairAgreement:
    """Agreement of pairs; one with nan is left out.

    Parameters
    ----------
    answer, reference : ndarray, shape (n,)
        A pair a recording or movement.

    Returns
    -------
    PairAgreement
    """
    good = np.isfinite(answer) & np.isfinite(reference)
    answer, reference = answer[good], reference[good]
    count, difference = len(answer), answer - reference
    if count < FEWEST_PAIRS:
        return PairAgreement(count, float(difference.mean()) if count else None)
    bias, spread = float(difference.mean()), float(difference.std(ddof=1))
    icc, icc_low, icc_high = icc_a1(np.column_stack([answer, reference]))
    low, high = _sigma_interval(spread, count)
    return PairAgreement(
        pairs=count,
        bias=bias,
        limits_low=bias - LIMITS * spread,
        limits_high=bias + LIMITS * spread,
        icc=icc,
        icc_low=icc_low,
        icc_high=icc_high,
        sem=spread,
        mdc95=detectable_change(spread),
        mdc95_low=detectable_change(low),
        mdc95_high=detectable_change(high),
    )


def measurement_error(ratings: FloatArray) -> float:
    """Standard error of measurement of alike trials or raters: sqrt of the error's mean square (Weir 2005).

    Parameters
    ----------
    ratings : ndarray, shape (n, k)
        n subjects by k trials.

    Returns
    -------
    sem : float
        In the unit of the ratings; systematic differences between trials are not in it.
    """
    n, k = ratings.shape
    rows, columns = ratings.mean(axis=1), ratings.mean(axis=0)
    residual = ratings - rows[:, None] - columns + ratings.mean()
    return float(np.sqrt((residual**2).sum() / ((n - 1) * (k - 1))))


def detectable_change(sem: float) -> float:
    """The minimal detectable change of two values that each have this standard error, 95 % (Weir 2005)."""
    return LIMITS * float(np.sqrt(2.0)) * sem


def _sigma_interval(sigma: float, count: int) -> tuple[float, float]:
    """95 % interval of a standard deviation of normal values (chi-square)."""
    from scipy.stats import chi2

    tail, freedom = 0.5 * (1 - CONFIDENCE), count - 1
    low, high = (sigma * np.sqrt(freedom / chi2.ppf(p, freedom)) for p in (1 - tail, tail))
    return float(low), float(high)
