"""Memory of a running process and of the workers it started, as Linux keeps it in /proc.

The peak is VmHWM: the most that was resident at a time, the kernel's own mark, so that looking now and then
misses nothing but what a process that ends between two looks gained in between. (`ru_maxrss` would not do:
a child's starts at what its parent held when it was started.) Pages of files that are mapped count while
they are resident, and libraries that processes share count in each.
"""

from __future__ import annotations

from pathlib import Path


def peak_mb(pid: int) -> float:
    """Most resident memory so far, 10^6 bytes; 0 where the process is gone or there is no /proc."""
    try:
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    except OSError:
        pass
    return 0.0


def workers_of(pid: int) -> set[int]:
    """Processes that this one and its children started and that run, Python's own bookkeeper left out."""
    return {each for each in _descendants(pid) if b"resource_tracker" not in _command_line(each)}


def _command_line(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def _descendants(pid: int) -> set[int]:
    found: set[int] = set()
    try:
        for children in Path(f"/proc/{pid}/task").glob("*/children"):
            found |= {int(each) for each in children.read_text().split()}
    except OSError:  # gone, or no such system
        return found
    for child in list(found):
        found |= _descendants(child)
    return found
