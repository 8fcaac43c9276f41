"""The local page's server: files come, are looked at and imported; what goes wrong is said, and repeated."""

from __future__ import annotations

import asyncio
import re
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from local_page import HOST, PORT, TOKEN, Page, own_table
from starlette.testclient import TestClient
from typer.testing import CliRunner

from smoother.app import server
from smoother.app.folder import AppFolder, JobDesk, KeptRecording, write_json
from smoother.app.server import make_app
from smoother.app.steps import describe_steps, import_steps
from smoother.cli.app import app
from smoother.errors import RecordingError
from smoother.io import open_csv, open_recording
from smoother.io.registry import FileReader, format_named
from smoother.io.tables.recording_toml import read_templates
from smoother.io.tables.table import read_head


@pytest.mark.slow
def test_two_files_become_a_recording(page: Page, session_files: dict[str, Path]):
    name = page.add([session_files["skeleton"], session_files["imu"]], job=True)
    files = {each["name"]: each for each in page.ask("GET", f"/api/recordings/{name}/streams")["files"]}
    (imu,) = files["shimmer.csv"]["streams"]
    assert imu["holds"] == ["accelerometer", "gyroscope"] and imu["units"] == "g, deg/s"
    assert imu["rate_hz"] == pytest.approx(77, abs=4) and imu["key"] == "shimmer.csv"
    assert {plot["title"]: plot["unit"] for plot in imu["plots"]} == {
        "accelerometer": "m/s^2",
        "gyroscope": "rad/s",
    }
    (body,) = files["kinect.csv"]["streams"]
    (wrist,) = body["plots"]
    assert wrist["title"] == "wrist right" and None in wrist["lines"][0]["low"], "gaps are holes"
    highest = max(v for line in imu["plots"][0]["lines"] for v in line["high"])
    assert 9.81 < highest < 80, "in m/s^2, whatever the file's unit"
    about = page.change(name, choices={"places": {"shimmer.csv": "forearm_right"}}, person="p1")
    assert about["date"] == "2026-03-12", "the files say when"
    page.begin(name, "check")
    about = page.wait(name, until=("running",))
    while page.ask("GET", f"/api/recordings/{name}")["imported"] is False:
        time.sleep(0.05)
    page.ask("POST", f"/api/recordings/{name}/cancel")
    about = page.wait(name)
    assert about["job"]["state"] == "cancelled" and about["imported"] and about["check"] is None
    assert not list(page.folder.of(name).glob(".*")), "nothing half written is left"


def test_what_is_no_recording_keeps_its_sentence(page: Page, tmp_path: Path):
    (tmp_path / "words.csv").write_text("these,are,words\n" + "a,b,c\n" * 20)
    name = page.add([tmp_path / "words.csv"])
    (file,) = page.ask("GET", f"/api/recordings/{name}/streams")["files"]
    assert "has an unknown format" in file["error"] and file["streams"] == []
    page.begin(name, "recover")
    assert "an unknown format" in page.wait(name)["job"]["sentence"]
    assert page.ask("DELETE", f"/api/recordings/{name}/files/words.csv")["dropped"] == []
    assert "drop" in page.ask("POST", f"/api/recordings/{name}/jobs", 400, json={"kind": "recover"})["error"]


def test_an_unknown_table_is_described_once(page: Page, session_files: dict[str, Path], tmp_path: Path):
    table = own_table(tmp_path / "eigen.csv", session_files["imu"])
    name = page.add([table, session_files["skeleton"]])
    files = {each["name"]: each for each in page.ask("GET", f"/api/recordings/{name}/streams")["files"]}
    guess = files["eigen.csv"]["guess"]
    assert guess["names"] == ["Zeit", "F1", "F2", "F3", "D1", "D2", "D3"] and len(guess["rows"]) > 3
    columns = {"t": "Zeit"} | {f"a{axis}": f"F{k}" for k, axis in enumerate("xyz", 1)}
    columns |= {f"g{axis}": f"D{k}" for k, axis in enumerate("xyz", 1)}
    keys = {"time_unit": "ms", "accelerometer_unit": "g", "gyroscope_unit": "deg/s"}
    wish = {"file": "eigen.csv", "kind": "imu", "title": "Ours", "columns": columns, "keys": keys}
    wrong = {**wish, "columns": {**columns, "ax": "Zait"}}
    error = page.ask("POST", f"/api/recordings/{name}/template", 400, json=wrong)["error"]
    assert "Zait" in error and "eigen.csv" in error
    page.ask("POST", f"/api/recordings/{name}/template", json=wish)
    page.wait(name)
    assert page.ask("GET", "/api/state")["templates"][0].startswith("ours-")
    again = page.add([own_table(tmp_path / "next.csv", session_files["imu"])])
    (file,) = page.ask("GET", f"/api/recordings/{again}/streams")["files"]
    assert file["title"] == "Ours" and file["streams"][0]["rate_hz"] > 70
    (step,) = import_steps(page.folder, page.folder.of(again))
    assert step["argv"][2:4] == ["--imu", "files/next.csv"] and "--template" in step["argv"]


