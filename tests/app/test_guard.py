"""The program that serves the local page, who is let in, and what names of files may be."""

from __future__ import annotations

import json
import os
import subprocess
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from local_page import HOST, PORT, TOKEN, Page
from local_program import Program, environment, program_words
from starlette.testclient import TestClient

from smoother.app.folder import AppError, AppFolder, JobDesk, file_name
from smoother.app.server import make_app


@pytest.fixture
def stranger(tmp_path: Path) -> TestClient:
    """Somebody without the token."""
    folder = AppFolder(tmp_path / "recordings")
    return TestClient(make_app(folder, JobDesk(folder), TOKEN, PORT), base_url=HOST)


@pytest.mark.parametrize("path", ["/", "/app.js", "/texts.js", "/api/state", "/results/a/report.html"])
def test_without_the_token_nothing_is_shown(stranger: TestClient, path: str):
    for query in ("", "?token=", "?token=secret-tokem", f"?token={TOKEN}"[:-1]):
        answer = stranger.get(path + query)
        assert answer.status_code == 403 and "unocclude app" in answer.text


@pytest.mark.parametrize("path", ["/api/state", "/app.js"])
def test_the_token_opens_the_first_page_alone(stranger: TestClient, path: str):
    assert stranger.get(f"{path}?token={TOKEN}").status_code == 403


def test_the_first_visit_leaves_a_cookie(stranger: TestClient):
    answer = stranger.get(f"/?token={TOKEN}")
    assert answer.status_code == 200
    cookie = answer.headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie and str(PORT) in cookie
    assert stranger.get("/api/state").status_code == 200
    stranger.cookies.clear()
    stranger.cookies.set(f"unocclude-{PORT}", "wrong")
    assert stranger.get("/api/state").status_code == 403


@pytest.mark.parametrize(
    "host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1", f"127.0.0.1.evil.example:{PORT}", ""]
)
def test_another_name_of_this_computer_is_refused(page: Page, host: str):
    """A page of another site whose name leads here (DNS rebinding) sends that name."""
    assert page.client.get("/api/state", headers={"host": host}).status_code == 403


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "http://127.0.0.1:9999", "https://x"]
)
@pytest.mark.parametrize(("method", "path"), [("POST", "/api/recordings"), ("DELETE", "/api/recordings/x")])
def test_another_site_changes_nothing(page: Page, method: str, path: str, origin: str | None):
    headers = {} if origin is None else {"origin": origin}
    answer = page.client.request(method, path, json={"name": "x"}, headers=headers)
    assert answer.status_code == 403
    assert page.ask("GET", "/api/state")["recordings"] == []


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_another_site_reads_nothing(page: Page, site: str):
    """Other ports of this computer are the same site, and another user's."""
    assert page.client.get("/api/state", headers={"sec-fetch-site": site}).status_code == 403
    assert page.client.get("/api/state", headers={"sec-fetch-site": "same-origin"}).status_code == 200


def test_what_every_answer_forbids(page: Page):
    for path in ("/", "/api/state", "/nothing-there", "/api/nothing"):
        headers = page.client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy and "script-src 'self'" in policy
        assert headers["x-content-type-options"] == "nosniff" and headers["cache-control"] == "no-store"
        assert headers["cross-origin-resource-policy"] == "same-origin"
    assert page.client.get("/../pyproject.toml").status_code == 404


def test_a_report_runs_in_a_sandbox(page: Page):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    (page.folder.of(name) / "report.html").write_text("<script>1</script>")
    policy = page.client.get(f"/results/{name}/report.html").headers["content-security-policy"]
    assert "sandbox allow-scripts" in policy and "allow-same-origin" not in policy
    assert "connect-src" not in policy and "default-src 'none'" in policy


HOSTILE = [
    *("..", ".", "../../evil.csv", "a/b.csv", "a\\b.csv", "/etc/passwd", "C:\\x.csv", ".hidden", "-rf"),
    *("con.csv", "nul", "a\nb.csv", "a\0b", "\u202egnp.csv", "x" * 300, " ", "a:b", "what?", "trailing. "),
]


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_are_refused(name: str):
    with pytest.raises(AppError, match="plain name"):
        file_name(name)


@pytest.mark.parametrize(
    ("name", "kept"),
    [("Bewegung März.csv", "Bewegung März.csv"), ("a=b,c#1.csv", "a_b_c_1.csv"), ("dot.csv", "dot.csv")],
)
def test_names_that_are_kept(name: str, kept: str):
    assert file_name(name) == kept


@pytest.mark.parametrize("name", ["..%2f..%2fevil.csv", "%2e%2e", "a%2fb.csv", "..%5cevil.csv", "%00.csv"])
def test_no_path_leads_out_of_the_folder(page: Page, tmp_path: Path, name: str):
    made = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    before = sorted(tmp_path.rglob("*"))
    answer = page.client.put(f"/api/recordings/{made}/files/{name}", content=b"x", headers=page.headers)
    assert answer.status_code in (400, 404, 405) and sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["..", "%2e%2e", "..%2f.unocclude", ".unocclude", "x" * 99])
def test_no_recording_leads_out_of_the_folder(page: Page, name: str):
    for path in (f"/api/recordings/{name}", f"/results/{name}/app.json", f"/results/{name}/exports/x"):
        assert page.client.get(path).status_code == 404


def test_only_results_are_given_out(page: Page):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    for path in ("app.json", "server.json", "..%2fapp.json", "files", "job", "exports"):
        assert page.client.get(f"/results/{name}/{path}").status_code == 404
    assert json.loads((page.folder.of(name) / "app.json").read_text())["name"] == "x"


PATIENCE_S = 90


def asked(address: str, path: str) -> tuple[int, str]:
    connection = HTTPConnection(urlsplit(address).netloc, timeout=30)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.getheader("set-cookie") or ""
    finally:
        connection.close()


@pytest.mark.slow
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
        assert again.returncode == 1 and "is open in another `unocclude app`" in again.stderr
        words = program_words(tmp_path / "other", "--port", str(url.port))
        taken = subprocess.run(words, capture_output=True, text=True, env=environment(), timeout=PATIENCE_S)
        assert taken.returncode != 0 and f"port {url.port} is in use; give another --port" in taken.stderr
        if os.name == "posix":
            assert (folder / ".unocclude").stat().st_mode & 0o077 == 0
        tables = [path for path in (Path("/proc/net/tcp"), Path("/proc/net/tcp6")) if path.is_file()]
        rows = [line.split() for path in tables for line in path.read_text().splitlines()[1:]]
        listening = [row[1].split(":") for row in rows if row[3] == "0A"]
        own = [place for place, port in listening if int(port, 16) == url.port]
        assert own == ["0100007F"] * len(own) and (own or not rows), "127.0.0.1, and no other address"
    finally:
        code = program.close()
    assert code == 0 and program.rest() == "", "one line, whatever was asked"
