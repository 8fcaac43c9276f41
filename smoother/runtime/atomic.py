"""Outputs that are either whole or not there."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import UnoccludeError


@contextmanager
def writing(path: str | os.PathLike[str], force: bool = False) -> Iterator[Path]:
    """Yield a hidden name beside `path` to write to; it becomes `path` when all went well.

    Parameters
    ----------
    path : str or path
        Where the output is to lie; its folder must exist.
    force : bool
        Overwrite an output that exists.

    Yields
    ------
    temporary : Path
        What to write to. On any failure it is removed, and an older output stays as it was.

    Raises
    ------
    UnoccludeError
        The output exists and `force` is not given, the folder is missing, or writing failed
        (full disk, no permission).
    """
    target = Path(path)
    check_output(target, force)
    # A link keeps pointing at the file it named, which is the one replaced.
    target = target.resolve()
    temporary = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, target)
        _sync_folder(target.parent)
    except OSError as error:
        raise UnoccludeError(_sentence(Path(path), temporary, error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_output(path: str | os.PathLike[str], force: bool = False) -> None:
    """Refuse an output that could not be written in the end, before any work is done for it.

    Raises
    ------
    UnoccludeError
        The output exists and `force` is not given, is a folder, or its folder is missing.
    """
    target = Path(path)
    if target.is_dir():
        raise UnoccludeError(f"{target} is a folder; name a file to write to.")
    if target.exists() and not force:
        raise UnoccludeError(f"{target} exists already; give another name, or --force to overwrite it.")
    if not target.absolute().parent.is_dir():
        raise UnoccludeError(f"The folder {target.absolute().parent} does not exist; make it first.")


def _sync(path: Path) -> None:
    with open(path, "rb+") as file:
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Make the new name itself durable, where the system can."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:
        pass  # some network file systems cannot; the file itself is safe
    finally:
        os.close(handle)


def _sentence(path: Path, temporary: Path, error: OSError) -> str:
    """What went wrong, for the user; `error` may concern another file that was read meanwhile."""
    other = error.filename is not None and Path(os.fsdecode(error.filename)) != temporary
    where = f" ({error.filename})" if other else ""
    reason = error.strerror or str(error)
    if error.errno == errno.ENOSPC:
        return f"{path} could not be written: no space left on the disk{where}; make room and run again."
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"{path} could not be written: {reason}{where}; write to a folder of your own."
    return f"{path} could not be written: {reason}{where}."
