"""Sections blended over their border, column by column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..rotation import Rotation
from ..window.trajectory import mix, turn_to


def blend(column: NDArray, rows: slice, value: FloatArray, share: FloatArray) -> None:
    """Write the values to rows, over what stands there by the share (k,) of the way.

    Where only one of the two is known, it counts; values of the share 1 stand as they are.
    """
    mixed = np.flatnonzero(share < 1.0)
    old = column[rows.start + mixed]
    column[rows] = value
    if len(mixed):
        either = np.where(np.isfinite(value[mixed]), value[mixed], old)
        mixture = old.copy()
        mix(mixture, np.arange(len(mixed)), value[mixed], share[mixed])
        column[rows.start + mixed] = np.where(np.isfinite(mixture), mixture, either)


def between_quaternions(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Quaternions on the way from one to the other by the share; where one is not known, the other."""
    known = np.asarray(np.isfinite(after).all(axis=1))
    out = np.where(known[:, None], after, before)
    both = np.flatnonzero(known & np.isfinite(before).all(axis=1))
    if len(both):
        R = Rotation.from_quat(before[both], scalar_first=True).as_matrix()
        target = Rotation.from_quat(after[both], scalar_first=True).as_matrix()
        step = Rotation.from_rotvec(share[both, None] * turn_to(R, target, np.ones(len(both), bool)))
        out[both] = (Rotation.from_matrix(R) * step).as_quat(scalar_first=True)
    return out
