"""What the C library keeps of freed memory."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

CODE = """
import resource
import numpy as np
from smoother.runtime.allocation import keep_freed_memory
if {kept}:
    keep_freed_memory()

def pages():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        large = [np.ones(100_000) for _ in range(4)]  # of 0.8 MB: no page of theirs is a huge one
        del large
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

pages()
print(pages())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="a parameter of glibc's")
def test_freed_memory_is_not_asked_for_anew() -> None:
    given_back, kept = (
        int(subprocess.run([sys.executable, "-c", CODE.format(kept=each)], capture_output=True).stdout)
        for each in (False, True)
    )
    assert kept < 50
    assert given_back > 10 * kept
