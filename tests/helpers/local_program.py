"""`unocclude app` as a program of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: A busy machine starts a program within this, s.
_START_S = 90.0


def program_words(folder: Path, *more: str) -> list[str]:
    """Command and words of `unocclude app` on a folder."""
    code = "from smoother.cli import main; main()"
    return [sys.executable, "-c", code, "app", "--folder", str(folder), "--no-browser", *more]


def environment() -> dict[str, str]:
    """In which these sources are what is imported."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PYTHONPATH": path}


class Program:
    """`unocclude app` as a user starts it; `close` ends it and what it runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(
            program_words(self.folder), stdout=subprocess.PIPE, text=True, env=environment()
        )
        timer = threading.Timer(_START_S, self._process.kill)  # a program that hangs says nothing
        timer.start()
        try:
            self.address = self._process.stdout.readline().strip()
        finally:
            timer.cancel()
        assert self.address.startswith("http://127.0.0.1:"), self.address

    def kill(self) -> None:
        self._process.kill()
        self._process.wait(20)

    def close(self) -> int:
        """End it as Ctrl-C does; its exit code."""
        self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(30)
        finally:
            self._process.kill()

    def rest(self) -> str:
        """What it printed after the address, once it has ended."""
        return self._process.stdout.read()

    def only(self) -> Path:
        (place,) = (path.parent for path in self.folder.glob("*/app.json"))
        return place
