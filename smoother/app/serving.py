"""One server a folder: its address, its token, and how it is started and ended."""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from ..errors import UnoccludeError
from .folder import AppFolder, read_json

#: The only address where it is served.
ADDRESS = "127.0.0.1"


def serve(folder: AppFolder, port: int | None, ready: Callable[[str], None]) -> None:
    """Serve a folder until the process is stopped.

    Where another server has the folder already, its address is given instead, and this one ends.

    Parameters
    ----------
    folder : AppFolder
    port : int, optional
        None takes the one of the last time where it is free, so that a page that was left open goes on.
    ready : callable
        Gets the address, with the token, as soon as it answers.

    Raises
    ------
    UnoccludeError
        The port is in use.
    """
    from filelock import FileLock, Timeout

    about = folder.hidden / "server.json"
    try:
        with FileLock(folder.hidden / "server.lock", timeout=0):
            last = read_json(about)
            token = str(last.get("token", "")) or secrets.token_urlsafe(24)
            with _listening(port, last.get("port")) as listener:
                number = int(listener.getsockname()[1])
                _keep(about, token, number)
                _run(folder, listener, token, number, ready)
    except Timeout:
        last = read_json(about)
        if not last.get("token"):
            raise UnoccludeError(f"{folder.path} is being opened by another `unocclude app`") from None
        ready(address_of(str(last["token"]), int(last["port"])))


def address_of(token: str, port: int) -> str:
    """The address of the first page."""
    return f"http://{ADDRESS}:{port}/?token={token}"


def _listening(port: int | None, last: object) -> socket.socket:
    """A socket that listens on this computer's own address alone."""
    wanted = [port] if port is not None else [last, 0] if isinstance(last, int) else [0]
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


def _keep(path: Path, token: str, port: int) -> None:
    """Write address and token for its owner alone."""
    import json

    beside = path.with_name(f"{path.name}.new")
    with suppress(OSError):
        beside.unlink()
    handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        json.dump({"token": token, "port": port}, file)
    os.replace(beside, path)


def _run(
    folder: AppFolder, listener: socket.socket, token: str, port: int, ready: Callable[[str], None]
) -> None:
    import uvicorn

    from .jobs import JobDesk
    from .server import make_app

    class Announcing(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            ready(address_of(token, port))

    app = make_app(folder, JobDesk(folder), token, port)
    config = uvicorn.Config(
        app,
        log_config=None,
        log_level="critical",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=3,
        ws="none",
    )
    with suppress(KeyboardInterrupt):  # Ctrl-C is how it ends
        Announcing(config).run(sockets=[listener])
