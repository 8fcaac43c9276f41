"""Rerun's web viewer behind a page of our own that keeps the browser from talking to anybody else."""

from __future__ import annotations

import http.client
import re
import socket
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType

#: Nobody but this machine may read what is shown: these are patients.
LOOPBACK = "127.0.0.1"
_PATIENCE_S = 30
#: Links of a page to other machines: a browser may connect to them in advance, whatever the policy says.
_LINK_ELSEWHERE = re.compile(rb"<link\b[^>]*https?://[^>]*>")


def free_port() -> int:
    """A port of the loopback address that nobody has."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def policy(data_port: int) -> str:
    """What the browser may load and reach: this page and the data's port, nothing else.

    Rerun's viewer in the browser reports its use to tel.rerun.io and asks Google for a font, and has no
    switch for either; the browser refuses both under this Content-Security-Policy (W3C, CSP level 3).
    """
    own, inline = "'self'", "'unsafe-inline'"
    rules = {
        "default-src": own,
        "script-src": f"{own} {inline} 'unsafe-eval' 'wasm-unsafe-eval'",
        "style-src": f"{own} {inline}",
        "img-src": f"{own} data: blob:",
        "font-src": f"{own} data:",
        "worker-src": f"{own} blob:",
        "connect-src": f"{own} http://{LOOPBACK}:{data_port}",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    return "; ".join(f"{name} {sources}" for name, sources in rules.items())


class WebPage:
    """Serves Rerun's own page on the loopback address, with the policy; `with` waits in a thread of its own.

    Parameters
    ----------
    port : int
        Of the page.
    inner_port : int
        Where Rerun serves its own.
    data_port : int
        Where Rerun serves the data.
    """

    def __init__(self, port: int, inner_port: int, data_port: int):
        hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                # A page of somebody else's whose name leads here (DNS rebinding) names itself as the host.
                if self.headers.get("Host") not in hosts:
                    self.send_error(403)
                    return
                inner = http.client.HTTPConnection(LOOPBACK, inner_port, timeout=_PATIENCE_S)
                try:
                    inner.request("GET", self.path.partition("?")[0])
                    answer = inner.getresponse()
                    body = answer.read()
                except OSError:
                    self.send_error(503, "The viewer is not ready yet; load the page again")
                    return
                finally:
                    inner.close()
                kind = answer.getheader("Content-Type") or "application/octet-stream"
                body = _LINK_ELSEWHERE.sub(b"", body) if kind.startswith("text/html") else body
                self.send_response(answer.status)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Content-Security-Policy", policy(data_port))
                self.send_header("Referrer-Policy", "no-referrer")
                with suppress(ConnectionError):  # the browser went away meanwhile
                    self.end_headers()
                    self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Nothing: who looked at what stays on no record."""

        self._server = ThreadingHTTPServer((LOOPBACK, port), Handler)

    def __enter__(self) -> WebPage:
        from threading import Thread

        self._thread = Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
