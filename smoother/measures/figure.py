"""A number and how much of it rests on what the camera did not see."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..array_types import BoolArray, FloatArray


class Figure(NamedTuple):
    """A number, before it has an interval.

    Attributes
    ----------
    value : float
        nan where it cannot be measured.
    share : float, 0 to 1
        Of it that rests on recovered samples.
    """

    value: float
    share: float


UNKNOWN = Figure(float("nan"), float("nan"))


def share_of(occluded: BoolArray, weight: FloatArray | BoolArray | None = None) -> float:
    """How much of some samples (n,) the camera did not see, each with a weight; nan without any."""
    weights = np.ones(len(occluded)) if weight is None else np.asarray(weight, dtype=float)
    total = float(weights.sum())
    return float((weights * occluded).sum()) / total if total > 0.0 else float("nan")
