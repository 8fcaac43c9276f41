"""One BLAS thread while a recording is solved, however the process was started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from smoother.runtime import pool
from smoother.runtime.pool import THREADS, one_blas_thread

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"
CODE = """
import hashlib
from smoother import read_recording, smooth
print(hashlib.sha256(smooth(read_recording({path!r})).position.tobytes()).hexdigest())
"""


def threads_now() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_a_notebook_gives_the_bytes_of_the_command():
    """A notebook has NumPy with a thread a core; two are asked for here, whatever the machine has."""
    inherited = {name: value for name, value in os.environ.items() if name not in THREADS}
    printed = [
        subprocess.run(
            [sys.executable, "-c", CODE.format(path=str(DEMO))],
            env=inherited | dict.fromkeys(THREADS, threads),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    ]
    assert printed[0] == printed[1] and len(printed[0]) == 65


def test_the_limit_ends_with_the_last_one_inside(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pool, "_ONE_FROM_THE_START", False)
    first, second = one_blas_thread(), one_blas_thread()
    with threadpool_limits(2, user_api="blas"):
        before = threads_now()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads_now() == {1}
        second.__exit__(None, None, None)
        assert threads_now() == before
        with pytest.raises(ValueError), one_blas_thread():
            raise ValueError
        assert threads_now() == before
