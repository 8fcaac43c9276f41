"""A function in a process of its own: nothing loaded before, nothing kept after, stopped at a limit."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any
from unittest import mock

from .memory import PrivatePeak

#: How often a limit is looked at, s.
LOOK_S = 0.2


class Stopped(Exception):
    """The function was stopped at a limit; the text says which.

    Attributes
    ----------
    seconds, peak_mb : float, s and MB
        What it had taken until then.
    """

    def __init__(self, text: str, seconds: float, peak_mb: float) -> None:
        super().__init__(text)
        self.seconds, self.peak_mb = seconds, peak_mb


def isolated(
    function: Callable[..., Any],
    *arguments: object,
    limit_s: float = float("inf"),
    limit_gb: float = float("inf"),
    environment: dict[str, str] | None = None,
) -> Any:
    """What the function returns, run in a new process.

    Raises
    ------
    Stopped
        It took longer, or more memory, than allowed.
    RuntimeError
        It failed.
    """
    context = multiprocessing.get_context("spawn")
    mine, its = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(its, function, arguments))
    with mock.patch.dict(os.environ, environment or {}):
        process.start()
    its.close()
    assert process.pid is not None
    try:
        mine.recv()  # it has loaded what it needs: the limit counts from here
        began, peak = time.monotonic(), PrivatePeak(process.pid)
        while not mine.poll(LOOK_S):
            taken_s, peak_mb = time.monotonic() - began, peak.mb()
            if taken_s > limit_s:
                raise Stopped(f"stopped after {limit_s:g} s", taken_s, peak_mb)
            if peak_mb > 1000.0 * limit_gb:
                raise Stopped(f"stopped at {limit_gb:g} GB", taken_s, peak_mb)
        good, answer = mine.recv()
    except EOFError:
        process.join()
        good, answer = False, f"its process ended with code {process.exitcode}"
    except BaseException:
        process.kill()
        raise
    finally:
        process.join()
        mine.close()
    if not good:
        raise RuntimeError(f"{function.__name__}: {answer}")
    return answer


def _run(pipe: Connection, function: Callable[..., Any], arguments: tuple[object, ...]) -> None:
    pipe.send("began")
    try:
        answer = (True, function(*arguments))
    except Exception as error:
        answer = (False, f"{type(error).__name__}: {error}")
    pipe.send(answer)
    pipe.close()
