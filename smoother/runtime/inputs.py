"""Inputs are files: a pipe may never end and a device may never begin."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from ..errors import UnoccludeError


def check_input(path: str | os.PathLike[str], error: type[UnoccludeError] = UnoccludeError) -> None:
    """Refuse what is there and is neither a file nor a folder, and a link that leads to nothing.

    What is missing altogether is its reader's to say.

    Parameters
    ----------
    path : path-like
        What is about to be opened.
    error : type of UnoccludeError
        As which it is refused.

    Raises
    ------
    UnoccludeError
        A pipe, a socket or a device; a link whose file is missing, which leads back to itself, or to where
        this user may not look.
    """
    try:
        mode = os.stat(path).st_mode
    except OSError as reason:
        if trouble := _link_trouble(path, reason):
            raise error(trouble) from reason
        return
    except ValueError:
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise error(f"{path} is a pipe, a socket or a device; save what it gives as a file first.")


def _link_trouble(path: str | os.PathLike[str], reason: OSError) -> str:
    """Why a link cannot be followed, as a sentence; "" where `path` is no link, or is missing."""
    if reason.errno == errno.ELOOP:
        return f"{path}: a link leads back to itself; name the file itself."
    try:
        target = os.readlink(path)
    except (OSError, ValueError):
        return ""
    if reason.errno in (errno.ENOENT, errno.ENOTDIR):
        return f"{path} is a link to {target}, which does not exist; mend the link, or name the file itself."
    if reason.errno in (errno.EACCES, errno.EPERM):
        return f"{path} is a link to {target}, which this user may not read; ask for it, or name a copy."
    return f"{path} is a link to {target}, which cannot be followed: {reason.strerror or reason}."


def inside(folder: str | os.PathLike[str], name: str) -> Path | None:
    """The file of a folder that a text in that folder names; None where it leads out of it, by a link too.

    Parameters
    ----------
    folder : path-like
        Where the text lies.
    name : str
        As the text has it.
    """
    path = Path(folder) / name
    try:
        real = Path(os.path.realpath(path))
    except ValueError:  # a NUL in the name
        return None
    return path if real.is_relative_to(os.path.realpath(folder)) else None
