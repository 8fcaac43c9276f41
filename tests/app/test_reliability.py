"""What a full disk, a killed program, another user and a hostile request do to the local page."""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from local_page import Page, own_table
from local_program import ROOT, Program, environment

from smoother.app import folder as jobs
from smoother.app import server
from smoother.app.folder import AppFolder, KeptRecording
from smoother.app.steps import in_page_words, stamp
from smoother.errors import UnoccludeError


def wait_for(true: Any, patience_s: float = 60.0) -> None:
    end = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_full_disk_does_not_block_the_next_job(page: Page, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """A job that could not be written, and one that an older version left half made."""
    (tmp_path / "words.csv").write_text("a,b\n1,2\n")
    name = page.add([tmp_path / "words.csv"])
    write = jobs.write_json

    def full(of: str) -> None:
        def fail(path: Path, values: dict[str, Any]) -> None:
            if path.name == of:
                raise UnoccludeError(os.strerror(errno.ENOSPC))
            write(path, values)

        monkeypatch.setattr(jobs, "write_json", fail)

    full("job.json")
    path = f"/api/recordings/{name}/jobs"
    assert "space" in page.ask("POST", path, 400, json={"kind": "describe"})["error"]
    assert list((page.folder.of(name) / "jobs").iterdir()) == []
    (page.folder.of(name) / "jobs" / "0001").mkdir()
    monkeypatch.setattr(jobs, "write_json", write)
    page.begin(name, "describe")
    assert page.wait(name)["job"] == page.wait(name)["job"] | {"number": 2, "state": "done"}


def deep(levels: int) -> str:
    return '{"choices":' + '{"places":' * levels + "1" + "}" * (levels + 1)


BODIES: list[str] = [
    *('{"choices": 1}', '{"choices": null}', '{"choices": [[]]}', "[]", "1", "{", "\0", '"x"', deep(60_000)),
    *('{"choices": {"places": 1}}', '{"choices": {"places": {"\\ud800": "-"}}}', '{"name": "\\udc00"}'),
    *('{"choices": {"imu_starts_at_s": []}}', '{"choices": {"imu_starts_at_s": false}}', deep(300)),
    *('{"choices": {"body": true}}', '{"choices": {"video_turn": []}}', '{"choices": {"remedy": {}}}'),
    *('{"choices": {"left_out": [["x"]]}}', '{"choices": {"video_offset_s": NaN}}', '{"date": []}'),
]


@pytest.mark.parametrize("body", BODIES, ids=[each[:40] for each in BODIES])
def test_no_body_is_a_fault_of_the_server(page: Page, body: str):
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    if body.startswith('{"'):
        body = '{"revision": 0, ' + body[1:]
    answer = page.client.patch(f"/api/recordings/{name}", content=body, headers=page.headers)
    assert answer.status_code == 400 and answer.json()["error"].endswith(".")
    assert page.ask("GET", f"/api/recordings/{name}")["revision"] == 0


VALUES: list[Any] = [1, None, [], {}, [[1]], [{}], "x", True, {"a": {"b": []}}]


@pytest.mark.parametrize("value", VALUES, ids=str)
@pytest.mark.parametrize(
    ("path", "keys"),
    [
        ("{}/jobs", ("kind", "formats", "anyway")),
        ("{}/template", ("file", "kind", "columns", "keys", "title")),
        ("batch", ("ids", "like")),
        ("comparisons", ("person",)),
    ],
)
def test_no_value_is_a_fault_of_the_server(
    page: Page, tmp_path: Path, path: str, keys: tuple[str, ...], value
):
    (tmp_path / "eigen.csv").write_text("Zeit;F1;F2;F3\n" + "1;2;3;4\n" * 20)
    name = page.add([tmp_path / "eigen.csv"])
    good = {"kind": "export", "file": "eigen.csv", "columns": {"t": "Zeit"}, "keys": {"time_unit": "ms"}}
    if path.endswith("template"):
        good["kind"] = "imu"
    (page.folder.of(name) / "recovered.mcap").touch()
    address = "/api/" + path.format(f"recordings/{name}")
    for key in keys:
        answer = page.client.post(address, json={**good, key: value}, headers=page.headers)
        assert answer.status_code < 500 and (answer.status_code == 200 or answer.json()["error"])


@pytest.mark.slow
def test_each_start_has_a_secret_of_its_own(tmp_path: Path):
    """The browser gets a file for its owner alone: its command line shows no token."""
    folder = AppFolder(tmp_path)
    seen = []
    for _ in range(2):
        program = Program(tmp_path)
        seen.append(urlsplit(program.address))
        assert program.close() == 0
    assert seen[0].query != seen[1].query
    file = server.redirect_file(folder, "http://127.0.0.1:1/?token=abc")
    assert (
        stat.S_IMODE(file.stat().st_mode) == 0o600 and "url=http://127.0.0.1:1/?token=abc" in file.read_text()
    )


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="groups of processes are POSIX'")
def test_no_command_outlives_its_killed_server(tmp_path: Path):
    place = tmp_path / AppFolder(tmp_path).add(KeptRecording(name="rec"))
    job = place / "jobs" / "0001"
    words = ["demo", "-o", "demo", "--processes", "2"]
    program = (
        "import sys, time; from pathlib import Path; from smoother.app.folder import AppFolder;"
        " from smoother.app.folder import JobDesk; desk = JobDesk(AppFolder(Path(sys.argv[1])));"
        " desk.add(Path(sys.argv[2]), 'demo', [{'name': 'demo', 'argv': sys.argv[3:]}]); time.sleep(300)"
    )
    run = [sys.executable, "-c", program, tmp_path, place, *words]
    process = subprocess.Popen(run, cwd=ROOT, env=environment())
    with suppress(subprocess.TimeoutExpired):
        process.wait(1)

    def children() -> list[int]:
        rows = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True).stdout
        return [int(r.split()[0]) for r in rows.splitlines()[1:] if int(r.split()[1]) == process.pid]

    wait_for(lambda: (job / "progress.json").exists())  # it computes
    (command,) = children()
    process.send_signal(signal.SIGKILL)
    process.wait()

    def is_gone() -> bool:
        with suppress(ProcessLookupError):
            os.killpg(command, 0)
            return False
        return True

    wait_for(is_gone)
    assert not list(place.rglob("*.tmp"))
    assert jobs.state_of(job)["state"] == "running", "nobody could say it"
    desk = jobs.JobDesk(AppFolder(tmp_path))
    desk.close()
    assert jobs.state_of(job)["state"] == "stopped"


