"""`import video`: turned, mirrored and uneven videos, nobody and two people in them."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from pose_videos import (
    QUARTERS,
    Person,
    mediapipe_stand_in,
    person_of,
    with_steps,
    with_turn,
    write_model,
    write_video,
)
from typer.testing import CliRunner

from smoother.cli.app import app
from smoother.errors import RecordingError, UnoccludeError
from smoother.io import open_recording
from smoother.io.tables.joints import BLAZEPOSE
from smoother.io.tables.video import pose_video
from smoother.recording import CameraFrame, JointState
from smoother.simulation import ArmSimulation, simulate_arm

RATE_HZ = 20.0
WRIST = BLAZEPOSE.index("right_wrist")


@pytest.fixture(scope="module", autouse=True)
def mediapipe() -> Iterator[None]:
    with mediapipe_stand_in():
        yield


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Person, np.ndarray]:
    """A folder with `arm.mp4` of 3 s and its `pose.task`; who is in it, and when."""
    folder = tmp_path_factory.mktemp("video")
    recording = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), seed=5).recording
    t_s = np.arange(60) / RATE_HZ
    person = person_of(recording, recording.arm.t_s[0] + 2.0 + t_s)
    write_video(folder / "arm.mp4", [person], RATE_HZ)
    write_model(folder / "pose.task", [person], t_s)
    return folder, person, t_s


def check_shown() -> None:
    """MediaPipe was given the pictures upright, red first."""
    picture = sys.modules["mediapipe"].SHOWN[0]
    red = [np.array_split(half[..., 0], 2, axis=1) for half in np.array_split(picture, 2)]
    np.testing.assert_allclose([[np.median(each) for each in half] for half in red], QUARTERS, atol=25)
    assert (picture[..., 2] < 60).mean() > 0.9


def test_landmarks_in_space(scene):
    folder, person, t_s = scene
    (table,) = pose_video(folder / "pose.task").read(folder / "arm.mp4")
    np.testing.assert_allclose(table.t_s, t_s, atol=1e-3)
    assert table.frame is CameraFrame.OPTICAL and table.relative and table.units == "m"
    np.testing.assert_allclose(table.position["wrist_right"], person.points[:, WRIST], atol=1e-12)
    hidden = person.visibility[:, WRIST] < 0.5
    assert 0 < hidden.sum() < 40
    wanted = np.where(hidden, JointState.INFERRED, JointState.TRACKED)
    np.testing.assert_array_equal(table.state["wrist_right"], wanted)
    check_shown()
    assert any("not mirrored" in note and "--mirrored" in note for note in table.notes)


@pytest.mark.parametrize("by_file", [True, False])
@pytest.mark.parametrize(
    ("turn", "back"),
    [(cv2.ROTATE_90_COUNTERCLOCKWISE, 90), (cv2.ROTATE_180, 180), (cv2.ROTATE_90_CLOCKWISE, 270)],
)
def test_a_phone_held_upright(scene, tmp_path: Path, turn: int, back: int, by_file: bool):
    """Sideways pictures are turned as the file says, or as the user does where it does not."""
    folder, person, t_s = scene
    video = write_video(tmp_path / "turned.mp4", [person], RATE_HZ, turn)
    if by_file:  # who lies in the picture is asked about
        lying = write_model(tmp_path / "lying.task", [replace(person, turn_deg=-back)], t_s)
        assert any(f"--turn {back}" in note for note in pose_video(lying).read(video)[0].notes)
        with_turn(video, back)
    (table,) = pose_video(folder / "pose.task", turn_deg=0 if by_file else back).read(video)
    check_shown()
    assert not any("--turn" in note for note in table.notes)
    assert any(f"turned by {back} degrees" in note for note in table.notes) is by_file


def test_a_mirrored_front_camera(scene, tmp_path: Path):
    folder, person, _ = scene
    video = write_video(tmp_path / "selfie.mp4", [person], RATE_HZ, turn=-1)
    (table,) = pose_video(folder / "pose.task", mirrored=True).read(video)
    check_shown()
    assert any("flipped left to right" in note for note in table.notes)


def test_a_variable_frame_rate(scene, tmp_path: Path):
    """Phones lengthen pictures in the dark: the container's times count, not the rate."""
    folder, person, _ = scene
    video = tmp_path / "dark.mp4"
    shutil.copy(folder / "arm.mp4", video)
    ticks = np.random.default_rng(3).integers(400, 1600, len(person.points))
    with_steps(video, ticks.tolist())
    (table,) = pose_video(folder / "pose.task").read(video)
    ratio = np.diff(table.t_s) / ticks[:-1]
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.05)
    assert any("variable frame rate" in note for note in table.notes)


