"""The interval that holds a measure's true value, by the measure of drawn motions."""

from __future__ import annotations

import numpy as np

from ..recording import FloatArray
from .definitions import MeasureDefinition

#: Fewer draws than this do not show the ends of a 95 % interval.
FEWEST_DRAWS = 20
LEVEL = 0.95


def interval(value: float, drawn: FloatArray, definition: MeasureDefinition) -> tuple[float, float, float]:
    """Ends of the interval, and the standard deviation.

    Parameters
    ----------
    value : float
        Of the answer.
    drawn : ndarray, shape (n,)
        Of drawn motions; those without a value do not count.
    definition : MeasureDefinition
        Which values exist.

    Returns
    -------
    low, high, sigma : float
        nan without a value, or with fewer than 20 draws.
    """
    drawn = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or len(drawn) < FEWEST_DRAWS:
        return float("nan"), float("nan"), float("nan")
    low, high = np.quantile(drawn, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    return float(low), float(high), float(drawn.std(ddof=1))
