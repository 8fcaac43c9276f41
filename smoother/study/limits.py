"""What one recording of a study may take: time, and private memory."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from ..errors import UnoccludeError

#: A recording that a library holds on to for so much longer than its time ends with its process, s.
GRACE_S = 60.0


@dataclass(frozen=True)
class Limits:
    """What one recording may take; 0 = as much as it wants.

    Attributes
    ----------
    time_s : float, s
        From its first byte to its last.
    memory_bytes : int
        Private memory of its process; long columns lie in files and do not count. Held to on Linux.
    """

    time_s: float = 0.0
    memory_bytes: int = 0


class TimeUp(BaseException):
    """A recording takes too long; no error of the method's own, which must not be dealt with on the way."""


@contextmanager
def limited(limits: Limits) -> Iterator[None]:
    """Hold what runs within to its limits.

    Raises
    ------
    TimeUp
        Within, when the time is over.
    MemoryError
        Within, where more memory is asked for than is allowed.
    UnoccludeError
        This system cannot limit memory.
    """
    with _memory(limits.memory_bytes), _time(limits.time_s):
        yield


@contextmanager
def _time(seconds: float) -> Iterator[None]:
    """Interrupt this thread when the time is over; a library that does not let go ends with the process."""
    if not seconds:
        yield
        return
    thread, over = threading.get_ident(), threading.Event()
    lock = threading.Lock()

    def interrupt() -> None:
        if over.wait(seconds):
            return
        with lock:
            if not over.is_set():
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(TimeUp))

    watcher = threading.Thread(target=interrupt, name="time limit", daemon=True)
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(seconds + GRACE_S, exit=True, file=nowhere)
        watcher.start()
        try:
            yield
        finally:
            with lock:
                over.set()
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), None)
            faulthandler.cancel_dump_traceback_later()


@contextmanager
def _memory(allowed: int) -> Iterator[None]:
    """Let the system refuse this process more private memory than it has now and is allowed."""
    if not allowed:
        yield
        return
    if sys.platform != "linux":
        raise UnoccludeError("--memory-limit needs Linux; give fewer --processes instead")
    import resource

    before = resource.getrlimit(resource.RLIMIT_DATA)
    highest = before[1]
    wanted = _data_bytes() + allowed
    if highest != resource.RLIM_INFINITY:
        wanted = min(wanted, highest)
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, highest))
    try:
        yield
    finally:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, before)


def _data_bytes() -> int:
    """What counts for the limit already: libraries and their threads' stacks."""
    with open("/proc/self/status", encoding="ascii") as status:
        return 1024 * int(next(line for line in status if line.startswith("VmData:")).split()[1])
