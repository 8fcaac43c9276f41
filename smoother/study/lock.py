"""One command at a time works on a study."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO

from ..errors import UnoccludeError
from .folder import StudyFolder

#: What the systems say where another process holds the lock.
_TAKEN = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}


@contextmanager
def alone(folder: StudyFolder) -> Iterator[None]:
    """Keep a second command from doing the same work; the system lets go when this process ends, however.

    Raises
    ------
    UnoccludeError
        Another process works on this study.
    """
    with open(folder.path / ".unocclude" / "lock", "a+b") as file:
        try:
            _lock(file)
        except OSError as error:
            if error.errno in _TAKEN:
                raise UnoccludeError(
                    f"another command works on {folder.path}; wait for it, or give another folder"
                ) from error
            # a file system without locks: two commands would do work twice, but spoil nothing
        yield


def _lock(file: IO[bytes]) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
