"""What workers of a pool do in tests: in a file of its own, as each worker imports it and no more."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def double(number: int) -> int:
    return 2 * number


def die_once(mark: str) -> str:
    """The end of the worker that does it first, as the system's OOM killer ends it."""
    path = Path(mark)
    if path.suffix == ".once" and not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


def die_always(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def wait_long(mark: str) -> None:
    Path(mark).write_text(str(os.getpid()))
    time.sleep(120)
