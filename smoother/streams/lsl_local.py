"""The arm as LSL streams that are announced on this computer alone.

The library announces all streams of a program alike, and inlets have to see the network: so the outlets are
in a program of their own, whose settings keep it to this computer. A pipe feeds it, and ends it.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from configparser import ConfigParser, Error
from contextlib import suppress
from pathlib import Path
from queue import Empty, Full, Queue
from typing import BinaryIO

from ..errors import UnoccludeError
from ..live.answers import LiveOutput
from ..measurements.visibility import Gap
from .arrivals import FrameRows, SourceInfo
from .lsl import LslOutlet, user_settings

#: The program may take this long to begin, and to end, s.
_BEGINS_S, _ENDS_S = 60.0, 3.0
#: This many answers wait for it at most; one that comes too late for that is not sent.
_MOST_WAITING = 60
_READY = b"ready\n"
#: The library's settings that keep its announcements to this computer.
_LOCAL = {
    "multicast": {"ResolveScope": "machine", "ListenAddress": "127.0.0.1"},
    "ports": {"IPv6": "disable"},
}


class LocalLslOutlet:
    """Sends `now` and `settled` as `LslOutlet` does, from a program that only this computer can find."""

    def __init__(self, name: str, info: SourceInfo):
        self._waiting: Queue[LiveOutput | None] = Queue(_MOST_WAITING)
        self._folder = tempfile.TemporaryDirectory(prefix="unocclude-lsl-", ignore_cleanup_errors=True)
        settings = Path(self._folder.name) / "lsl_api.cfg"
        settings.write_text(local_settings(user_settings()), "utf-8")
        environment = {**os.environ, "LSLAPICFG": str(settings)}
        # the package of this program, wherever it was started from
        root = str(Path(__file__).parents[2])
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self._program = subprocess.Popen(
            [sys.executable, "-m", __name__],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the session, which ends this program
        )
        self._thread = threading.Thread(target=self._work, name="lsl-out", daemon=True)
        try:
            pickle.dump((name, info), self._pipe)
            self._pipe.flush()
            if self._first_line() != _READY:
                raise OSError("it does not begin")
        except OSError as error:
            self.close()
            raise UnoccludeError(f"the program that sends --lsl-out cannot be started: {error}") from error
        self._thread.start()

    def send(self, output: LiveOutput, frames: FrameRows, gap: Gap | None, events: Sequence[str]) -> None:
        """Hand over what a step answered; never waits."""
        with suppress(Full):
            self._waiting.put_nowait(output)

    def close(self) -> None:
        """End the program, and let all receivers go."""
        try:
            if self._thread.is_alive():
                with suppress(Full):
                    self._waiting.put_nowait(None)
                self._thread.join(_ENDS_S)
            if self._thread.is_alive():  # it writes to a program that takes nothing
                self._program.kill()
            with suppress(OSError, ValueError):
                self._pipe.close()
            with suppress(subprocess.TimeoutExpired):
                self._program.wait(_ENDS_S)
        finally:
            self._program.kill()
            self._program.wait(_ENDS_S)
            self._folder.cleanup()

    def _first_line(self) -> bytes:
        """What the program says first; nothing where it takes too long."""
        assert self._program.stdout is not None
        ender = threading.Timer(_BEGINS_S, self._program.kill)
        ender.start()
        try:
            return self._program.stdout.readline()
        finally:
            ender.cancel()

    @property
    def _pipe(self) -> BinaryIO:
        assert self._program.stdin is not None
        return self._program.stdin  # type: ignore[return-value]

    def _work(self) -> None:
        """Write what waits; after an end of the program nothing is sent any more."""
        with suppress(OSError, ValueError):
            while (output := self._waiting.get()) is not None:
                pickle.dump(output, self._pipe, pickle.HIGHEST_PROTOCOL)
                self._pipe.flush()
        with suppress(Empty):  # no sender may wait for a place
            while True:
                self._waiting.get_nowait()


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
    sections = []
    for section in parser.sections():
        rows = [f"{key} = {value}" for key, value in parser.items(section)]
        sections.append("\n".join([f"[{section}]", *rows]))
    return "\n".join(sections) + "\n"


def main() -> None:
    """The program: an outlet that sends what comes through stdin."""
    stream = sys.stdin.buffer
    name, info = pickle.load(stream)
    outlet = LslOutlet(name, info)
    sys.stdout.buffer.write(_READY)
    sys.stdout.buffer.flush()
    try:
        with suppress(EOFError):
            while True:
                outlet.send(pickle.load(stream), FrameRows(), None, ())
    finally:
        outlet.close()


if __name__ == "__main__":
    main()
