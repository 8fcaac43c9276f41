"""How the C library gives memory back to the system."""

from __future__ import annotations

import sys
from contextlib import suppress

#: Parameters of glibc's `mallopt`: blocks smaller than the first are taken from the heap, at whose end up to
#: the second stays free, bytes.
_MMAP_THRESHOLD, _TRIM_THRESHOLD = (-3, 32 << 20), (-1, 16 << 20)


def keep_freed_memory() -> None:
    """Keep what is freed for what is needed next, instead of giving it back at once."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # other C libraries have no such parameters
            import ctypes

            library = ctypes.CDLL(None)
            for parameter, size in (_MMAP_THRESHOLD, _TRIM_THRESHOLD):
                library.mallopt(parameter, size)
