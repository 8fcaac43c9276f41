"""Run a command: whatever goes wrong becomes one sentence on stderr and an exit code."""

from __future__ import annotations

import io
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

import typer

from ..errors import debugging, sentence_of
from ..runtime.packages import missing_package
from ..runtime.printable import printable


@contextmanager
def handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Have a handler for all signals that end a program; what is ignored (`nohup`) stays so."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other can be interrupted
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP, others no SIGBREAK
            if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def ending_tidily() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt; a second one is not heard meanwhile.

    All, and Ctrl-C, wait until an import is over: a library that is being initialised turns them into errors.
    """

    def end(number: int, frame: FrameType | None) -> None:
        if _imports(frame):
            waits = threading.Timer(0.02, os.kill, (os.getpid(), number))
            waits.daemon = True
            waits.start()
            return
        for name in ("SIGTERM", "SIGHUP", "SIGBREAK"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
        if hasattr(signal, "pthread_sigmask") and signal.SIGINT in signal.pthread_sigmask(
            signal.SIG_BLOCK, ()
        ):
            # processes are being started: Ctrl-C is held back, and so is this
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            return
        raise KeyboardInterrupt

    with handling(end):
        yield


def _imports(frame: FrameType | None) -> bool:
    """Whether a frame is inside an import."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


OK, FAILED, WRONG_USE = 0, 1, 2
#: `check`, and `smooth` and `batch` with --strict: a result is not to be trusted.
NOT_TRUSTED = 3
#: What typer returns after Ctrl-C.
INTERRUPTED = 130
STOPPED = "interrupted; no output is left half written"


def run(arguments: Sequence[str]) -> int:
    """Run `unocclude` with these arguments."""
    from .app import app

    if not debugging():
        warnings.simplefilter("ignore")  # a library's warning is of no use to a user
    for stream in (sys.stdout, sys.stderr):  # a name that the terminal's encoding lacks does not end it
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with ending_tidily():
            code = app(list(arguments), prog_name="unocclude", standalone_mode=False)
            if sys.stdout is not None:
                sys.stdout.flush()
        return _fail(STOPPED, FAILED) if code == INTERRUPTED else int(code or OK)
    except KeyboardInterrupt:
        return _fail(STOPPED, FAILED)
    except Exception as error:
        if debugging():
            traceback.print_exc()
        return _fail(*explain(error))


def explain(error: BaseException) -> tuple[str, int]:
    """One sentence for an error, and the exit code."""
    if isinstance(error, typer.Abort):
        return STOPPED, FAILED
    if hasattr(error, "format_message"):  # typer's errors of use
        text = str(error.format_message()).rstrip(".").replace("Value error, ", "")
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "unocclude"
        return f"{text}; see {command} --help", WRONG_USE
    missing = missing_package(error) if isinstance(error, ImportError) else None
    return missing or sentence_of(error).replace("force=True", "--force"), FAILED


def _fail(text: str, code: int) -> int:
    sentence = printable(" ".join(text.split()))
    with suppress(OSError, ValueError, AttributeError):  # the terminal may be gone (SIGHUP)
        print(f"unocclude: {sentence}", file=sys.stderr)
    return code
