"""Arrays that grow with a recording, in nameless files instead of memory; passes over them.

A file goes when its last array does, whatever happens to the program; forked processes see what is written.
"""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import UnoccludeError

#: Arrays smaller than this stay in memory.
_SMALL_BYTES = 1 << 20
#: Rows that are looked at together; keeps memory flat however long the column is.
BATCH_ROWS = 1 << 15
#: Statistics of longer columns are taken of an even sub-sample of at least this many rows.
_ENOUGH = 50_000


def large_array(shape: tuple[int, ...], fill: float = np.nan, dtype: DTypeLike = np.float64) -> NDArray:
    """A new array, every value `fill`; a large one lies in a file where the system has its temporary ones."""
    kind = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
    if size < _SMALL_BYTES:
        return np.full(shape, fill, kind)
    with _named_failures(), tempfile.TemporaryFile(buffering=0) as file:
        _allocate(file, size, np.full(1, fill, kind))
        return np.asarray(np.memmap(file, kind, "r+", shape=shape))


class GatheredRows:
    """Rows of one shape, gathered batch after batch."""

    def __init__(self, tail: tuple[int, ...] = (), dtype: DTypeLike = np.float64):
        self._tail, self._kind, self._count = tail, np.dtype(dtype), 0
        self._file = tempfile.SpooledTemporaryFile(_SMALL_BYTES)  # noqa: SIM115 (goes with the column)

    def __len__(self) -> int:
        return self._count

    def append(self, values: NDArray) -> None:
        """Take rows (n, ...)."""
        with _named_failures():
            self._file.write(np.ascontiguousarray(values, self._kind).data)
        self._count += len(values)

    def done(self) -> NDArray:
        """All rows; nothing can be taken after this."""
        shape = (self._count, *self._tail)
        if self._file.tell() < _SMALL_BYTES:
            self._file.seek(0)
            return np.frombuffer(bytearray(self._file.read()), self._kind).reshape(shape)
        with _named_failures():
            self._file.flush()
            return np.asarray(np.memmap(self._file, self._kind, "r+", shape=shape))


def batches(count: int) -> Iterator[slice]:
    """Rows of a column some thousand at a time, so that what is computed of them stays small."""
    for start in range(0, count, BATCH_ROWS):
        yield slice(start, min(start + BATCH_ROWS, count))


def by_rows(function: Callable[..., NDArray], *columns: NDArray) -> NDArray:
    """What a function gives of the rows of some columns, some thousand at a time, as a column."""
    count, first = len(columns[0]), function(*(values[:BATCH_ROWS] for values in columns))
    if count <= BATCH_ROWS:
        return first
    out = large_array((count, *first.shape[1:]), 0, first.dtype)
    for part in batches(count):
        out[part] = function(*(values[part] for values in columns))
    return out


def sampled(values: NDArray) -> NDArray:
    """Rows for a statistic: all of up to 100,000, else a copy of every second, third, .. one."""
    step = max(len(values) // _ENOUGH, 1)
    return values if step == 1 else values[::step].copy()


@contextmanager
def _named_failures() -> Iterator[None]:
    """Say what to do where the system's temporary folder cannot be written to, or its disk is full."""
    try:
        yield
    except OSError as failure:
        folder = tempfile.tempdir or "the system's temporary folder"
        if failure.errno in (errno.ENOSPC, errno.EDQUOT):
            raise UnoccludeError(
                f"There is no space left for temporary files in {folder}; make room there, or name a "
                "folder on a larger disk in the environment variable TMPDIR."
            ) from failure
        raise UnoccludeError(
            f"No temporary files can be made in {folder} ({failure.strerror or failure}); name a "
            "folder of your own in the environment variable TMPDIR."
        ) from failure


def _allocate(file: IO[bytes], size: int, fill: NDArray) -> None:
    """Give a file its size and content; a map of space that is not reserved could kill the program."""
    if not any(fill.tobytes()) and hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file.fileno(), 0, size)
            return
        except OSError as failure:
            if failure.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENODEV):
                raise
    piece = memoryview(np.repeat(fill, max(_SMALL_BYTES // fill.itemsize, 1)).tobytes())
    left = size
    while left:
        left -= file.write(piece[: min(left, len(piece))])