def test_two_pages_do_not_overwrite_each_other(page: Page):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    seen = page.ask("GET", f"/api/recordings/{name}")["revision"]
    path = f"/api/recordings/{name}"
    page.ask("PATCH", path, json={"revision": seen, "person": "p1"})
    late = page.ask("PATCH", path, 409, json={"revision": seen, "person": "p2"})
    assert "Another page" in late["error"]
    assert page.ask("GET", path)["person"] == "p1"


@pytest.mark.parametrize(
    "wish",
    [
        {"date": "12.3.2026"},
        {"date": "2026-02-31"},
        {"name": "x" * 500},
        {"name": 5},
        {"choices": {"remedy": "--output /etc/passwd"}},
        {"choices": {"remedy": "--mirror x --force"}},
        {"choices": {"places": {"a": "wrist; rm"}}},
        {"choices": {"side": "both"}},
        {"choices": {"body": -1}},
        {"choices": {"imu_starts_at_s": 1e12}},
        {"choices": {"nothing": 1}},
    ],
)
def test_a_value_that_cannot_be_is_refused(page: Page, wish: dict[str, object]):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    answer = page.ask("PATCH", f"/api/recordings/{name}", 400, json={"revision": 0, **wish})
    assert answer["error"].endswith(".")


def test_a_removed_recording_is_moved(page: Page, session_files: dict[str, Path]):
    name = page.add([session_files["imu"]])
    moved = Path(page.ask("DELETE", f"/api/recordings/{name}")["moved_to"])
    assert (moved / "files" / "shimmer.csv").is_file()
    assert page.ask("GET", "/api/state")["recordings"] == []


def test_a_full_disk_is_said_before_anything_is_written(page: Page, monkeypatch: pytest.MonkeyPatch):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    monkeypatch.setattr(server.shutil, "disk_usage", lambda _: SimpleNamespace(free=10))
    answer = page.ask("PUT", f"/api/recordings/{name}/files/a.csv", 507, content=b"x" * 100)
    assert "no space left on the disk" in answer["error"] and "a.csv" in answer["error"]
    assert not any((page.folder.of(name) / "files").iterdir())


def upload(page: Page, name: str, chunks: list[bytes], cut: bool) -> int:
    """Send a file in chunks, as a browser does; with `cut` the tab closes before its end."""
    app, sent = page.client.app, []
    parts = iter(chunks)

    async def receive() -> dict[str, object]:
        chunk = next(parts, None)
        if chunk is None:
            return {"type": "http.disconnect"} if cut else {"type": "http.request", "body": b""}
        return {"type": "http.request", "body": chunk, "more_body": True}

    async def send(message: dict[str, object]) -> None:
        sent.append(message)

    headers = {"host": HOST.removeprefix("http://"), "origin": HOST, "cookie": f"unocclude-{PORT}={TOKEN}"}
    scope = {
        "type": "http",
        "method": "PUT",
        "path": f"/api/recordings/{name}/files/big.bin",
        "raw_path": b"",
        "query_string": b"",
        "headers": [(key.encode(), value.encode()) for key, value in headers.items()],
        "http_version": "1.1",
        "scheme": "http",
        "server": ("127.0.0.1", PORT),
        "client": ("127.0.0.1", 1),
        "root_path": "",
    }
    asyncio.run(app(scope, receive, send))
    return int(sent[0]["status"])


def test_a_closed_tab_leaves_no_half_file(page: Page):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    assert upload(page, name, [b"x" * 3_000_000] * 3, cut=True) == 400
    assert list((page.folder.of(name) / "files").iterdir()) == []
    assert upload(page, name, [b"x" * 100_000] * 3, cut=False) == 200
    assert (page.folder.of(name) / "files" / "big.bin").stat().st_size == 300_000


def test_an_upload_is_limited_by_the_disk_and_not_by_memory(page: Page):
    """So much more memory at most while 60 MB come as while one comes."""
    import tracemalloc

    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    block = b"x" * 65_536
    tracemalloc.start()
    upload(page, name, [block] * 960, cut=False)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8_000_000
    assert (page.folder.of(name) / "files" / "big.bin").stat().st_size == 960 * 65_536


def test_only_one_job_of_a_recording_at_a_time(page: Page, session_files: dict[str, Path]):
    name = page.add([session_files["imu"], session_files["skeleton"]])
    page.begin(name, "check")
    for method, path, more in (
        ("POST", "jobs", {"json": {"kind": "check"}}),
        ("PUT", "files/a.csv", {"content": b"x"}),
        ("DELETE", "files/shimmer.csv", {}),
    ):
        answer = page.ask(method, f"/api/recordings/{name}/{path}", 409, **more)
        assert "wait for it, or cancel it" in answer["error"]
    page.ask("POST", f"/api/recordings/{name}/cancel")
    assert page.wait(name)["job"]["state"] == "cancelled"


