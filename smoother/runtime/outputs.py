"""Outputs that are either whole or not there, and none left half by a program that was killed.

A file is locked while its program uses it; the system lets go of the lock however that ends. A file that
is not locked was left behind.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import UnoccludeError

#: How long a pipe's reader may take to come, s.
READER_S = 3.0
_ENDING = ".unocclude.tmp"
_NAME = re.compile(r"\..*\.[0-9a-f]{24}" + re.escape(_ENDING) + r"(\.\w+)?")
#: Characters of the output's name in that of its temporary file: four bytes each at most, of 255.
_NAME_CHARACTERS = 40
#: Folders are looked through once per process: one may contain a million results.
_swept: set[Path] = set()


@contextmanager
def writing(path: str | os.PathLike[str], force: bool = False) -> Iterator[Path]:
    """Yield a hidden name beside `path` to write to; it becomes `path` when all went well."""
    check_output(path, force)
    if is_stream(path):
        with _sending(path) as temporary:
            yield temporary
        return
    # A link keeps pointing at the file it named, which is the one replaced.
    target = Path(path).resolve()
    temporary = temporary_name(target)
    try:
        remove_stale_tempfiles(target.parent)
        with locked(temporary):
            yield temporary
            _give_mode(temporary, target)
            _sync(temporary, os.O_RDWR)
            if os.name == "posix":  # elsewhere an open file cannot be moved
                _give_name(temporary, target, force)
        if os.name != "posix":
            _give_name(temporary, target, force)
        with suppress(OSError):  # some systems and network file systems cannot; the file itself is safe
            _sync(target.parent, os.O_RDONLY)
    except OSError as error:
        # a name that was taken, of this file; other errors may concern another one that was read meanwhile
        if isinstance(error, FileExistsError) and error.filename2 is not None:
            raise UnoccludeError(
                f"{path} was written by another command meanwhile; give another name, or force=True to"
                " overwrite it."
            ) from error
        other = error.filename is not None and Path(os.fsdecode(error.filename)) != temporary
        raise could_not_be_written(path, error, str(error.filename) if other else "") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def could_not_be_written(path: str | os.PathLike[str], error: OSError, where: str = "") -> UnoccludeError:
    """What went wrong, for the user."""
    reason, remedy = error.strerror or str(error), ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        reason, remedy = "no space left on the disk", "; make room and run again"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        remedy = "; write to a folder of your own"
    elif error.errno == errno.ENXIO:
        return UnoccludeError(f"{path} is a pipe without a reader; start the reader first, or name a file.")
    return UnoccludeError(f"{path} could not be written: {reason}{f' ({where})' if where else ''}{remedy}.")


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Whether a name refers to a pipe, for this program's own standard output, or for the null device."""
    try:
        about = os.stat(path)
    except (OSError, ValueError):
        return False
    if stat.S_ISFIFO(about.st_mode) or _is_standard_output(path, about):
        return True
    return stat.S_ISCHR(about.st_mode) and os.path.samestat(about, os.stat(os.devnull))


def _is_standard_output(path: str | os.PathLike[str], about: os.stat_result) -> bool:
    """Such as /dev/stdout, also where it leads to a file."""
    named = os.fspath(path).startswith(("/dev/", "/proc/"))
    with suppress(OSError):
        return named and os.path.samestat(about, os.fstat(1))
    return False


