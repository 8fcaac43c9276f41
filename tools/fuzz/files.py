"""Where a target's files lie: in memory where the system has such a folder."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path

_SHM = Path("/dev/shm")


@cache
def _folder(process: int) -> tempfile.TemporaryDirectory[str]:
    """A folder of this process, that goes when it ends."""
    return tempfile.TemporaryDirectory(prefix="unocclude_fuzz_", dir=_SHM if _SHM.is_dir() else None)


def place(name: str) -> Path:
    """A file's place."""
    return Path(_folder(os.getpid()).name) / name


def file_of(data: bytes, name: str) -> Path:
    """The bytes as a file."""
    path = place(name)
    path.write_bytes(data)
    return path
