"""What grows with a recording, filled section by section: neighbours are blended over their border."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..array_types import FloatArray
from ..rotation import Rotation
from ..runtime.store import large_array


class BlendedColumns:
    """Columns of some rows by name; what no section has is nan."""

    def __init__(self, count: int, dtype: DTypeLike = np.float64) -> None:
        self._count, self._dtype = count, dtype
        self._values: dict[str, NDArray] = {}
        self._end = 0  # first row that is not filled yet; on disk, filling all at once takes seconds

    def add(self, rows: slice, columns: Mapping[str, NDArray], share: FloatArray) -> None:
        """The next section's columns at its rows; its share (k,) against the one before at each of them."""
        share = np.where(np.arange(rows.start, rows.stop) < self._end, share, 1.0)
        mixed = np.flatnonzero(share < 1.0)
        for name, values in columns.items():
            if name not in self._values:
                self._values[name] = large_array((self._count, *values.shape[1:]), 0.0, self._dtype)
                self._values[name][: self._end] = np.nan
        for name, column in self._values.items():
            column[self._end : rows.stop] = np.nan
            if name in columns:
                way = between_quaternions if name == "quaternion" else between
                before = column[rows][mixed]
                column[rows] = columns[name]
                column[rows.start + mixed] = way(before, columns[name][mixed], share[mixed])
        self._end = max(self._end, rows.stop)

    def done(self) -> dict[str, NDArray]:
        """The columns by name."""
        for column in self._values.values():
            column[self._end :] = np.nan
        self._end = self._count
        return self._values


def between(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Values (k, ...) from one to the other by the share (k,); where one is not known, the other."""
    weight = share.reshape(-1, *([1] * (after.ndim - 1)))
    mixture = (1.0 - weight) * before + weight * after
    return np.where(np.isfinite(mixture), mixture, np.where(np.isfinite(after), after, before))


def between_quaternions(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """As `between`, of quaternions (k, 4): turned from one to the other."""
    known = np.asarray(np.isfinite(after).all(axis=1))
    out = np.where(known[:, None], after, before)
    both = np.flatnonzero(known & np.isfinite(before).all(axis=1))
    if len(both):
        R, target = (Rotation.from_quat(each[both], scalar_first=True) for each in (before, after))
        step = share[both, None] * (R.inv() * target).as_rotvec()
        out[both] = (R * Rotation.from_rotvec(step)).as_quat(scalar_first=True)
    return out
