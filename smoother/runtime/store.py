"""Where arrays that grow with the recording live: here in memory; columns that grow, and passes over them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Store:
    """Space for what grows with a recording's length, in memory."""

    def array(self, shape: tuple[int, ...], fill: float = np.nan, dtype: DTypeLike = np.float64) -> NDArray:
        """A new array, every value `fill`."""
        return np.full(shape, fill, dtype)

    def put(self, value: object) -> object:
        """Put a value aside; `pop` gives it back for what this returns."""
        return value

    def pop(self, kept: Any) -> Any:
        """The value that was put aside; it can be taken once."""
        return kept


#: Rows that are looked at together; keeps memory flat however long the column is.
BATCH_ROWS = 1 << 15
#: Statistics of longer columns are taken of an even sub-sample of at least this many rows.
_ENOUGH = 50_000


class Column:
    """Rows of one shape, gathered batch after batch in a store."""

    def __init__(
        self,
        store: Store,
        tail: tuple[int, ...] = (),
        dtype: DTypeLike = np.float64,
        optional: bool = False,
    ):
        self._store = store
        self._array: NDArray = np.empty((0, *tail), dtype)
        self._count = 0
        self._blank = optional

    def __len__(self) -> int:
        return self._count

    def append(self, values: NDArray) -> None:
        """Take rows (n, ...)."""
        end = self._count + len(values)
        if self._blank and np.isnan(values).all():
            self._count = end
            return
        if self._blank:
            before, self._count, self._blank = self._count, 0, False
            for part in batches(before):
                self.append(np.full((part.stop - part.start, *self._array.shape[1:]), np.nan))
        if end > len(self._array):
            self._array = self._moved(max(end, 2 * len(self._array)))
        self._array[self._count : end] = values
        self._count = end

    @property
    def is_blank(self) -> bool:
        """Optional, and nothing but nan so far."""
        return self._blank

    def done(self) -> NDArray:
        """All rows (none of a blank column); nothing can be taken after this."""
        if self._blank:
            return self._array
        array = self._array if len(self._array) == self._count else self._moved(self._count)
        self._array = array[:0]
        return array

    def _moved(self, length: int) -> NDArray:
        array = self._store.array((length, *self._array.shape[1:]), 0, self._array.dtype)
        for part in batches(self._count):
            array[part] = self._array[part]
        return array


def batches(count: int) -> Iterator[slice]:
    """Rows of a column some thousand at a time, so that what is computed of them stays small."""
    for start in range(0, count, BATCH_ROWS):
        yield slice(start, min(start + BATCH_ROWS, count))


def sampled(values: NDArray) -> NDArray:
    """Rows for a statistic: all of up to 100,000, else a copy of every second, third, .. one."""
    step = max(len(values) // _ENOUGH, 1)
    return values if step == 1 else values[::step].copy()
