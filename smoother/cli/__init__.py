"""The command line: `unocclude`."""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from contextlib import suppress
from typing import Any

from ..runtime.packages import keep_freed_memory


def main() -> None:
    """Run the command that the arguments name, and exit with its code."""
    # all cores are kept busy by processes; threads of the libraries inside only get in each other's way
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # of what imports make nothing is garbage, and looking through it takes 0.06 s
    gc.set_threshold(300_000)
    # no library's plugin belongs here, and pydantic would read every installed package's metadata for them
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    keep_freed_memory()
    _open_closed_streams()
    if isinstance(old := sys.stdout, io.TextIOWrapper) and not old.isatty():
        raw = io.BufferedWriter(_Output(1, "wb", closefd=False))
        sys.stdout = io.TextIOWrapper(raw, old.encoding, old.errors, line_buffering=old.line_buffering)
    try:
        from .run import run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:  # before or after the command itself
        print("unocclude: interrupted", file=sys.stderr)
        code = 1
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # nothing is left to interrupt
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):  # the reader is gone; Python tries once more as it ends
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    gc.freeze()  # or Python looks through all that was imported once more before it ends: 0.07 s
    sys.exit(code)


def _open_closed_streams() -> None:
    """Where a shell closed standard input, output or error (`>&-`), put the null device in its place.

    Python then has no such stream, and the next file that is opened gets its number: what a library prints
    would go into an output.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:  # the lowest free number is this one; worker processes want it as well
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        if getattr(sys, name) is None:
            stream = open(number, mode, encoding="utf-8", closefd=False)  # noqa: SIM115 - open to the end
            setattr(sys, name, stream)


class _Output(io.FileIO):
    """Standard output; what is printed after its reader went away (| head) goes nowhere."""

    def write(self, data: Any, /) -> int:
        with suppress(BrokenPipeError):
            return super().write(data)
        return len(data)
