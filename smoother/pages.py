"""Memory of arrays that are kept in files."""

from __future__ import annotations

import mmap

import numpy as np
from numpy.typing import NDArray


def let_go(*arrays: NDArray) -> None:
    """Let the pages of arrays that lie on shared maps of files leave the memory; all others stay.

    The whole map goes, also where an array is a part of it. What the arrays hold is in the files.
    """
    if not hasattr(mmap, "MADV_DONTNEED"):
        return
    maps = {id(found): found for found in map(_map_of, arrays) if found is not None}
    for each in maps.values():
        each.madvise(mmap.MADV_DONTNEED)


def _map_of(array: NDArray) -> mmap.mmap | None:
    """The map that an array lies on; None where it lies in memory."""
    base: object = array
    while isinstance(base, np.ndarray):
        if isinstance(base, np.memmap) and base.mode == "c":
            return None  # a private map: what was written to it lies in memory alone
        base = base.base
    return base if isinstance(base, mmap.mmap) else None
