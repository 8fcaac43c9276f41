"""`unocclude view`: what is run, where it listens, and that a browser gets no way out."""

from __future__ import annotations

import http.client
import os
import signal
import socket
import subprocess
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
from commands import done
from results import made

from smoother.cli import viewer
from smoother.cli.run import run
from smoother.cli.viewer import LOOPBACK, WebPage, free_port, policy
from smoother.errors import UnoccludeError
from smoother.io import write_recovery

PAGE = (
    b'<html><link rel="preconnect" href="https://fonts.example" crossorigin />\n<link href="https://a.example/x"'
    b'\n rel="stylesheet"/><link rel="icon" href="favicon.ico"><script src="viewer.js"></script></html>'
)


@pytest.fixture
def result(tmp_path) -> Path:
    write_recovery(made("right"), tmp_path / "out.mcap")
    return tmp_path / "out.mcap"


@pytest.fixture
def needs_rerun():
    pytest.importorskip("rerun", reason="rerun-sdk, the extra `view`, is not installed")


def test_the_commands_bind_to_the_loopback_address(needs_rerun):
    for arguments in (viewer.window(Path("a.rrd")), viewer.web_server(Path("a.rrd"), 1234, 5678)):
        assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
        assert Path(arguments[0]).is_file()
        assert arguments[-1] == "a.rrd"


def test_the_viewer_speaks_to_nobody_else(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    monkeypatch.setenv("https_proxy", "http://proxy.example:3128")
    monkeypatch.delenv("CI", raising=False)
    variables = viewer.environment()
    assert variables["CI"] == "true"
    assert "FORCE_RERUN_ANALYTICS" not in variables
    ways_out = {value for name, value in variables.items() if name.lower() in ("https_proxy", "all_proxy")}
    assert ways_out == {"http://127.0.0.1:9"}
    assert variables["NO_PROXY"] == "127.0.0.1,localhost"
    assert variables["PATH"] == os.environ["PATH"]


def test_the_file_is_looked_at_before_the_package(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "rerun", None)  # as if it were not installed
    assert run(["view", str(tmp_path / "missing.mcap")]) == 1
    said = capsys.readouterr().err
    assert "missing.mcap does not exist" in said and "rerun-sdk" not in said


def test_a_file_is_shown_and_goes(needs_rerun, result, monkeypatch, capsys):
    shown = []

    def show(arguments):
        file = Path(arguments[-1])
        shown.append((file, file.stat().st_size))

    monkeypatch.setattr(viewer, "show", show)
    done("view", result)
    done("view", result, "--web", "--web-port", free_port(), "--port", free_port())
    assert "open http://127.0.0.1:" in capsys.readouterr().out
    assert len(shown) == 2
    for file, size in shown:
        assert file.name == "out.rrd"
        assert size > 10_000
        assert not file.exists()


def test_what_a_person_gets_wrong(needs_rerun, result, tmp_path, capsys):
    def sentence(*arguments: str) -> str:
        capsys.readouterr()
        assert run(["view", *arguments]) != 0
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    assert "no recovered arm 'left'" in sentence(str(result), "--side", "left")
    assert "--side is left or right" in sentence(str(result), "--side", "both")
    assert "missing.mcap" in sentence(str(tmp_path / "missing.mcap"))
    with socket.socket() as taken:
        taken.bind((LOOPBACK, 0))
        taken.listen()
        port = taken.getsockname()[1]
        said = sentence(str(result), "--web", "--web-port", str(port))
        assert f"port {port}" in said
        assert "--web-port" in said


def test_a_viewer_that_fails_says_why():
    with pytest.raises(UnoccludeError, match="no display here"):
        viewer.show([sys.executable, "-c", "print('no display here'); raise SystemExit(3)"])
    viewer.show([sys.executable, "-c", "print('all is well')"])


def test_the_page_lets_nothing_out():
    """Links elsewhere are gone, the policy names this machine alone, and other hosts' names are refused."""

    class Inner(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200 if self.path == "/" else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(PAGE)

        def log_message(self, *_):
            pass

    inner = ThreadingHTTPServer((LOOPBACK, 0), Inner)
    Thread(target=inner.serve_forever, daemon=True).start()
    port = free_port()
    with WebPage(port, inner.server_address[1], 4321):

        def get(path: str, host: str) -> tuple[int, dict[str, str], bytes]:
            connection = http.client.HTTPConnection(LOOPBACK, port, timeout=10)
            connection.request("GET", path, headers={"Host": host})
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()

        status, headers, body = get("/?url=x", f"127.0.0.1:{port}")
        assert status == 200
        assert b"https://" not in body
        assert b"favicon.ico" in body
        assert b"viewer.js" in body
        assert headers["Content-Security-Policy"] == policy(4321)
        assert get("/other", f"localhost:{port}")[0] == 404
        assert get("/", f"evil.example:{port}")[0] == 403
        inner.shutdown()
        inner.server_close()
        assert get("/", f"127.0.0.1:{port}")[0] == 503
    rules = dict(rule.split(" ", 1) for rule in policy(4321).split("; "))
    assert rules["connect-src"] == "'self' http://127.0.0.1:4321"
    assert rules["default-src"] == "'self'"
    assert "http" not in " ".join(value for name, value in rules.items() if name != "connect-src")


@pytest.mark.skipif(os.name != "posix", reason="looks at the sockets of Linux")
def test_the_real_viewer_serves_the_browser_and_ends(needs_rerun, result):
    """Rerun itself: page and data on 127.0.0.1 alone; ended, it leaves no process and no file behind."""
    page, data = free_port(), free_port()
    program = Path(sys.executable).parent / "unocclude"
    if not program.is_file() or not Path("/proc/net/tcp").is_file():
        pytest.skip("needs the installed command and Linux")
    command = [str(program), "view", str(result), "--web", "--web-port", str(page), "--port", str(data)]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert f"http://127.0.0.1:{page}/?url=" in running.stdout.readline()
        body = b""
        until = time.monotonic() + 20
        while not body and time.monotonic() < until:
            connection = http.client.HTTPConnection(LOOPBACK, page, timeout=10)
            try:
                connection.request("GET", "/")
                answer = connection.getresponse()
                body = answer.read() if answer.status == 200 else b""
            except OSError:
                pass
            time.sleep(0.1)
        assert b"re_viewer.js" in body
        assert b"fonts.googleapis.com" not in body
        listening = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        ports = {cells[1].split(":")[1]: cells[1].split(":")[0] for cells in listening if cells[3] == "0A"}
        for port in (page, data):
            assert ports[f"{port:04X}"] == "0100007F"  # 127.0.0.1
        six = Path("/proc/net/tcp6")
        assert not six.is_file() or f":{data:04X} " not in six.read_text()
    finally:
        running.send_signal(signal.SIGTERM)
        running.wait(timeout=20)
        running.stdout.close()
    viewer.check_ports(page, data)
