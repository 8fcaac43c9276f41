"""`import video`: turned, mirrored and uneven videos, nobody and two people in them."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from pose_videos import Person, mediapipe_stand_in, person_of, with_steps, with_turn, write_model, write_video
from typer.testing import CliRunner

from smoother.cli.app import app
from smoother.errors import RecordingError, UnoccludeError
from smoother.io import open_recording
from smoother.io.tables.video import pose_video
from smoother.recording import CameraFrame, JointState
from smoother.simulation import ArmSimulation, simulate_arm

RATE_HZ = 20.0
WRIST = 5
#: What a disc's middle is found to in a compressed picture, m: half a pixel and more.
TOLERANCE_M = 0.008


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


def wrist_error_m(table, person: Person) -> np.ndarray:
    """Distances where the wrist was seen, m."""
    seen = table.state["wrist_right"] == JointState.TRACKED
    assert seen.sum() > 20
    return np.linalg.norm(table.position["wrist_right"] - person.points[:, WRIST], axis=1)[seen]


def test_landmarks_in_space(scene):
    folder, person, t_s = scene
    (table,) = pose_video(folder / "pose.task").read(folder / "arm.mp4")
    np.testing.assert_allclose(table.t_s, t_s, atol=1e-3)
    assert table.frame is CameraFrame.OPTICAL and table.relative and table.units == "m"
    assert wrist_error_m(table, person).max() < TOLERANCE_M
    hidden = ~person.seen[:, WRIST]
    assert (table.state["wrist_right"][hidden] == JointState.INFERRED).all(), "visibility 0.05"
    assert any("not mirrored" in note and "--mirrored" in note for note in table.notes)


@pytest.mark.parametrize("by_file", [True, False])
@pytest.mark.parametrize(
    ("turn", "back"),
    [(cv2.ROTATE_90_COUNTERCLOCKWISE, 90), (cv2.ROTATE_180, 180), (cv2.ROTATE_90_CLOCKWISE, 270)],
)
def test_a_phone_held_upright(scene, tmp_path: Path, turn: int, back: int, by_file: bool):
    """Sideways pictures are turned as the file says, or as the user does where it does not."""
    folder, person, _ = scene
    few = Person(person.points[:30], person.seen[:30])
    video = write_video(tmp_path / "turned.mp4", [few], RATE_HZ, turn)
    camera = pose_video(folder / "pose.task", turn_deg=0 if by_file else back)
    if by_file:
        (asleep,) = camera.read(video)
        assert any(f"--turn {back}" in note for note in asleep.notes), "who lies is asked about"
        with_turn(video, back)
    (table,) = camera.read(video)
    assert wrist_error_m(table, few).max() < TOLERANCE_M
    assert not any("--turn" in note for note in table.notes)
    assert any(f"turned by {back} degrees" in note for note in table.notes) is by_file


def test_a_mirrored_front_camera(scene, tmp_path: Path):
    """In the mirror the right arm is a left one; `--mirrored` makes it right again."""
    folder, person, _ = scene
    video = write_video(tmp_path / "selfie.mp4", [person], RATE_HZ, turn=-1)
    (wrong,) = pose_video(folder / "pose.task").read(video)
    moves = {side: np.nanstd(wrong.position[f"wrist_{side}"][:, 1]) for side in ("left", "right")}
    assert moves["left"] > 5 * moves["right"]
    (table,) = pose_video(folder / "pose.task", mirrored=True).read(video)
    assert wrist_error_m(table, person).max() < TOLERANCE_M
    assert any("flipped left to right" in note for note in table.notes)


def test_a_variable_frame_rate(scene, tmp_path: Path):
    """Phones lengthen pictures in the dark: the container's times count, not the rate."""
    folder, person, _ = scene
    video = tmp_path / "dark.mp4"
    shutil.copy(folder / "arm.mp4", video)
    rng = np.random.default_rng(3)
    ticks = rng.integers(400, 1600, len(person.points))
    with_steps(video, ticks.tolist())
    (table,) = pose_video(folder / "pose.task").read(video)
    ratio = np.diff(table.t_s) / ticks[:-1]
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.05)
    assert any("variable frame rate" in note for note in table.notes)


def test_two_people_and_who_was_seen_first(scene, tmp_path: Path):
    """Each keeps a number, also where one is away for a while; MediaPipe itself gives none."""
    _, person, t_s = scene
    near = person.moved(-0.7)
    other = Person(np.repeat(person.points[:1], len(t_s), axis=0), np.ones_like(person.seen)).moved(0.75)
    other.seen[:10] = other.seen[30:40] = False
    write_video(tmp_path / "two.mp4", [near, other], RATE_HZ)
    model = write_model(tmp_path / "two.task", [near, other], t_s)
    one, two = pose_video(model).read(tmp_path / "two.mp4")
    assert (one.body, two.body) == (0, 1)
    assert wrist_error_m(one, person).max() < 2 * TOLERANCE_M
    there = two.state["elbow_right"] != JointState.NOT_TRACKED
    assert there.sum() == 40 and not there[:10].any() and not there[30:40].any()
    assert any("2 people" in note and "--body" in note for note in one.notes)
    (alone,) = pose_video(model, people=1).read(tmp_path / "two.mp4")
    assert not any("2 people" in note for note in alone.notes)


def test_nobody_in_the_video(scene, tmp_path: Path):
    folder, _, _ = scene
    video = write_video(tmp_path / "empty.mp4", [], RATE_HZ)
    with pytest.raises(RecordingError, match=r"empty\.mp4: no person was found in its pictures \(30\)"):
        pose_video(folder / "pose.task").read(video)


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
