"""The program that serves the local page: one a folder, on this computer's own address, in one line."""

from __future__ import annotations

import os
import subprocess
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

from local_program import Program, environment, program_words

PATIENCE_S = 90


def asked(address: str, path: str) -> tuple[int, str]:
    connection = HTTPConnection(urlsplit(address).netloc, timeout=30)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.getheader("set-cookie") or ""
    finally:
        connection.close()


def test_one_server_a_folder(tmp_path: Path):
    folder = tmp_path / "recordings"
    program = Program(folder)
    try:
        url = urlsplit(program.address)
        assert asked(program.address, "/")[0] == 403
        code, cookie = asked(program.address, f"/?{url.query}")
        assert code == 200 and "HttpOnly" in cookie
        again = subprocess.run(
            program_words(folder), capture_output=True, text=True, env=environment(), timeout=PATIENCE_S
        )
        assert again.returncode == 0 and again.stdout == f"{program.address}\n", "the page of the first"
        words = program_words(tmp_path / "other", "--port", str(url.port))
        taken = subprocess.run(words, capture_output=True, text=True, env=environment(), timeout=PATIENCE_S)
        assert taken.returncode != 0 and f"port {url.port} is in use; give another --port" in taken.stderr
        if os.name == "posix":
            hidden = folder / ".unocclude"
            assert [(hidden / name).stat().st_mode & 0o077 for name in (".", "server.json")] == [0, 0]
        tables = [path for path in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")) if path.is_file()]
        rows = [line.split() for path in tables for line in path.read_text().splitlines()[1:]]
        listening = [row[1].split(":") for row in rows if row[3] == "0A"]
        own = [place for place, port in listening if int(port, 16) == url.port]
        assert own == ["0100007F"] * len(own) and (own or not rows), "127.0.0.1, and no other address"
    finally:
        code = program.close()
    assert code == 0 and program.rest() == "", "one line, whatever was asked"
