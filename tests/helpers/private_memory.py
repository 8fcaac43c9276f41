"""Programs in a process of their own that look at its private memory."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from tools import benchmark

PrivatePeak = partial(benchmark.PrivatePeak, look_s=0.002)


def program_output(program: str, *arguments: object) -> str:
    """What a program of its own prints; it may import this module."""
    start = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    command = [sys.executable, "-c", start + program, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
