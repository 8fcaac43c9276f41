"""The local page's server: files come, are looked at and imported; what goes wrong is said, and repeated."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import shutil
import signal
import stat
import subprocess
import sys
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from local_page import HOST, PORT, TOKEN, Page, own_table, write_session
from local_program import ROOT, Program, environment
from pose_videos import STAND_IN, mediapipe_stand_in, person_of, write_model, write_video
from starlette.testclient import TestClient
from typer.testing import CliRunner

from smoother.app import folder as jobs
from smoother.app import server
from smoother.app.folder import AppFolder, JobDesk, KeptJob, KeptRecording, job_folder, write_job, write_json
from smoother.app.server import make_app
from smoother.app.steps import (
    IMPORTED,
    MATCHES,
    SESSION,
    describe_steps,
    import_steps,
    in_page_words,
    recording_of,
    recover_steps,
    stamp,
)
from smoother.cli.app import app
from smoother.errors import RecordingError, UnoccludeError
from smoother.io import open_recording
from smoother.io.registry import FileReader, format_named
from smoother.io.tables.recording_toml import read_templates
from smoother.io.tables.table import read_head
from smoother.simulation import ArmSimulation, simulate_arm


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
    job_folder(place).mkdir()
    write_job(place, KeptJob(kind="describe", steps=describe_steps(folder, place), state="running"))
    with TestClient(make_app(folder, JobDesk(folder), TOKEN, PORT), base_url=HOST) as client:
        client.get(f"/?token={TOKEN}")
        page = Page(client, folder)
        assert page.ask("GET", f"/api/recordings/{name}")["job"]["state"] == "stopped"
        page.begin(name, "describe")
        assert page.wait(name)["job"]["state"] == "done"


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '{"steps": 3}', '{"state": "running", "step": "x"}', "\0"]
)
def test_a_damaged_job_was_stopped_and_is_repeated(page: Page, tmp_path: Path, content: str):
    (tmp_path / "words.csv").write_text("a,b\n1,2\n")
    name = page.add([tmp_path / "words.csv"])
    file = job_folder(page.folder.of(name)) / "job.json"
    file.parent.mkdir()
    file.write_text(content)
    assert page.ask("GET", f"/api/recordings/{name}")["job"]["state"] == "stopped"
    assert page.ask("GET", "/api/state")["recordings"][0]["job"]["open"] is False
    page.begin(name, "describe")
    page.wait(name, until=("running",))
    file.write_text(content)  # while it runs: what is known of it is in memory too
    about = page.wait(name, until=("done",))
    assert about["job"]["state"] in ("stopped", "done")
    wait_for(lambda: page.ask("GET", f"/api/recordings/{name}")["job"]["state"] == "done")


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


def test_a_template_reads_the_tables_that_have_its_columns(tmp_path: Path, session_files: dict[str, Path]):
    (tmp_path / "lab.toml").write_text(BLOCK)
    (template,) = templates = read_templates([tmp_path / "lab.toml"])
    table = own_table(tmp_path / "sensor.csv", session_files["imu"])
    assert template.recognises(read_head(table)) and not template.recognises(read_head(session_files["imu"]))
    (theirs,) = FileReader().read(session_files["imu"], format_named("shimmer"))
    reader = FileReader(templates=templates)
    (imu,) = reader.read(table, reader.format_of(table, "imu"))
    assert np.allclose(imu.acc, theirs.acc) and np.allclose(imu.gyro, theirs.gyro)
    output, lab = str(tmp_path / "o.mcap"), str(tmp_path / "lab.toml")
    words = ["import", "files", "--imu", str(table), "--template", lab, "-o", output]
    assert CliRunner().invoke(app, words).exit_code == 0 and open_recording(output).imus
    (tmp_path / "linked.mcap").hardlink_to(lab)
    refused = CliRunner().invoke(app, [*words[:-1], str(tmp_path / "linked.mcap"), "--force"])
    assert "is read by this command" in str(refused.exception) and Path(lab).read_text() == BLOCK


#: A recovery of 33 s with measures, two at a time on a busy machine.
PATIENCE_S = 300.0


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A video of the arm of `write_session`, its model, and the IMU's file."""
    folder = tmp_path_factory.mktemp("film")
    files = write_session(folder / "session", repetitions=1)
    arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), seed=5).recording
    t_s = np.arange(0.0, arm.arm.t_s[-1] - arm.arm.t_s[0], 1 / 15)
    person = person_of(arm, arm.arm.t_s[0] + t_s)
    return {
        "video": write_video(folder / "phone.mp4", [person], 15.0),
        "model": write_model(folder / "pose_landmarker_full.task", [person], t_s),
        "imu": files["imu"],
    }


