"""Which samples of a recovery should be used: those to be trusted, within the limit on sigma if any."""

from __future__ import annotations

import numpy as np

from ...array_types import BoolArray
from ...result import Recovery


def usable(recovery: Recovery) -> BoolArray:
    """(N,) samples with an answer that is to be trusted and is certain enough.

    Of a result that nobody judged every sample counts as trusted.
    """
    return certain(recovery) & recovery.trusted


def certain(recovery: Recovery) -> BoolArray:
    """(N,) samples with an answer that is certain enough by what it states of itself.

    Without a limit every answer counts. With one, the standard deviation of the position has to be below
    it on every axis; an answer that states none is not known to be.
    """
    limit = recovery.estimates.max_sigma_m
    if limit is None:
        return recovery.answered
    with np.errstate(invalid="ignore"):
        below: BoolArray = recovery.worst_sigma_m <= limit  # nan where one axis is
    return recovery.answered & below