@pytest.mark.slow
def test_a_layout_of_another_recording_makes_nothing_outdated(
    page: Page, session_files: dict[str, Path], tmp_path: Path
):
    """One that reads a file of the recording does."""
    table = own_table(tmp_path / "eigen.csv", session_files["imu"])
    mine, other = page.add([session_files["imu"]]), page.add([table])
    before = [stamp(page.folder, page.folder.of(name)) for name in (mine, other)]
    columns = {"t": "Zeit"} | {
        f"{k}{axis}": f"{c}{n}" for k, c in ("aF", "gD") for n, axis in enumerate("xyz", 1)
    }
    keys = {"time_unit": "ms", "accelerometer_unit": "g", "gyroscope_unit": "deg/s"}
    wish = {"file": "eigen.csv", "kind": "imu", "title": "Ours", "columns": columns, "keys": keys}
    page.ask("POST", f"/api/recordings/{other}/template", json=wish)
    page.wait(other)
    after = [stamp(page.folder, page.folder.of(name)) for name in (mine, other)]
    assert after[0] == before[0] and after[1] != before[1]
    (file,) = page.ask("GET", f"/api/recordings/{other}/streams")["files"]
    assert file["error"] == "" and file["guess"]["names"][0] == "Zeit", "its units can be corrected"


def test_an_empty_file_is_named(page: Page, tmp_path: Path):
    (tmp_path / "empty.csv").touch()
    name = page.add([tmp_path / "empty.csv"], job=True)
    about = page.ask("GET", f"/api/recordings/{name}")
    assert about["job"]["state"] == "done" and about["unread"] == ["empty.csv"]


@pytest.mark.parametrize(
    ("sentence", "shown"),
    [
        ("files count from zero; give --imu-starts-at S", "First IMU sample after"),
        ("the skeleton is mirrored (x); run again with --mirror x", "the button that corrects it"),
        ("several arms; choose one with --side", '"Arm"'),
        ("unknown columns; run `unocclude import describe sensor.csv` on it", "Describe this table"),
        ("name it: --imu forearm_right=dot.csv", '"Worn on"'),
    ],
)
def test_the_page_speaks_of_its_own_controls(sentence: str, shown: str):
    (said,) = in_page_words([sentence])
    assert shown in said and "--" not in said and "`" not in said
