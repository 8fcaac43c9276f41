"""Temporary files beside outputs: for their owner alone, and none left by a program that was killed.

A file is locked while its program works on it; the system lets go of the lock however that ends. What nobody
has locked was left behind.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_ENDING = ".unocclude.tmp"
_NAME = re.compile(r"\..*\.[0-9a-f]{24}" + re.escape(_ENDING) + r"(\.\w+)?")
#: Characters of the output's name in that of its temporary file: four bytes each at most, of 255.
_NAME_CHARACTERS = 40
#: Folders are looked through once a process: one may hold a million results.
_swept: set[Path] = set()


def temporary_name(target: Path) -> Path:
    """A hidden name beside `target` that cannot be foreseen."""
    return target.with_name(f".{target.name[:_NAME_CHARACTERS]}.{secrets.token_hex(12)}{_ENDING}")


def is_temporary(name: str) -> bool:
    """Whether a file's name is one that `temporary_name` gives."""
    return _NAME.fullmatch(name) is not None


@contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Make a folder that only its owner can enter, and keep it from being swept.

    Raises
    ------
    OSError
        It cannot be made.
    """
    path.mkdir(mode=0o700)
    if os.name != "posix":
        yield
        return
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        _lock(handle)
        yield
    finally:
        os.close(handle)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Make an empty file that only its owner can read, and keep it from being swept.

    Raises
    ------
    OSError
        It cannot be made. A link or a file of that name is never followed or taken.
    """
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    handle = os.open(path, flags, 0o600)
    try:
        _lock(handle)
        if not path.exists():  # swept between its making and its lock
            os.close(handle)
            handle = os.open(path, flags, 0o600)
            _lock(handle)
        yield
    finally:
        os.close(handle)


def remove_stale_tempfiles(folder: Path, again: bool = False) -> None:
    """Remove temporary files, and folders, that programs of ours left in a folder when they were killed.

    Parameters
    ----------
    folder : Path
        Where outputs are to lie.
    again : bool
        Also where this process has swept before.
    """
    if folder in _swept and not again:
        return
    _swept.add(folder)
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in [entry for entry in entries if is_temporary(entry.name)]:
            with suppress(OSError):
                _remove(Path(entry.path))


def _remove(path: Path) -> None:
    """Remove what nobody has locked; never what belongs to someone else."""
    about = os.lstat(path)
    is_folder = stat.S_ISDIR(about.st_mode)
    if not (is_folder or stat.S_ISREG(about.st_mode)):
        return
    if os.name != "posix":
        if not is_folder:
            path.unlink()  # Windows refuses while its program has it open
        return
    if about.st_uid != os.getuid():
        return
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK)
    try:
        if not _lock(handle):
            return
        if is_folder:
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()
    finally:
        os.close(handle)


def _lock(handle: int) -> bool:
    """Lock an open file for as long as it stays open; False where another program has it locked."""
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks: nothing is swept there
        return False
    return True
