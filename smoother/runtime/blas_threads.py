"""NumPy's linear algebra kept to one thread."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

from .pool import THREADS

#: Commands and worker processes start so; what the environment says later, NumPy does not hear.
_ONE_FROM_THE_START = any(os.environ.get(name) == "1" for name in THREADS)
_lock = Lock()
_inside = 0
_limits: Any = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread meanwhile, in a notebook as in the commands, which start it so.

    A window's matrices are small: more threads take twice the processor time and sum in another order, so
    that the answer would differ from the command's in its last digits.
    """
    global _inside, _limits
    if _ONE_FROM_THE_START:
        yield
        return
    from threadpoolctl import threadpool_limits

    with _lock:  # the first one in sets the limit, the last one out takes it away
        if _inside == 0:
            _limits = threadpool_limits(1, user_api="blas")
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0:
                _limits.restore_original_limits()
