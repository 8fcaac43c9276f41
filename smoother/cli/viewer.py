"""Rerun's viewer as a process, and its web page, which communicate with this machine only."""

from __future__ import annotations

import http.client
import os
import re
import signal
import socket
import subprocess
import tempfile
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType

from ..errors import UnoccludeError

#: Nobody but this machine may read what is shown: these are patients.
LOOPBACK = "127.0.0.1"
_PATIENCE_S = 30
#: Links of a page to other machines: a browser may connect to them in advance, whatever the policy says.
_LINK_ELSEWHERE = re.compile(rb"<link\b[^>]*https?://[^>]*>")


def free_port() -> int:
    """A free port of the loopback address."""
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


#: The port `discard`, where nothing answers.
NOWHERE = f"http://{LOOPBACK}:9"


def data_address(port: int) -> str:
    """Where a web viewer finds the data, as its address bar takes it."""
    return f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def window(file: Path) -> list[str]:
    """Command line of the viewer in a window."""
    return [str(program()), "--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen", str(file)]


def web_server(file: Path, page_port: int, data_port: int) -> list[str]:
    """Command line of the viewer that serves a browser: its page and the data."""
    ports = ["--port", str(data_port), "--serve-web", "--web-viewer-port", str(page_port)]
    return [str(program()), "--bind", LOOPBACK, *ports, str(file)]


def program() -> Path:
    """Rerun's viewer itself: its wrapper in Python hides how it ended, and lives on when it is stopped.

    Raises
    ------
    UnoccludeError
        rerun-sdk does not bring one for this machine.
    """
    spec = find_spec("rerun_cli")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    for file in (folder / name for folder in folders for name in names):
        if file.is_file():
            return file
    raise UnoccludeError(
        "rerun-sdk is installed without its viewer; `unocclude export --format rrd` writes a file that"
        " any Rerun viewer opens"
    )


def check_ports(*ports: int) -> None:
    """Refuse ports that another program has.

    Raises
    ------
    UnoccludeError
        The first that is taken, and how to take another.
    """
    for port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError as error:
                raise UnoccludeError(
                    f"port {port} of {LOOPBACK} cannot be used ({error.strerror}); give others with"
                    " --port and --web-port"
                ) from error


def environment() -> dict[str, str]:
    """The viewer's environment, in which it communicates with this machine only.

    Rerun reports its use to tel.rerun.io unless `CI` is set, and asks GitHub for newer versions whatever is
    set: its way out leads to a proxy that is not there.
    """
    proxies = ("http_proxy", "https_proxy", "all_proxy", "no_proxy")
    dropped = {"force_rerun_analytics", *proxies}
    variables = {name: value for name, value in os.environ.items() if name.lower() not in dropped}
    for name in proxies:
        value = f"{LOOPBACK},localhost" if name == "no_proxy" else NOWHERE
        variables |= {name: value, name.upper(): value}
    return variables | {"CI": "true"}


def show(arguments: list[str]) -> None:
    """Run the viewer until it is closed.

    Raises
    ------
    UnoccludeError
        It ended with an error; its last words are in the sentence.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as words:
        viewer = subprocess.Popen(arguments, env=environment(), stdout=words, stderr=subprocess.STDOUT)
        # Ending this command ends the viewer, and the file with the patient's motion is deleted.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            code = viewer.wait()
        except KeyboardInterrupt:
            return
        finally:
            signal.signal(signal.SIGTERM, before)
            viewer.terminate()
            viewer.wait()
        words.seek(0)
        lines = [line.strip() for line in words if line.strip()]
    if code:
        last = lines[-1][:300] if lines else "it said nothing"
        raise UnoccludeError(
            f"Rerun's viewer ended with an error ({last}); `unocclude view --web` shows the result in a"
            " browser"
        )
