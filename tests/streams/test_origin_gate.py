"""Which pages may connect to the session, and that the gate passes bytes on."""

from __future__ import annotations

import socket
import threading

import pytest

from smoother.streams.origin_gate import OriginGate, is_allowed

WAIT_S = 10.0


def head(*lines: str) -> bytes:
    return "\r\n".join(["GET / HTTP/1.1", *lines]).encode()


@pytest.mark.parametrize(
    "lines, allowed",
    [
        (("Host: 127.0.0.1:8765",), True),  # a program
        (("Host: localhost:8765", "Origin: https://app.foxglove.dev"), True),
        (("Host: localhost:8765", "Origin: file://"), True),
        (("host: 127.0.0.1", "oRIGIN: http://localhost:3000"), True),
        (("Host: 127.0.0.1:8765", "Origin: https://evil.example"), False),
        (("Host: 127.0.0.1:8765", "Origin: https://app.foxglove.dev.evil.example"), False),
        (("Host: 127.0.0.1:8765", "Origin: null"), False),
        (("Host: 127.0.0.1", "Origin: https://app.foxglove.dev", "Origin: https://evil.example"), False),
        (("Host: evil.example:8765",), False),  # a name that points at this computer
        ((), False),
    ],
)
def test_who_may_connect(lines, allowed):
    assert is_allowed(head(*lines)) is allowed


@pytest.fixture
def echo():
    """A server that answers with what it got."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(WAIT_S)

    def serve():
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        with connection:
            connection.settimeout(WAIT_S)
            while chunk := connection.recv(4096):
                connection.sendall(chunk)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield listener.getsockname()
    listener.close()
    thread.join(WAIT_S)


@pytest.fixture
def connection(echo):
    """A connection through the gate."""
    gate = OriginGate(0, echo)
    with socket.create_connection(("127.0.0.1", gate.port), WAIT_S) as connection:
        yield connection
    gate.close()


def test_bytes_pass_both_ways_for_who_may(connection):
    request = head("Host: 127.0.0.1", "Origin: https://app.foxglove.dev") + b"\r\n\r\n"
    connection.sendall(request)
    got = b""
    while len(got) < len(request) + 4:
        got += connection.recv(4096)
        if got == request:
            connection.sendall(b"more")
    assert got == request + b"more"


@pytest.mark.slow
def test_a_foreign_page_is_refused(connection):
    connection.sendall(head("Host: 127.0.0.1", "Origin: https://evil.example") + b"\r\n\r\n")
    assert connection.recv(4096).startswith(b"HTTP/1.1 403 Forbidden")