@pytest.mark.slow
def test_a_video_is_the_camera_where_there_is_no_other(
    page: Page, film: dict[str, Path], monkeypatch: pytest.MonkeyPatch
):
    """It says what it needs; with the model the arm is found, and the model stays for the next one."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(STAND_IN), os.environ.get("PYTHONPATH", "")]))
    with mediapipe_stand_in():
        name = page.add([film["video"], film["imu"]])
        about = page.ask("GET", f"/api/recordings/{name}")
        assert about["camera_video"] == {"file": "phone.mp4", "model": "", "installed": True}
        path = f"/api/recordings/{name}/jobs"
        refused = page.ask("POST", path, 400, json={"kind": "recover"})["error"]
        assert "the model" in refused and "pose_landmarker_full.task" in refused
        model = film["model"]
        page.ask("PUT", f"/api/recordings/{name}/files/{model.name}", content=model.read_bytes())
        page.look(name)
        page.change(name, choices={"places": {"shimmer.csv": "forearm_right"}})
        assert page.ask("GET", f"/api/recordings/{name}")["camera_video"]["model"] == model.name
        page.begin(name, "check")
        about = page.wait(name, patience_s=PATIENCE_S)
        assert about["job"]["state"] == "done", about["job"]
        assert "phone.mp4: video, MediaPipe" in about["job"]["printed"]
        assert about["check"]["pairing"]["proved"] is True
        recover = recover_steps(page.folder, page.folder.of(name))[-1]["argv"]
        assert "--video" not in recover
        again = page.add([film["video"], film["imu"]])
        assert page.ask("GET", f"/api/recordings/{again}")["camera_video"]["model"] == model.name
        page.change(again, choices={"video_mirrored": True, "video_turn": 90})
        words = import_steps(page.folder, page.folder.of(again))[0]["argv"]
        assert words[:3] == ["import", "video", "files/phone.mp4"] and "--mirrored" in words
        assert words[words.index("--turn") + 1] == "90"
        assert words[words.index("--model") + 1].endswith(f"models/{model.name}")


def test_a_video_beside_a_skeleton_is_not_the_camera(
    page: Page, film: dict[str, Path], session_files: dict[str, Path]
):
    name = page.add([film["video"], session_files["imu"], session_files["skeleton"]])
    assert page.ask("GET", f"/api/recordings/{name}")["camera_video"] is None
    page.change(name, choices={"left_out": ["kinect.csv"]})
    assert page.ask("GET", f"/api/recordings/{name}")["camera_video"]["file"] == "phone.mp4"


def test_a_job_that_misses_mediapipe_says_so(page: Page, film: dict[str, Path]):
    name = page.add([film["video"], film["imu"], film["model"]])
    about = page.ask("GET", f"/api/recordings/{name}")
    if about["camera_video"]["installed"]:
        pytest.skip("MediaPipe is installed here")
    page.begin(name, "check")
    sentence = page.wait(name)["job"]["sentence"]
    assert "this needs MediaPipe, which is not installed" in sentence and "'.[video]'" in sentence


def test_trials_of_one_person_and_day_are_a_session(page: Page, session_files: dict[str, Path]) -> None:
    """Those that were imported, each for the other; not one of another person."""
    names = [page.add([session_files["imu"], session_files["skeleton"]]) for _ in range(3)]
    for name, person in zip(names, ("p1", "p1", "p2"), strict=True):
        page.change(name, person=person, date="2026-01-05")
        place = page.folder.of(name)
        (place / recording_of(place)).touch()
    first, second, other = (page.folder.of(name) for name in names)
    assert "--session" in recover_steps(page.folder, first)[-1]["argv"]
    listed = (first / SESSION).read_text().splitlines()
    assert [(first / line).resolve() for line in listed] == [second / recording_of(second)]
    assert "--session" not in recover_steps(page.folder, other)[-1]["argv"]


def test_an_upload_without_a_length_stops_before_the_disk_is_full(
    page: Page, monkeypatch: pytest.MonkeyPatch
):
    """Its room is looked at as it comes; what came is taken away."""
    name = page.ask("POST", "/api/recordings", json={"name": "x"})["id"]
    free = iter([10 * server.RESERVE_BYTES] * 3 + [server.RESERVE_BYTES] * 10)
    monkeypatch.setattr(server.shutil, "disk_usage", lambda _: SimpleNamespace(free=next(free)))
    assert upload(page, name, [b"x" * (1 << 20)] * 5, cut=False) == 507
    assert list((page.folder.of(name) / "files").iterdir()) == []


def test_a_proposal_finds_its_file_where_the_file_names_no_sensor(
    page: Page, session_files: dict[str, Path], tmp_path: Path
):
    """The import says which topic a file became; `match` names topics."""
    second = shutil.copy(session_files["imu"], tmp_path / "other.csv")
    name = page.add([session_files["imu"], second, session_files["skeleton"]])
    place = page.folder.of(name)
    reports = [
        {"path": "files/kinect.csv", "topics": ["/skeleton"]},
        {"path": "files/other.csv", "topics": ["/imu/other"]},
        {"path": "files/shimmer.csv", "topics": ["/imu/shimmer"]},
    ]
    write_json(place / IMPORTED, {"files": reports})
    matches = [
        {"imu": f"/imu/{k}", "joint": j, "probability": 0.97}
        for k, j in (("other", "none"), ("shimmer", "wrist_right"))
    ]
    write_json(place / MATCHES, {"matches": matches})
    found = page.ask("GET", f"/api/recordings/{name}")["proposals"]
    assert {key: each["joint"] for key, each in found.items()} == {
        "other.csv": "none",
        "shimmer.csv": "wrist_right",
    }
    steps = import_steps(page.folder, place)
    assert [each["name"] for each in steps] == ["import", "match"] and "--json" in steps[0]["argv"]
    page.change(name, choices={"places": {"shimmer.csv": "forearm_right", "other.csv": "-"}})
    assert [each["name"] for each in import_steps(page.folder, place)] == ["import"]


def test_halves_of_an_imu_go_together(page: Page, session_files: dict[str, Path], tmp_path: Path):
    """Accelerometer and gyroscope in files of their own: a place chosen for one counts for both."""
    lines = session_files["imu"].read_text().splitlines()[3:]
    columns = np.array([line.split(",") for line in lines], dtype=float)
    halves = []
    for name, unit, at in (("Accelerometer", "g", 1), ("Gyroscope", "deg/s", 4)):
        for device in ("A", "B"):
            path = tmp_path / f"Meta{device}_{name}.csv"
            rows = np.column_stack(
                [columns[:, 0], (columns[:, 0] - columns[0, 0]) / 1e3, columns[:, at : at + 3]]
            )
            head = "epoch (ms),elapsed (s)," + ",".join(f"{axis}-axis ({unit})" for axis in "xyz")
            path.write_text("\n".join([head, *(",".join(f"{v:.6f}" for v in row) for row in rows)]) + "\n")
            halves.append(path)
    name = page.add([session_files["skeleton"], *halves])
    place = page.folder.of(name)

    def imus() -> list[str]:
        words = import_steps(page.folder, place)[0]["argv"]
        return sorted(after for word, after in pairwise(words) if word == "--imu")

    asked = page.ask("POST", f"/api/recordings/{name}/jobs", 400, json={"kind": "check"})["error"]
    assert "MetaA_Accelerometer.csv" in asked and "Choose where each of them is worn" in asked
    a, b = (f"files/Meta{k}_Accelerometer.csv,files/Meta{k}_Gyroscope.csv" for k in "AB")
    page.change(name, choices={"left_out": [halves[1].name, halves[3].name]})
    assert imus() == [a]
    page.change(name, choices={"places": {halves[2].name: "forearm_right"}})
    assert imus() == [f"forearm_right={a}"], "chosen for the gyroscope, it counts for both"
    places = {halves[0].name: "forearm_right", halves[2].name: "forearm_right", halves[1].name: "hand_right"}
    page.change(name, choices={"left_out": [], "places": places})
    assert imus() == [f"forearm_right={a}", f"hand_right={b}"]


def wait_for(true: Any, patience_s: float = 60.0) -> None:
    end = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_full_disk_does_not_block_the_next_job(page: Page, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
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
    assert page.ask("GET", f"/api/recordings/{name}")["job"] is None
    monkeypatch.setattr(jobs, "write_json", write)
    page.begin(name, "describe")
    assert page.wait(name)["job"] == page.wait(name)["job"] | {"number": 1, "state": "done"}


def deep(levels: int) -> str:
    return '{"choices":' + '{"places":' * levels + "1" + "}" * (levels + 1)


BODIES: list[str] = [
    *('{"choices": 1}', '{"choices": null}', '{"choices": [[]]}', "[]", "1", "{", "\0", '"x"', deep(60_000)),
    *('{"choices": {"places": 1}}', '{"choices": {"places": {"\\ud800": "-"}}}', '{"name": "\\udc00"}'),
    *('{"choices": {"imu_starts_at_s": []}}', '{"choices": {"imu_starts_at_s": false}}', deep(300)),
    *('{"choices": {"body": true}}', '{"choices": {"video_turn": []}}', '{"choices": {"remedy": {}}}'),
    *('{"date": "12.3.2026"}', '{"date": "2026-02-31"}', f'{{"name": "{"x" * 500}"}}', '{"name": 5}'),
    *('{"choices": {"remedy": "--output /etc/passwd"}}', '{"choices": {"remedy": "--mirror x --force"}}'),
    *('{"choices": {"places": {"a": "wrist; rm"}}}', '{"choices": {"side": "both"}}'),
    *('{"choices": {"imu_starts_at_s": 1e12}}', '{"choices": {"body": -1}}', '{"choices": {"nothing": 1}}'),
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

    wait_for(lambda: (job_folder(place) / "progress.json").exists())  # it computes
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
    assert jobs.read_job(place).state == "running", "nobody could say it"
    desk = jobs.JobDesk(AppFolder(tmp_path))
    desk.close()
    assert jobs.read_job(place).state == "stopped"


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