def test_two_people_and_nobody(scene, tmp_path: Path):
    """Each keeps a number, also where one is away for a while; MediaPipe itself gives none."""
    folder, person, t_s = scene
    away = np.isin(np.arange(60), [*range(10), *range(30, 40)])
    still = np.where(away[:, None, None], np.nan, person.points[:1])
    people = [person.moved(-0.7), replace(person, points=still).moved(0.75)]
    model = write_model(tmp_path / "two.task", people, t_s)
    one, two = pose_video(model).read(folder / "arm.mp4")
    assert (one.body, two.body) == (0, 1)
    np.testing.assert_allclose(one.position["wrist_right"], person.points[:, WRIST], atol=1e-12)
    np.testing.assert_array_equal(two.state["elbow_right"] == JointState.NOT_TRACKED, away)
    assert any("2 people" in note and "--body" in note for note in one.notes)
    (alone,) = pose_video(model, people=1).read(folder / "arm.mp4")
    assert not any("2 people" in note for note in alone.notes)
    nobody = write_model(tmp_path / "nobody.task", [], t_s)
    with pytest.raises(RecordingError, match=r"arm\.mp4: no person was found in its pictures \(60\)"):
        pose_video(nobody).read(folder / "arm.mp4")


def run(*words: object) -> tuple[int, str]:
    """Exit code and what was printed."""
    result = CliRunner().invoke(app, ["import", *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        assert isinstance(result.exception, UnoccludeError), result.exception
        return 1, str(result.exception)
    return result.exit_code, result.output


def test_the_recording_keeps_the_skeleton(scene, tmp_path: Path):
    folder, person, _ = scene
    output = tmp_path / "session.mcap"
    words = ("--model", folder / "pose.task", "-o", output, "--json", tmp_path / "a.json")
    code, said = run("video", folder / "arm.mp4", *words)
    assert code == 0 and "arm.mp4: video, MediaPipe pose landmarker" in said
    file = open_recording(output)
    arm = next(each for each in file.arms if each.side == "right" and each.topic == "/skeleton")
    assert len(arm.stamp_ns) == len(person.points)
    topics = {each["name"]: each for each in json.loads((tmp_path / "a.json").read_text())["topics"]}
    assert "/skeleton" in topics


def test_wrong_ways(scene, tmp_path: Path):
    """One sentence each, before any work, and no output."""
    folder, _, _ = scene
    model, video, output = folder / "pose.task", folder / "arm.mp4", tmp_path / "o.mcap"
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(video.read_bytes()[:3000])
    text = tmp_path / "words.csv"
    text.write_text("t,x\n1,2\n")
    for words, sentence in (
        ((video,), "--model FILE"),
        ((video, "--model", tmp_path / "none.task"), "none.task does not exist"),
        ((video, "--model", text), "not a model of the pose landmarker"),
        ((cut, "--model", model), "not a video that can be read"),
        ((text, "--model", model), "not a video (MP4"),
        ((tmp_path / "no.mp4", "--model", model), "does not exist"),
        ((video, "--model", model, "--turn", "45"), "--turn is 90, 180 or 270"),
    ):
        code, said = run("video", *words, "-o", output)
        assert code != 0 and sentence in " ".join(said.split()), (words, said)
    broken = tmp_path / "broken.task"
    with zipfile.ZipFile(broken, "w") as bundle:
        bundle.writestr("pose_landmarks_detector.tflite", b"cut off")
    code, said = run("video", video, "--model", broken, "-o", output)
    assert code != 0 and "MediaPipe cannot use" in said and "Flatbuffer" in said
    assert not output.exists()


def test_without_the_extra_and_by_import_files(scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder, _, _ = scene
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    code, said = run("video", folder / "arm.mp4", "--model", folder / "pose.task", "-o", tmp_path / "o.mcap")
    assert code != 0 and "this needs MediaPipe, which is not installed" in said and "'.[video]'" in said
    code, said = run("files", "--skeleton", folder / "arm.mp4", "-o", tmp_path / "o.mcap")
    assert code != 0 and "is a video; `unocclude import video" in said
