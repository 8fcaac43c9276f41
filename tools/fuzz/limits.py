"""What one input may take, of time and of memory: more is a finding."""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

#: On the processor, s: the wall's clock says more of what else the machine does.
MOST_S = 10.0
#: Of memory above what the process holds anyway, MB.
MOST_MB = 1500.0
#: What the process holds anyway is measured anew after so many inputs: atheris keeps new inputs.
_ANEW = 1000
#: Bytes of `ru_maxrss`.
_UNIT = 1 if sys.platform == "darwin" else 1024


class Limits:
    """Runs inputs one by one and raises where one takes too much.

    Attributes
    ----------
    resting_mb : float, MB
        What the process holds between two inputs.

    Parameters
    ----------
    run : callable
        Takes the bytes of an input.
    """

    def __init__(self, run: Callable[[bytes], None]):
        self._run = run
        self._count = 0
        self.resting_mb = _held_mb()

    def __call__(self, data: bytes) -> None:
        """Run one input.

        Raises
        ------
        TimeoutError, MemoryError
            It takes too long, or too much memory, here or in a process of its own.
        """
        if self._count % _ANEW == 0:
            self.resting_mb = _held_mb()
        self._count += 1
        peak, child = _peak_mb(resource.RUSAGE_SELF), _peak_mb(resource.RUSAGE_CHILDREN)
        begun = time.process_time()
        self._run(data)
        seconds = time.process_time() - begun
        if seconds > MOST_S:
            raise TimeoutError(f"{seconds:.1f} s on the processor for {len(data)} bytes")
        for before, who in ((peak, resource.RUSAGE_SELF), (child, resource.RUSAGE_CHILDREN)):
            after = _peak_mb(who)
            if after > before and after - self.resting_mb > MOST_MB:
                raise MemoryError(f"{after - self.resting_mb:.0f} MB for {len(data)} bytes")


def _peak_mb(who: int) -> float:
    """The most that a process, or the largest of its children, has ever held."""
    return resource.getrusage(who).ru_maxrss * _UNIT / 1e6


def _held_mb() -> float:
    """What this process holds; its peak where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return _peak_mb(resource.RUSAGE_SELF)
    return pages * resource.getpagesize() / 1e6
