"""Sections blended over their border, column by column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..rotation import Rotation
from ..window.trajectory import mix, turn_to


def blend(column: NDArray, rows: slice, value: FloatArray, share: FloatArray) -> None:
    """Write the values to rows, over what stands there by the share (k,) of the way."""
    mixed = np.flatnonzero(share < 1.0)
    old = column[rows.start + mixed]
    column[rows] = value
    if len(mixed):
        mix(old, np.arange(len(mixed)), value[mixed], share[mixed])
        column[rows.start + mixed] = np.where(np.isfinite(old), old, value[mixed])


def between_quaternions(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Quaternions on the way from one to the other by the share; `after` where there is nothing before."""
    out = after.copy()
    both = np.flatnonzero(np.isfinite(before).all(axis=1))
    if len(both):
        R = Rotation.from_quat(before[both], scalar_first=True).as_matrix()
        target = Rotation.from_quat(after[both], scalar_first=True).as_matrix()
        step = Rotation.from_rotvec(share[both, None] * turn_to(R, target, np.ones(len(both), bool)))
        out[both] = (Rotation.from_matrix(R) * step).as_quat(scalar_first=True)
    return out
