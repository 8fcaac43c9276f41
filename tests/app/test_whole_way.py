"""A video as the camera, recordings that lie in the folder, and what is asked where files do not tell."""

from __future__ import annotations

import os
import shutil
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from local_page import Page, write_session
from pose_videos import STAND_IN, mediapipe_stand_in, person_of, write_model, write_video
from test_server import upload

from smoother.app import server
from smoother.app.folder import write_json
from smoother.app.steps import IMPORTED, MATCHES, SESSION, import_steps, recording_of, recover_steps
from smoother.simulation import ArmSimulation, simulate_arm

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
