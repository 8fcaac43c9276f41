"""The interval that holds a measure's true value, by the measure of drawn motions.

Drawn motions say how far a measure may be off, not on which side. Noise makes a path longer and an extreme
more extreme; a drawn motion is the answer and an error on top, rougher than the error in the answer, which is
the smoothest motion that fits. So draws lie to one side of the answer, and by more than the answer lies off
the truth (on simulated arms, docs/measures.md). Quantiles of the draws as they are then miss the truth, and
the basic bootstrap's, mirrored about the answer (Davison, Hinkley, Bootstrap Methods and their Application,
1997, section 5.2), overshoot to the other side. The spread of the draws about their own median is therefore
laid about the answer's value; where draws are at the end of the values that exist, so is the interval. Whole
numbers (counts, reached or not) do not shift: their quantiles count.
"""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from .definitions import MeasureDefinition

#: Fewer draws than this do not show the ends of a 95 % interval.
FEWEST_DRAWS = 20
LEVEL = 0.95


def interval(value: float, drawn: FloatArray, definition: MeasureDefinition) -> tuple[float, float, float]:
    """Ends of the 95 % interval about a value, and its standard deviation.

    Parameters
    ----------
    value : float
        Of the answer.
    drawn : ndarray, shape (n,)
        Of drawn motions; those without a value do not count.
    definition : MeasureDefinition
        Which values exist, and whether they are counts.

    Returns
    -------
    low, high, sigma : float
        nan without a value, or with fewer than 20 draws.
    """
    drawn = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or len(drawn) < FEWEST_DRAWS:
        return float("nan"), float("nan"), float("nan")
    levels = [0.5 - 0.5 * LEVEL, 0.5, 0.5 + 0.5 * LEVEL]
    if definition.is_count:
        low, _, high = np.quantile(drawn, levels, method="inverted_cdf")
        low, high = min(low, value), max(high, value)
    else:
        least, middle, most = np.quantile(drawn, levels)
        low = definition.low if least <= definition.low else least + value - middle
        high = definition.high if most >= definition.high else most + value - middle
    low, high = np.clip([low, high], definition.low, definition.high)
    return float(low), float(high), float(drawn.std(ddof=1))