@contextmanager
def _sending(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary file to write to; its content goes to the stream `path` when all went well."""
    try:
        with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:  # for its owner alone
            temporary = Path(folder) / "output"
            temporary.touch(mode=0o600)
            yield temporary
            with open(temporary, "rb") as content, os.fdopen(_handle(path), "wb") as stream:
                shutil.copyfileobj(content, stream)
    except BrokenPipeError as error:
        raise UnoccludeError(f"{path} could not be written: its reader went away.") from error
    except OSError as error:
        raise could_not_be_written(path, error) from error


def _handle(path: str | os.PathLike[str]) -> int:
    """Open a pipe or device; without O_NONBLOCK a pipe without a reader would block this program for ever."""
    if _is_standard_output(path, os.stat(path)):
        with suppress(OSError, ValueError):
            sys.stdout.flush()  # what was printed comes first
        return os.dup(1)  # opened anew, a file would be written from its beginning
    deadline = time.monotonic() + READER_S
    while True:
        try:
            handle = os.open(path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0))
            break
        except OSError as error:
            if error.errno != errno.ENXIO or time.monotonic() > deadline:
                raise
        time.sleep(0.05)
    if hasattr(os, "set_blocking"):
        os.set_blocking(handle, True)
    return handle


def temporary_name(target: Path) -> Path:
    """A hidden name beside `target` that cannot be foreseen."""
    return target.with_name(f".{target.name[:_NAME_CHARACTERS]}.{secrets.token_hex(12)}{_ENDING}")


def is_temporary(name: str) -> bool:
    """Whether a file's name is one that `temporary_name` gives."""
    return _NAME.fullmatch(name) is not None


@contextmanager
def locked(path: Path, folder: bool = False) -> Iterator[None]:
    """Make an empty file, or a folder, that only its owner can enter, and keep it from being swept."""
    if folder:
        path.mkdir(mode=0o700)
        flags = os.O_RDONLY
        if os.name != "posix":
            yield
            return
    else:
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
    flags |= getattr(os, "O_CLOEXEC", 0)
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
    """Remove temporary files, and folders, that programs of ours left in a folder when they were killed."""
    if folder in _swept and not again:
        return
    _swept.add(folder)
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in [entry for entry in entries if is_temporary(entry.name)]:
            with suppress(OSError):
                _remove(Path(entry.path))


def _remove(path: Path) -> None:
    """Remove what is not locked; never what belongs to someone else."""
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


def check_output(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse an output that could not be written in the end, before any work is done for it."""
    target = Path(path)
    if is_stream(target):
        return
    _check_kind(target)
    if target.exists() and not force:
        raise UnoccludeError(f"{target} exists already; give another name, or force=True to overwrite it.")
    if target.is_symlink() and not target.exists():
        target = target.resolve()
    if not target.absolute().parent.is_dir():
        raise UnoccludeError(f"The folder {target.absolute().parent} does not exist; create it first.")


def _check_kind(target: Path) -> None:
    """Nothing but a regular file, or nothing at all, is ever replaced."""
    try:
        mode = os.stat(target).st_mode
    except OSError as error:
        if error.errno in (errno.ELOOP, errno.ENAMETOOLONG, errno.EINVAL):
            raise UnoccludeError(f"{target}: {error.strerror}; give another name.") from error
        return
    except ValueError as error:  # a NUL in the name
        raise UnoccludeError(f"{str(target)!r} is not a valid file name; give another.") from error
    if stat.S_ISDIR(mode):
        raise UnoccludeError(f"{target} is a folder; name a file to write to.")
    if not stat.S_ISREG(mode):
        raise UnoccludeError(f"{target} is a device or a socket, not a file; name a file to write to.")


def _give_name(temporary: Path, target: Path, force: bool) -> None:
    """Give the output its name in one step; of two without `force`, the second finds the name taken."""
    _check_kind(target)  # it may have become another thing meanwhile
    if force:
        os.replace(temporary, target)
    elif os.name != "posix":
        os.rename(temporary, target)  # replaces nothing there
    else:
        try:
            os.link(temporary, target)  # as a move that replaces nothing
        except FileExistsError:
            raise
        except OSError:  # a file system without links: the name is taken by an empty file first
            try:
                os.close(os.open(target, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            except FileExistsError as error:
                raise FileExistsError(error.errno, "", str(temporary), None, str(target)) from error
            os.replace(temporary, target)


def _give_mode(temporary: Path, target: Path) -> None:
    """The mode (and, where allowed, the owner) of the file that is replaced, else what the umask says."""
    try:
        before = os.stat(target)
    except OSError:
        os.chmod(temporary, 0o666 & ~umask())
        return
    mode = stat.S_IMODE(before.st_mode) & 0o777
    now = os.stat(temporary)
    if hasattr(os, "chown") and (now.st_uid, now.st_gid) != (before.st_uid, before.st_gid):
        try:
            os.chown(temporary, before.st_uid if os.geteuid() == 0 else -1, before.st_gid)
        except OSError:  # another group must not read what this one could
            mode &= ~0o070 | (mode & 0o007) << 3
    os.chmod(temporary, mode)


def umask() -> int:
    """The process's umask; read where the system reports it, since setting it concerns all threads."""
    with suppress(OSError, ValueError, IndexError), open("/proc/self/status", encoding="ascii") as status:
        return int(next(line for line in status if line.startswith("Umask:")).split()[1], 8)
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _sync(path: Path, flags: int) -> None:
    """Make a file's content, or the names in a folder, durable."""
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
