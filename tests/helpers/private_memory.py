"""Peak of a process's private memory (RssAnon): mapped files are the system's, which takes them back."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from pathlib import Path

STATUS = Path("/proc/self/status")


class PrivatePeak:
    """Looks at this process's private memory every few milliseconds; `mb()` is the most it saw."""

    def __init__(self) -> None:
        self._most = self._now()
        threading.Thread(target=self._watch, daemon=True).start()

    @staticmethod
    def _now() -> float:
        found = re.search(r"RssAnon:\s+(\d+)", STATUS.read_text())
        assert found is not None
        return int(found[1]) / 1024

    def _watch(self) -> None:
        pause = threading.Event()
        while not pause.wait(0.002):
            self._most = max(self._most, self._now())

    def mb(self) -> float:
        """The peak so far, MB."""
        self._most = max(self._most, self._now())
        return self._most


def program_output(program: str, *arguments: object) -> str:
    """What a program of its own prints; it may import this module."""
    start = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    command = [sys.executable, "-c", start + program, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
