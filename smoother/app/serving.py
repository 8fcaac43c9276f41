"""One server a folder: its address, its token, and how it is started and ended."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import secrets
import socket
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from .folder import AppFolder

#: The only address where it is served.
ADDRESS = "127.0.0.1"
#: A request's head comes within this, s; a browser sends it at once.
HEAD_S = 10.0
#: Connections at a time: a browser opens 6, and a process may have 256 files open (macOS).
MOST_CONNECTIONS = 64
#: No link is followed, and no pipe waited for.
_NO_TRAP = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def serve(folder: AppFolder, port: int | None, ready: Callable[[str], None]) -> None:
    """Serve a folder until the process is stopped."""
    from filelock import FileLock, Timeout

    about = folder.hidden / "server.json"
    try:
        with FileLock(folder.hidden / "server.lock", timeout=0):
            token = secrets.token_urlsafe(24)  # of this start alone
            with _listening(port, _kept(about).get("port")) as listener:
                number = int(listener.getsockname()[1])
                _keep(about, json.dumps({"token": token, "port": number}))
                try:
                    _run(folder, listener, token, number, ready)
                finally:
                    with suppress(OSError):
                        (folder.hidden / "open.html").unlink()
    except Timeout:
        last = _kept(about)
        if not isinstance(last.get("token"), str) or not isinstance(last.get("port"), int):
            raise UnoccludeError(f"{folder.path} is being opened by another `unocclude app`") from None
        ready(address_of(last["token"], last["port"]))


def address_of(token: str, port: int) -> str:
    """The address of the first page."""
    return f"http://{ADDRESS}:{port}/?token={token}"


def redirect_file(folder: AppFolder, address: str) -> Path:
    """A file for its owner alone that opens an address: other users can read a browser's command line."""
    path = folder.hidden / "open.html"
    _keep(
        path, f'<!doctype html><meta http-equiv="refresh" content="0;url={address}"><title>unocclude</title>'
    )
    return path


def _kept(path: Path) -> dict[str, Any]:
    """The file `_keep` wrote; {} where another user could have written or read it."""
    try:
        with open(os.open(path, os.O_RDONLY | _NO_TRAP), encoding="utf-8") as file:
            about = os.fstat(file.fileno())
            mine = os.name != "posix" or (about.st_uid == os.getuid() and not about.st_mode & 0o077)
            values = json.load(file) if mine and stat.S_ISREG(about.st_mode) else None
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def _listening(port: int | None, last: object) -> socket.socket:
    """A socket that listens on this computer's own address alone."""
    wanted = [port] if port is not None else [last, 0] if type(last) is int else [0]
    for number in wanted:
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":  # elsewhere it would let two programs share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((ADDRESS, int(number)))
            listener.listen(100)
        except (OSError, OverflowError):
            listener.close()
            continue
        return listener
    raise UnoccludeError(f"port {port} is in use; give another --port, or none")


def _keep(path: Path, text: str) -> None:
    """Write a file for its owner alone."""
    beside = path.with_name(f"{path.name}.new")
    with suppress(OSError):
        beside.unlink()
    handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(beside, path)


def _run(
    folder: AppFolder, listener: socket.socket, token: str, port: int, ready: Callable[[str], None]
) -> None:
    import uvicorn
    from uvicorn.protocols.http.h11_impl import H11Protocol

    from .jobs import JobDesk
    from .server import make_app

    class Announcing(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            asyncio.get_running_loop().set_exception_handler(_quietly())
            await super().startup(sockets)
            ready(address_of(token, port))

    class Bounded(H11Protocol):
        """A connection that waits for no request longer than HEAD_S; of too many, the last are closed."""

        waits: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self._look()
            if len(self.connections) > MOST_CONNECTIONS:
                transport.abort()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            self._look()

        def _look(self) -> None:
            if self.cycle is not None and not self.cycle.response_complete:
                if self.waits is not None:
                    self.waits.cancel()
                self.waits = None
            elif self.waits is None:
                self.waits = self.loop.call_later(HEAD_S, self._end)

        def _end(self) -> None:
            self.waits = None
            if not self.transport.is_closing() and (self.cycle is None or self.cycle.response_complete):
                self.transport.abort()

    app = make_app(folder, JobDesk(folder), token, port)
    config = uvicorn.Config(
        app,
        http=Bounded,
        backlog=MOST_CONNECTIONS,
        log_config=None,
        log_level="critical",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=3,
        ws="none",
    )
    with suppress(KeyboardInterrupt):  # Ctrl-C is how it ends
        Announcing(config).run(sockets=[listener])


def _quietly() -> Callable[[asyncio.AbstractEventLoop, dict[str, Any]], None]:
    """A loop's handler of errors that says once that no more files can be opened."""
    said: list[bool] = []

    def handle(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if not isinstance(error, OSError) or error.errno not in (errno.EMFILE, errno.ENFILE):
            loop.default_exception_handler(context)
        elif not said:
            said.append(True)
            print("unocclude: too many open files; connections wait until some are closed", file=sys.stderr)

    return handle
