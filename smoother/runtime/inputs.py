"""Inputs are files: a pipe may never end and a device may never begin."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from ..errors import UnoccludeError


def check_input(path: str | os.PathLike[str], error: type[UnoccludeError] = UnoccludeError) -> None:
    """Refuse what is there and is neither a file nor a folder; what is missing is its reader's to say.

    Parameters
    ----------
    path : path-like
        What is about to be opened.
    error : type of UnoccludeError
        As which it is refused.

    Raises
    ------
    UnoccludeError
        A pipe, a socket or a device.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise error(f"{path} is a pipe, a socket or a device; save what it gives as a file first.")


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
