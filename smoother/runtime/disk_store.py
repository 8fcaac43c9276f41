"""Arrays that grow with a recording, in files instead of memory."""

from __future__ import annotations

import errno
import mmap
import os
import pickle
import tempfile
from types import TracebackType
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import UnoccludeError
from .store import Store

#: Arrays smaller than this stay in memory.
_SMALL_BYTES = 1 << 20
#: Files are filled in batches of this size.
_BATCH_BYTES = 1 << 20


class StoredItem(NamedTuple):
    """Where a value is stored that was put aside."""

    offset: int
    length: int


class DiskStore(Store):
    """Space for what grows with a recording's length, in nameless temporary files.

    Arrays are plain numpy arrays on shared maps of files: forked processes see what is written. A file goes
    when its last array does, whatever happens to the program. Arrays outlive the store; values put aside
    do not.

    Parameters
    ----------
    folder : str or path, optional
        Where the files are stored; None = where the system has its temporary files (`TMPDIR`).

    Raises
    ------
    UnoccludeError
        On whatever needs space: the folder cannot be written to, or its disk is full.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None):
        self._folder = os.fspath(folder) if folder is not None else tempfile.gettempdir()
        self._aside: IO[bytes] | None = None
        self._kept: set[StoredItem] = set()

    def __enter__(self) -> DiskStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._aside is not None:
            self._aside.close()
        self._aside = None
        self._kept.clear()

    def array(self, shape: tuple[int, ...], fill: float = np.nan, dtype: DTypeLike = np.float64) -> NDArray:
        """A new array, every value `fill`; its pages are not touched."""
        kind = np.dtype(dtype)
        size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
        if size < _SMALL_BYTES or kind.hasobject:
            return np.full(shape, fill, kind)
        try:
            with tempfile.TemporaryFile(dir=self._folder, buffering=0) as file:
                _allocate(file, size, np.full(1, fill, kind))
                mapped = mmap.mmap(file.fileno(), size)
        except OSError as failure:
            raise self._no_space(failure) from failure
        return np.ndarray(shape, kind, mapped)

    def put(self, value: object) -> object:
        """Put a value aside, in a file; `pop` gives it back for what this returns."""
        try:
            if self._aside is None:
                self._aside = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 (closed on exit)
            if not self._kept:
                self._aside.truncate(0)
            offset = self._aside.seek(0, os.SEEK_END)
            pickle.dump(value, self._aside, protocol=5)
            self._aside.flush()
        except OSError as failure:
            raise self._no_space(failure) from failure
        kept = StoredItem(offset, self._aside.tell() - offset)
        self._kept.add(kept)
        return kept

    def pop(self, kept: Any) -> Any:
        """The value that was put aside; it can be taken once."""
        self._kept.remove(kept)
        assert self._aside is not None
        self._aside.seek(kept.offset)
        return pickle.load(self._aside)

    def _no_space(self, failure: OSError) -> UnoccludeError:
        if failure.errno in (errno.ENOSPC, errno.EDQUOT):
            return UnoccludeError(
                f"There is no space left for temporary files in {self._folder}; make room there, or name a "
                "folder on a larger disk in the environment variable TMPDIR."
            )
        return UnoccludeError(
            f"No temporary files can be made in {self._folder} ({failure.strerror or failure}); name a "
            "folder of your own in the environment variable TMPDIR."
        )


def _allocate(file: IO[bytes], size: int, fill: NDArray) -> None:
    """Give a file its size and content; a map of space that is not reserved could kill the program."""
    if not any(fill.tobytes()) and hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file.fileno(), 0, size)
            return
        except OSError as failure:
            if failure.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENODEV):
                raise
    piece = memoryview(np.repeat(fill, max(_BATCH_BYTES // fill.itemsize, 1)).tobytes())
    left = size
    while left:
        left -= file.write(piece[: min(left, len(piece))])
