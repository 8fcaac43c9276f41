"""How far off a position may be, as one number: within this distance in 95 of 100 cases.

A covariance (3, 3) has a standard deviation on each axis, and none of them is the 3D error that a reader has
in mind. The distance of a normal error from zero is the root of a weighted sum of three squared normal ones;
its quantiles are those of Pearson's three-moment approximation by a chi-square distribution (Imhof,
Biometrika 48:419-426, 1961, section 4), which is exact where one, two or three axes are equal and the others
zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from statistics import NormalDist

import numpy as np

from .array_types import FloatArray

#: The probability of which pages and sentences speak.
SHARE = 0.95
#: A pooled distance is that of this many equally likely errors of each sample, of this many samples at most.
_LEVELS, _MOST_SAMPLES = 64, 4000


def error_radius(covariance: FloatArray, probability: float = SHARE) -> FloatArray:
    """Distance (...) m within which a 3D error with a covariance (..., 3, 3) lies with a probability."""
    return _radii(covariance, [probability])[0]


def pooled_radius(covariance: FloatArray, probability: float = SHARE) -> float | None:
    """Distance, m, within which this many of the errors of n samples lie; None where none is known."""
    known = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    if not len(known):
        return None
    some = covariance[known[:: math.ceil(len(known) / _MOST_SAMPLES)]]
    radii = _radii(some, [(level + 0.5) / _LEVELS for level in range(_LEVELS)])
    return float(np.quantile(radii, probability, overwrite_input=True))


def _radii(covariance: FloatArray, probabilities: Sequence[float]) -> FloatArray:
    """The distance for each of k probabilities, (k, ...)."""
    covariance = np.asarray(covariance, float)
    square = covariance @ covariance
    first, second = (np.trace(each, axis1=-2, axis2=-1) for each in (covariance, square))
    third = np.einsum("...ij,...ij->...", square, covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        freedom = np.clip(np.where(third > 0, second**3 / third**2, 3.0), 1.0, 3.0)
        # a parabola through the quantiles of one, two and three degrees of freedom
        weights = (
            (freedom - 2) * (freedom - 3) / 2,
            (freedom - 1) * (3 - freedom),
            (freedom - 1) * (freedom - 2) / 2,
        )
        quantiles = np.array([_quantiles(each) for each in probabilities])
        quantile = np.tensordot(quantiles, np.stack(weights), axes=1)
        return np.asarray(np.sqrt(np.maximum(first + (quantile - freedom) * np.sqrt(second / freedom), 0.0)))


@cache
def _quantiles(probability: float) -> tuple[float, float, float]:
    """Of chi-square with one, two and three degrees of freedom (SciPy's take a third of a second to load)."""
    low, high = 0.0, 9.0  # the third one's root, between 0 and 1 - 1e-16 of the cases
    for _ in range(60):
        r = 0.5 * (low + high)
        below = math.erf(r / math.sqrt(2.0)) - math.sqrt(2.0 / math.pi) * r * math.exp(-0.5 * r * r)
        low, high = (r, high) if below < probability else (low, r)
    return NormalDist().inv_cdf(0.5 + 0.5 * probability) ** 2, -2.0 * math.log1p(-probability), low * low


def in_cm(metres: float) -> str:
    """A length in words: "2.1 cm", "115 cm"."""
    return f"{100.0 * metres:.1f} cm" if abs(metres) < 1.0 else f"{100.0 * metres:.0f} cm"


def within_words(radius_m: float) -> str:
    """The distance of 95 of 100 errors as written in sentences: "within 2.1 cm in 95 of 100 cases"."""
    return f"within {in_cm(radius_m)} in 95 of 100 cases"
