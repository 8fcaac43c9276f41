"""A door before a WebSocket server of this computer: pages of other web sites do not get in.

Any page that a browser shows may connect to a WebSocket on this computer; the browser sends the page's origin
(Origin, RFC 6455, 10.2). A client that sends no Origin is a program of this computer.
"""

from __future__ import annotations

import selectors
import socket
import threading
from contextlib import suppress

from ..runtime.local_requests import LOOPBACK, OWN_NAMES, LocalDoor, joined

#: Whose pages may connect: Foxglove's own and those of this computer, and its desktop application.
DOOR = LocalDoor(guests=("app.foxglove.dev", "foxglove.dev", *OWN_NAMES), schemes=("file", "foxglove", "app"))
#: The head of a request is awaited this long, s, and is no longer than this, bytes.
_HEAD_S, _HEAD_BYTES = 5.0, 16384
#: A side that takes nothing for this long is let go, s; and how often it is looked whether all ends.
_PATIENCE_S, _LOOKED_S = 10.0, 0.5
_REFUSAL = (
    b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\n"
    b"unocclude live lets Foxglove and programs of this computer in, no other page.\n"
)


def is_allowed(head: bytes) -> bool:
    """Whether the head of a request is of no foreign page."""
    lines = (line.partition(":") for line in head.decode("latin-1").split("\r\n")[1:])
    return DOOR.refusal(joined((key, value) for key, _, value in lines), changes=False) is None


class OriginGate:
    """Listens on this computer, and passes on to a server behind it what is not of a foreign page."""

    def __init__(self, port: int, behind: tuple[str, int]):
        self._behind = behind
        self._listener = socket.create_server((LOOPBACK, port))
        self._listener.settimeout(_LOOKED_S)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="origin-gate", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._listener.getsockname()[1])

    def close(self) -> None:
        """Let all connections go."""
        self._closing.set()
        self._thread.join(4 * _LOOKED_S)
        self._listener.close()

    def _listen(self) -> None:
        while not self._closing.is_set():
            with suppress(OSError):
                connection, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, suppress(OSError):
            connection.settimeout(_HEAD_S)
            head = b""
            while b"\r\n\r\n" not in head and len(head) < _HEAD_BYTES:
                chunk = connection.recv(4096)
                if not chunk:
                    return
                head += chunk
            if b"\r\n\r\n" not in head or not is_allowed(head[: head.index(b"\r\n\r\n")]):
                connection.sendall(_REFUSAL)
                return
            with socket.create_connection(self._behind, _HEAD_S) as server:
                server.sendall(head)
                self._pass_on(connection, server)

    def _pass_on(self, one: socket.socket, other: socket.socket) -> None:
        """Bytes both ways until a side closes."""
        for side in (one, other):
            side.settimeout(_PATIENCE_S)
            side.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with selectors.DefaultSelector() as selector:
            selector.register(one, selectors.EVENT_READ, other)
            selector.register(other, selectors.EVENT_READ, one)
            while not self._closing.is_set():
                for key, _ in selector.select(_LOOKED_S):
                    chunk = key.fileobj.recv(1 << 16)  # type: ignore[union-attr]
                    if not chunk:
                        return
                    key.data.sendall(chunk)
