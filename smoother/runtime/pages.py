"""Memory of arrays that are kept in files."""

from __future__ import annotations

import mmap

import numpy as np
from numpy.typing import NDArray

#: Rows that are gathered together: each may bring pages beside its own.
_TOGETHER = 256


def let_go(*arrays: NDArray) -> None:
    """Let the pages of arrays that lie on shared maps of files leave the memory; all others stay.

    The whole map goes, also where an array is a part of it. What the arrays hold is in the files.
    """
    if not hasattr(mmap, "MADV_DONTNEED"):
        return
    maps = {id(found): found for found in map(_map_of, arrays) if found is not None}
    for each in maps.values():
        each.madvise(mmap.MADV_DONTNEED)


def gathered(array: NDArray, index: NDArray[np.int64]) -> NDArray:
    """Some rows of an array; where they are spread over a whole file, it leaves the memory again."""
    if _map_of(array) is None:
        return array[index]
    found = np.empty((len(index), *array.shape[1:]), array.dtype)
    for start in range(0, len(index), _TOGETHER):
        part = slice(start, start + _TOGETHER)
        found[part] = array[index[part]]
        let_go(array)
    return found


def _map_of(array: NDArray) -> mmap.mmap | None:
    """The map that an array lies on; None where it lies in memory."""
    base: object = array
    while isinstance(base, np.ndarray):
        if isinstance(base, np.memmap) and base.mode == "c":
            return None  # a private map: what was written to it lies in memory alone
        base = base.base
    return base if isinstance(base, mmap.mmap) else None
