"""What workers of a pool do in tests: in a file of its own, as each worker imports it and no more."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path


def die_always(_: str) -> None:
    """As the system's OOM killer ends it."""
    os.kill(os.getpid(), signal.SIGKILL)


def wait_long(mark: str) -> None:
    Path(mark).write_text(str(os.getpid()))
    time.sleep(120)


def answer_half(mark: str) -> str:
    """Half of an answer: then the worker dies, or with a mark called `.long` it writes no more."""
    path = Path(mark)
    if path.exists():
        return path.name
    send = Connection._send  # type: ignore[attr-defined]

    def half(self: Connection, data: bytes) -> None:
        send(self, data[: len(data) // 2])
        path.write_text(str(os.getpid()))
        if path.suffix == ".long":
            time.sleep(120)
        os.kill(os.getpid(), signal.SIGKILL)

    Connection._send = half  # type: ignore[attr-defined]
    return path.name
