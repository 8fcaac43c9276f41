"""One server a folder: its address, its token, and how it is started and ended."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..errors import UnoccludeError
from .folder import AppFolder

#: The only address where it is served.
ADDRESS = "127.0.0.1"
#: Connections at a time: a browser opens 6, and a process may have 256 files open (macOS). Those that ask
#: nothing are closed after this time, s.
MOST_CONNECTIONS, IDLE_S = 64, 5


def serve(folder: AppFolder, port: int | None, ready: Callable[[str], None]) -> None:
    """Serve a folder until the process is stopped."""
    import uvicorn
    from filelock import FileLock, Timeout

    from .jobs import JobDesk
    from .server import make_app

    token = secrets.token_urlsafe(24)  # of this start alone

    class Announcing(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            ready(f"http://{ADDRESS}:{number}/?token={token}")

    try:
        with FileLock(folder.hidden / "server.lock", timeout=0), _listening(port or 0) as listener:
            number = int(listener.getsockname()[1])
            config = uvicorn.Config(
                make_app(folder, JobDesk(folder), token, number),
                http="h11",
                limit_concurrency=MOST_CONNECTIONS,
                timeout_keep_alive=IDLE_S,
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=3,
                ws="none",
            )
            try:
                with suppress(KeyboardInterrupt):  # Ctrl-C is how it ends
                    Announcing(config).run(sockets=[listener])
            finally:
                with suppress(OSError):
                    (folder.hidden / "open.html").unlink()
    except Timeout:
        raise UnoccludeError(
            f"{folder.path} is open in another `unocclude app`; use its page, or end it first"
        ) from None


def _listening(port: int) -> socket.socket:
    """A socket that listens on this computer's own address alone."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    if os.name == "posix":  # elsewhere it would let two programs share the port
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((ADDRESS, port))
        listener.listen(MOST_CONNECTIONS)
    except (OSError, OverflowError):
        listener.close()
        raise UnoccludeError(f"port {port} is in use; give another --port, or none") from None
    return listener


def redirect_file(folder: AppFolder, address: str) -> Path:
    """A file for its owner alone that opens an address: other users can read a browser's command line."""
    path = folder.hidden / "open.html"
    with suppress(OSError):
        path.unlink()
    text = f'<!doctype html><meta http-equiv="refresh" content="0;url={address}"><title>unocclude</title>'
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(text)
    return path
