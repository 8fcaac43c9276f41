"""Outputs that are either whole or not there, and none left half by a program that was killed.

A temporary file's name has the process that writes it; what one left behind that is gone is removed later.
"""

from __future__ import annotations

import errno
import os
import platform
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import UnoccludeError

_ENDING = ".unocclude.tmp"
#: What tells computers apart that share a name and a folder; it is not there but on Linux.
_BOOT = Path("/proc/sys/kernel/random/boot_id")
#: This computer and the process that writes, in the name of a temporary file.
_HOST = f"{zlib.crc32(platform.node().encode() + (_BOOT.read_bytes() if _BOOT.exists() else b'')):08x}"
_NAME = re.compile(r"\..*\.([0-9a-f]{8})-(\d+)-[0-9a-f]{12}" + re.escape(_ENDING) + r"(\.\w+)?")
#: A file of another computer's that nobody wrote to for this long was left behind, s.
_STALE_S = 86_400.0
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
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
        os.close(os.open(temporary, flags, 0o600))  # for its owner alone
        yield temporary
        _give_mode(temporary, target)
        _sync(temporary, os.O_RDWR)
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


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Whether a name is that of a pipe, of the null device, or of what this program prints to."""
    try:
        about, own = os.stat(path), os.fstat(1)
    except (OSError, ValueError):
        return False
    named = os.fspath(path).startswith(("/dev/", "/proc/"))  # also where that leads to a file
    is_null = os.path.samestat(about, os.stat(os.devnull))
    return stat.S_ISFIFO(about.st_mode) or is_null or (named and os.path.samestat(about, own))


@contextmanager
def _sending(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary file to write to; its content goes to the stream `path` when all went well."""
    try:
        with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:  # for its owner alone
            temporary = Path(folder) / "output"
            temporary.touch(mode=0o600)
            yield temporary
            sys.stdout.flush()  # what was printed comes first
            is_own = os.path.samestat(os.stat(path), os.fstat(1))  # opened anew, a file would begin anew
            with open(temporary, "rb") as content, open(os.dup(1) if is_own else path, "wb") as stream:
                shutil.copyfileobj(content, stream)
    except OSError as error:
        raise could_not_be_written(path, error) from error


@contextmanager
def writing_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a folder beside `path` to write into; it takes the place of `path` when all went well."""
    target = Path(path)
    beside = temporary_name(target)
    old = beside.with_suffix(".old")
    try:
        remove_stale_tempfiles(target.absolute().parent)
        beside.mkdir(mode=0o700)
        yield beside
        beside.chmod(stat.S_IMODE(target.stat().st_mode) if target.exists() else 0o777 & ~umask())
        if target.exists():
            target.rename(old)
        beside.rename(target)
    except OSError as error:
        raise could_not_be_written(path, error) from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        if old.exists() and not target.exists():
            old.rename(target)
        shutil.rmtree(old, ignore_errors=True)


def could_not_be_written(path: str | os.PathLike[str], error: OSError, where: str = "") -> UnoccludeError:
    """What went wrong, for the user."""
    reason, remedy = error.strerror or str(error), ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        reason, remedy = "no space left on the disk", "; make room and run again"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        remedy = "; write to a folder of your own"
    return UnoccludeError(f"{path} could not be written: {reason}{f' ({where})' if where else ''}{remedy}.")


def temporary_name(target: Path, process: int | None = None) -> Path:
    """A hidden name beside `target` that cannot be foreseen, for a process of this computer (this one)."""
    mark = f"{_HOST}-{os.getpid() if process is None else process}-{secrets.token_hex(6)}"
    return target.with_name(f".{target.name[:_NAME_CHARACTERS]}.{mark}{_ENDING}")


def remove_stale_tempfiles(folder: Path, again: bool = False) -> None:
    """Remove temporary files, and folders, that programs of ours left in a folder when they were killed."""
    if folder in _swept and not again:
        return
    _swept.add(folder)
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in list(entries):
            with suppress(OSError):
                if not _is_stale(entry):
                    continue
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    os.unlink(entry.path)


def _is_stale(entry: os.DirEntry[str]) -> bool:
    """Whether it is a temporary file whose process is gone; of another computer, one that is old."""
    name = _NAME.fullmatch(entry.name)
    if name is None:
        return False
    if name[1] != _HOST or os.name != "posix":
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > _STALE_S
    try:
        os.kill(int(name[2]), 0)  # nothing is sent
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # it is another user's
        return False
    return False


def check_output(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse an output that could not be written in the end, before any work is done for it."""
    target = Path(path)
    _check_kind(target)
    if target.exists() and not force and not is_stream(target):
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
    if not stat.S_ISREG(mode) and not is_stream(target):
        raise UnoccludeError(f"{target} is a socket or a device; name a file to write to.")


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
    """The mode of the file that is replaced, else what the umask says."""
    try:
        before = os.stat(target)
    except OSError:
        os.chmod(temporary, 0o666 & ~umask())
        return
    os.chmod(temporary, stat.S_IMODE(before.st_mode) & 0o777)


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