def test_one_job_at_a_time_and_the_others_wait(page: Page, session_files: dict[str, Path]):
    names = [page.add([session_files["imu"], session_files["skeleton"]], f"s{k}") for k in range(3)]
    assert page.ask("POST", "/api/batch", json={"ids": names, "like": names[0]})["begun"] == 3
    wait_until = time.monotonic() + 10
    states: list[str] = []
    while states[:1] != ["running"] and time.monotonic() < wait_until:
        states = [page.ask("GET", f"/api/recordings/{each}")["job"]["state"] for each in names]
    assert states == ["running", "waiting", "waiting"]
    for each in reversed(names):
        page.ask("POST", f"/api/recordings/{each}/cancel")
    assert [page.wait(each)["job"]["state"] for each in names] == ["cancelled"] * 3


def test_what_a_killed_server_was_doing_was_stopped_and_is_repeated(
    tmp_path: Path, session_files: dict[str, Path]
):
    folder = AppFolder(tmp_path / "recordings")
    name = folder.add(KeptRecording(name="s"))
    place = folder.of(name)
    shutil.copy(session_files["imu"], place / "files")
    job = place / "jobs" / "0001"
    job.mkdir(parents=True)
    steps = describe_steps(folder, place)
    write_json(job / "job.json", {"kind": "describe", "steps": steps, "state": "running", "step": 0})
    with TestClient(make_app(folder, JobDesk(folder), TOKEN, PORT), base_url=HOST) as client:
        client.get(f"/?token={TOKEN}")
        page = Page(client, folder)
        assert page.ask("GET", f"/api/recordings/{name}")["job"]["state"] == "stopped"
        page.begin(name, "describe")
        assert page.wait(name)["job"]["state"] == "done"


def test_sessions_of_a_person_need_two_results(page: Page, session_files: dict[str, Path]):
    name = page.add([session_files["imu"]])
    page.change(name, person="p1")
    answer = page.ask("POST", "/api/comparisons", 400, json={"person": "p1"})
    assert "two recovered recordings" in answer["error"]


BLOCK = re.search(
    r"```toml\n(.*?)```", (Path(__file__).parents[2] / "docs" / "app.md").read_text("utf-8"), re.DOTALL
)[1]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("[imu]", "[table]"), "table is not known here"),
        (('"g"', '"stone"'), "imu.accelerometer_unit is 'stone'"),
        (("width = 7", "width = 3"), "names lists the table's columns"),
        (("[imu.columns]", "[camera]\nframe = 'kinect'\n[imu.columns]"), "give [imu] or [camera]"),
        (("[template]", "[template"), "is not readable TOML"),
    ],
)
def test_a_template_that_cannot_be(tmp_path: Path, change: tuple[str, str], sentence: str):
    (tmp_path / "lab.toml").write_text(BLOCK.replace(*change))
    with pytest.raises(RecordingError, match=re.escape(sentence)):
        read_templates([tmp_path / "lab.toml"])


def test_a_template_reads_the_tables_of_a_described_folder(tmp_path: Path, session_files: dict[str, Path]):
    """`import csv --template`: recording.toml names the file, the template says what its columns are."""
    (tmp_path / "lab.toml").write_text(BLOCK)
    (template,) = templates = read_templates([tmp_path / "lab.toml"])
    table = own_table(tmp_path / "sensor.csv", session_files["imu"])
    assert template.recognises(read_head(table)) and not template.recognises(read_head(session_files["imu"]))
    description = tmp_path / "recording.toml"
    description.write_text('[imu.forearm_right]\nfile = "sensor.csv"\n')
    (theirs,) = FileReader().read(session_files["imu"], format_named("shimmer"))
    with pytest.raises(RecordingError, match=r"sensor\.csv"):
        open_csv(tmp_path)
    (imu,) = open_csv(tmp_path, templates=templates).imus
    assert imu.topic == "/imu/forearm_right"
    assert np.allclose(imu.acc, theirs.acc) and np.allclose(imu.gyro, theirs.gyro)
    output, lab = str(tmp_path / "o.mcap"), str(tmp_path / "lab.toml")
    words = ["import", "csv", str(tmp_path), "--template", lab, "-o", output]
    assert CliRunner().invoke(app, words).exit_code == 0 and open_recording(output).imus
    (tmp_path / "linked.mcap").hardlink_to(lab)
    refused = CliRunner().invoke(app, [*words[:-1], str(tmp_path / "linked.mcap"), "--force"])
    assert "is read by this command" in str(refused.exception) and Path(lab).read_text() == BLOCK
    description.write_text(description.read_text() + 'gyroscope_unit = "mdps"\n')
    (imu,) = open_csv(tmp_path, templates=templates).imus
    assert np.allclose(1000 * imu.gyro, theirs.gyro), "what recording.toml says itself counts"
    (tmp_path / "sensor.csv").unlink()
    with pytest.raises(RecordingError, match=r"sensor\.csv does not exist"):
        open_csv(tmp_path, templates=templates)
