"""A folder of the local page, its server asked without a socket, and files as devices export them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the extra `app` is not installed")

from local_page import DAY_S, write_session
from starlette.testclient import TestClient

from smoother.app.folder import AppFolder, write_json
from smoother.app.jobs import JobDesk
from smoother.app.server import make_app
from smoother.app.steps import STREAMS
from smoother.io.devices.described import describe_files
from smoother.io.devices.registry import FileReader
from smoother.io.plain.template import read_templates

PORT, TOKEN = 8123, "secret-token"
HOST = f"http://127.0.0.1:{PORT}"


@dataclass
class Page:
    """What a browser with the page open does."""

    client: TestClient
    folder: AppFolder
    headers: dict[str, str] = field(default_factory=lambda: {"origin": HOST})

    def ask(self, method: str, path: str, code: int = 200, **more: Any) -> dict[str, Any]:
        answer = self.client.request(method, path, headers=self.headers, **more)
        assert answer.status_code == code, (method, path, answer.status_code, answer.text[:500])
        return answer.json() if answer.headers["content-type"] == "application/json" else {}

    def add(self, files: list[Path], name: str = "Session", job: bool = False) -> str:
        """A recording of files, copied and looked at: in this process, or by a job."""
        made: str = self.ask("POST", "/api/recordings", json={"name": name})["id"]
        for file in files:
            self.ask("PUT", f"/api/recordings/{made}/files/{file.name}", content=file.read_bytes())
        self.look(made, job)
        return made

    def look(self, name: str, job: bool = False) -> None:
        """Look at a recording's files."""
        if job:
            self.begin(name, "describe")
            self.wait(name)
            return
        place = self.folder.of(name)
        reader = FileReader(templates=read_templates(self.folder.template_files()))
        found = [each.to_dict() for each in describe_files([place / "files"], reader)]
        for each in found:
            each["file"] = f"files/{Path(each['file']).name}"
        write_json(place / STREAMS, {"files": found})

    def begin(self, name: str, kind: str, **more: Any) -> dict[str, Any]:
        return self.ask("POST", f"/api/recordings/{name}/jobs", json={"kind": kind, **more})

    def change(self, name: str, **wish: Any) -> dict[str, Any]:
        revision = self.ask("GET", f"/api/recordings/{name}")["revision"]
        return self.ask("PATCH", f"/api/recordings/{name}", json={"revision": revision, **wish})

    def wait(self, name: str, until: tuple[str, ...] = (), patience_s: float = 120.0) -> dict[str, Any]:
        """Wait until a recording's job is over (or in a state), and what is known then."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            about = self.ask("GET", f"/api/recordings/{name}")
            job = about["job"]
            if job is None or job["state"] in until or not job["open"]:
                return about
            time.sleep(0.05)
        raise AssertionError(f"still {about['job']}")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """The page of an empty folder; the jobs that it began are ended."""
    folder = AppFolder(tmp_path / "recordings")
    app = make_app(folder, JobDesk(folder), TOKEN, PORT)
    with TestClient(app, base_url=HOST) as client:
        assert client.get(f"/?token={TOKEN}").status_code == 200
        yield Page(client, folder)


@pytest.fixture(scope="session")
def session_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A session as devices export it, one of another day, and the same mirrored; see `write_session`."""
    folder = tmp_path_factory.mktemp("session")
    return write_session(folder / "one") | {
        f"other_{key}": path for key, path in write_session(folder / "two", start_s=9 * DAY_S).items()
    }
