"""A folder of the local page, its server asked without a socket, and files as devices export them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra `app` is not installed")

from local_page import DAY_S, HOST, PORT, TOKEN, Page, write_session
from starlette.testclient import TestClient

from smoother.app.folder import AppFolder, JobDesk
from smoother.app.server import make_app


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
