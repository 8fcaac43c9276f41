"""The private memory of a process and of its workers.

Private is what a process has for itself (RssAnon). Pages of mapped files are the system's, which takes them
back when it needs room, and libraries are shared. The kernel keeps no peak of this: it is looked at.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

#: How often to look, s.
MEMORY_LOOK_S = 0.02


class PrivatePeak:
    """Looks at the private memory of a process and of its workers again and again."""

    def __init__(self, pid: int | None = None, look_s: float = MEMORY_LOOK_S) -> None:
        self._pid = os.getpid() if pid is None else pid
        self._most: dict[int, float] = {}
        self.workers = 0
        self._look()
        threading.Thread(target=self._watch, args=(look_s,), daemon=True).start()

    def mb(self) -> float:
        """The peak of the process so far, 10^6 bytes; 0 where there is no /proc."""
        self._look()
        return self._most[self._pid]

    def worker_mb(self) -> float:
        """The peak of the largest worker so far, 10^6 bytes; 0 without one."""
        return max((mb for pid, mb in list(self._most.items()) if pid != self._pid), default=0.0)

    def _watch(self, look_s: float) -> None:
        pause = threading.Event()
        while self._look() and not pause.wait(look_s):
            pass

    def _look(self) -> float:
        """Look once; what the process has now."""
        now = private_mb(self._pid)
        self._most[self._pid] = max(self._most.get(self._pid, 0.0), now)
        workers = workers_of(self._pid)
        self.workers = max(self.workers, len(workers))
        for worker in workers:
            self._most[worker] = max(self._most.get(worker, 0.0), private_mb(worker))
        return now


def private_mb(pid: int) -> float:
    """Private memory now, 10^6 bytes; 0 where the process is gone or there is no /proc."""
    try:
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("RssAnon:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return 0.0


def workers_of(pid: int) -> set[int]:
    """Processes that this one and its children started and that run, Python's own bookkeeper left out."""
    return {child for child in _descendants(pid) if b"resource_tracker" not in _command_line(child)}


def _command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def _descendants(pid: int) -> set[int]:
    children: set[int] = set()
    try:
        for path in Path(f"/proc/{pid}/task").glob("*/children"):
            children |= {int(child) for child in path.read_text().split()}
    except OSError:  # gone, or no such system
        pass
    return children.union(*map(_descendants, children))
