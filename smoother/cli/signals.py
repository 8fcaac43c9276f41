"""Signals that end a command: as Ctrl-C does, so that outputs and workers are tidied up first."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def ending_tidily() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt; a second one is not heard meanwhile.

    What is ignored (`nohup`) stays so. Only the main thread can be interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before: dict[int, Any] = {}

    def end(number: int, _: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        if hasattr(signal, "pthread_sigmask") and signal.SIGINT in signal.pthread_sigmask(
            signal.SIG_BLOCK, ()
        ):
            # processes are being started: Ctrl-C is held back, and so is this
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            return
        raise KeyboardInterrupt

    for name in ("SIGTERM", "SIGHUP", "SIGBREAK"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP, others no SIGBREAK
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
