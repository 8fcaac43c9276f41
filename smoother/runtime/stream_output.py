"""Outputs that are no files (a pipe, standard output, the null device): written to, never replaced."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ..errors import UnoccludeError

#: How long a pipe's reader may take to come, s.
READER_S = 3.0


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Whether a name stands for a pipe, for this program's own standard output, or for the null device."""
    try:
        about = os.stat(path)
    except (OSError, ValueError):
        return False
    if stat.S_ISFIFO(about.st_mode) or _is_standard_output(path, about):
        return True
    return stat.S_ISCHR(about.st_mode) and os.path.samestat(about, os.stat(os.devnull))


@contextmanager
def sending(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary file to write to; its content goes to the stream `path` when all went well.

    Raises
    ------
    UnoccludeError
        Nobody reads the pipe, its reader went away, or there is no space for the temporary file.
    """
    try:
        with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:  # for its owner alone
            temporary = Path(folder) / "output"
            temporary.touch(mode=0o600)
            yield temporary
            with open(temporary, "rb") as content, _opened(path) as stream:
                shutil.copyfileobj(content, stream)
    except BrokenPipeError as error:
        raise UnoccludeError(f"{path} could not be written: its reader went away.") from error
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise UnoccludeError(
                f"{path} is a pipe that nobody reads; start its reader first, or name a file."
            ) from error
        raise UnoccludeError(f"{path} could not be written: {error.strerror or error}.") from error


def _is_standard_output(path: str | os.PathLike[str], about: os.stat_result) -> bool:
    """Such as /dev/stdout, also where it leads to a file."""
    named = os.fspath(path).startswith(("/dev/", "/proc/"))
    with suppress(OSError):
        return named and os.path.samestat(about, os.fstat(1))
    return False


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    about = os.stat(path)
    if _is_standard_output(path, about):
        with suppress(OSError, ValueError):
            sys.stdout.flush()  # what was printed comes first
        handle = os.dup(1)  # opened anew, a file would be written from its beginning
    else:
        handle = _handle(path)
        if hasattr(os, "set_blocking"):
            os.set_blocking(handle, True)
    with os.fdopen(handle, "wb") as stream:
        yield stream


def _handle(path: str | os.PathLike[str]) -> int:
    """Open a pipe or device; without O_NONBLOCK a pipe that nobody reads would hold this program for ever."""
    deadline = time.monotonic() + READER_S
    while True:
        try:
            return os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0))
        except OSError as error:
            if error.errno != errno.ENXIO or time.monotonic() > deadline:
                raise
        time.sleep(0.05)
