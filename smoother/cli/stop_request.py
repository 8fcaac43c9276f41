"""How a session is ended: by Ctrl-C, by a signal, or by a key."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType, TracebackType
from typing import Any

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")


class StopRequest:
    """Takes signals and keys down; nothing is interrupted, so that the recording stays whole.

    Keys on a terminal: `q` ends, `s` ends and smooths what was recorded.

    Attributes
    ----------
    wanted : bool
        The session is to end.
    smooth : bool
        And to be smoothed.
    killed : bool
        By another signal than Ctrl-C: nothing more is to be begun.
    """

    def __init__(self) -> None:
        self.wanted = self.smooth = self.killed = False
        self._before: dict[int, Any] = {}
        self._terminal: list[Any] | None = None

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            for name in _SIGNALS:
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._end)
        with suppress(ImportError, OSError, ValueError, AttributeError):
            import termios
            import tty

            # in the background of a shell, a change of the terminal would stop this program
            if sys.stdin.isatty() and os.getpgrp() == os.tcgetpgrp(sys.stdin.fileno()):
                self._terminal = termios.tcgetattr(sys.stdin)
                tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._terminal is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._terminal)

    @property
    def has_keys(self) -> bool:
        """Keys are listened to."""
        return self._terminal is not None

    def __call__(self) -> bool:
        """Whether the session is to end."""
        if self._terminal is not None and not self.wanted:
            self._read_key()
        return self.wanted

    def _read_key(self) -> None:
        import select

        if select.select([sys.stdin], [], [], 0)[0]:
            key = os.read(sys.stdin.fileno(), 1).decode("ascii", "ignore").lower()
            self.wanted = key in ("q", "s")
            self.smooth = key == "s"
            if not key:  # the terminal has gone
                self._terminal = None

    def _end(self, number: int, _: FrameType | None) -> None:
        self.wanted = True
        self.killed |= number != signal.SIGINT
