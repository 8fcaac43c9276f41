"""Answers that are too uncertain to keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..recording import BoolArray, FloatArray
from ..result import Recovery


def limit_sigma(recovery: Recovery, max_sigma_m: float | None) -> Recovery:
    """Blank the samples whose position is less certain than asked for.

    Parameters
    ----------
    max_sigma_m : largest standard deviation on the worst axis that is kept, m; None keeps all.

    Returns
    -------
    The recovery with nan in those samples, covariances kept, and a note that says how many.
    """
    if max_sigma_m is None:
        return recovery
    unsure: BoolArray = np.any(recovery.sigma_m > max_sigma_m, axis=1)
    if not unsure.any():
        return recovery

    def blank(values: FloatArray) -> FloatArray:
        return np.where(unsure[:, None], np.nan, values)

    note = (
        f"{int(unsure.sum())} of {len(unsure)} samples are less certain than {max_sigma_m:g} m"
        " (one standard deviation) and were left without an answer."
    )
    return replace(
        recovery,
        position=blank(recovery.position),
        quaternion=blank(recovery.quaternion),
        velocity=blank(recovery.velocity),
        joints={name: blank(value) for name, value in recovery.joints.items()},
        notes=(*recovery.notes, note),
    )
