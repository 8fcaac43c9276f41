"""The arm as LSL streams that are announced on this computer alone.

The library announces all streams of a program alike, and inlets have to see the network: so the outlets are
in a process of their own, whose settings keep it to this computer, and which ends with this one.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from configparser import ConfigParser, Error
from contextlib import suppress
from io import StringIO
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from pathlib import Path
from queue import Full

from ..errors import UnoccludeError
from ..live.answers import LiveOutput
from ..measurements.visibility import Gap
from ..runtime.pool import prepare_worker, starting_processes
from .arrivals import FrameRows, SourceInfo
from .lsl import LslOutlet, lsl_module, user_settings

#: The process may take this long to begin, and to end, s.
_BEGINS_S, _ENDS_S = 60.0, 3.0
#: This many answers wait for it at most; one that comes too late for that is not sent.
_MOST_WAITING = 60
#: The library's settings that keep its announcements to this computer.
_LOCAL = {
    "multicast": {"ResolveScope": "machine", "ListenAddress": "127.0.0.1"},
    "ports": {"IPv6": "disable"},
}


class LocalLslOutlet:
    """Sends `now` and `settled` as `LslOutlet` does, from a process that only this computer can find."""

    def __init__(self, name: str, info: SourceInfo):
        context = multiprocessing.get_context("spawn")
        self._waiting: Queue[LiveOutput | None] = context.Queue(_MOST_WAITING)
        ready = context.Event()
        arguments = (name, info, self._waiting, ready)
        self._process = context.Process(target=_send, args=arguments, name="lsl-out", daemon=True)
        with starting_processes():
            self._process.start()
        for _ in range(round(10 * _BEGINS_S)):
            if ready.wait(0.1) or not self._process.is_alive():
                break
        if not ready.is_set():
            self.close()
            raise UnoccludeError(
                "the process that sends --lsl-out cannot be started; --lsl-network sends without one"
            )

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Hand over what a step answered; never waits."""
        with suppress(Full):
            self._waiting.put_nowait(output)

    def close(self) -> None:
        """End the process, and let all receivers go."""
        with suppress(Full):
            self._waiting.put_nowait(None)
        self._process.join(_ENDS_S)
        self._process.kill()
        self._process.join(_ENDS_S)
        self._waiting.cancel_join_thread()  # what was not sent is not waited for
        self._waiting.close()


def _send(name: str, info: SourceInfo, waiting: Queue[LiveOutput | None], ready: Event) -> None:
    """The process: an outlet that sends what comes."""
    prepare_worker()
    lsl_module().set_config_content(local_settings(user_settings()))
    outlet = LslOutlet(name, info)
    ready.set()
    while (output := waiting.get()) is not None:
        outlet.send(output, FrameRows(), None, ())
    outlet.close()


def local_settings(file: Path | None) -> str:
    """Settings of the library that keep to this computer; all else as a user's file says."""
    parser = ConfigParser(interpolation=None, strict=False, inline_comment_prefixes=(";",))
    parser.optionxform = str  # type: ignore[assignment,method-assign]  # names of settings have capitals
    with suppress(OSError, Error, UnicodeDecodeError):
        if file is not None:
            parser.read_string(file.read_text("utf-8"))
    if not parser.has_option("log", "level"):
        parser.read_dict({"log": {"level": "-3"}})
    parser.read_dict(_LOCAL)
    text = StringIO()
    parser.write(text)
    return text.getvalue()
