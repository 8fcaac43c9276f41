"""Keypoints in images: in recordings, and imported by the real command with the lenses of a calibration."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib.intrinsics import Intrinsics, read_camera_file
from smoother.cli.run import run
from smoother.errors import CalibrationError, RecordingError
from smoother.io import open_recording, read_recording, write_recording
from smoother.io.recording.keypoints import lens_from_plain, lens_plain
from smoother.io.recording.streams import KnownLens
from smoother.io.tables.joints import BODY_25, COCO_17, joint_name
from smoother.recording import JointState, JointTracks, Recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.simulation.camera import FOCAL_PX


def made(rgb: str, **changes: object) -> Recording:
    settings = {"protocol": "random", "duration_s": 3.0, "rgb": rgb, **changes}
    return simulate_arm(ArmSimulation.preset("realistic", **settings), 911).recording


def test_a_distorted_lens_is_undone(tmp_path: Path) -> None:
    """Pixels through OpenCV's distortion give the rays that they came from."""
    recording = made("first")
    write_recording(recording, tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    lens = Intrinsics(1280, 720, 900.0, 905.0, 640.0, 350.0, (-0.1, 0.02, 1e-3, -1e-3, 0.0))
    rays = np.asarray(recording.arm.position).reshape(-1, 3)
    pixels = lens.pixels(rays).reshape(-1, 5, 2)
    (arm,) = file.arms
    arm.position[..., :2] = np.where(arm.state[..., None] > 0, pixels, np.nan)
    file.lenses = {arm.topic: KnownLens(lens)}
    write_recording(file, tmp_path / "b.mcap")
    read = read_recording(tmp_path / "b.mcap")
    np.testing.assert_allclose(read.arm.position, recording.arm.position, atol=1e-8)
    assert read.arm.pixel_rad == pytest.approx(1.0 / 902.5)


@pytest.mark.parametrize("width, height, refused", [(1280, 720, False), (640, 480, True), (480, 270, True)])
def test_keypoints_outside_the_stated_image_are_refused(
    tmp_path: Path, width: int, height: int, refused: bool
) -> None:
    write_recording(made("first"), tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    (topic,) = file.lenses
    lens = Intrinsics(width, height, 900.0, 900.0, 0.5 * width, 0.5 * height)
    file.lenses = {topic: KnownLens(lens)}
    file.arms[0].position[:, :, 0] += 320.0
    write_recording(file, tmp_path / "b.mcap")
    if not refused:
        assert read_recording(tmp_path / "b.mcap").arm.pixel_rad == pytest.approx(1 / 900)
        return
    with pytest.raises(RecordingError, match=f"{width} x {height} pixels; keypoints are at .* another mode"):
        read_recording(tmp_path / "b.mcap")


@pytest.mark.parametrize(
    "terms, stated, share",
    [({}, {}, 0.05), ({"k1": -0.1}, {}, 0.01), ({}, {"focal_share": 0.02}, 0.02)],
    ids=["data sheet", "calibrated", "stated"],
)
def test_how_well_a_focal_length_is_known(
    tmp_path: Path, terms: dict[str, float], stated: dict[str, float], share: float
) -> None:
    """By what the file states; kept through metadata and a recording that is written again."""
    values = (
        {"width": 1280, "height": 720, "fx": 900.0, "fy": 900.0, "cx": 640.0, "cy": 360.0} | terms | stated
    )
    path = tmp_path / "lens.toml"
    path.write_text("".join(f"{key} = {value}\n" for key, value in values.items()))
    lens = read_camera_file(path)[""].lens
    assert lens.focal_share == lens_from_plain(lens_plain(lens)).focal_share == share
    recording = made("first")
    arm = replace(recording.arm, focal_share=lens.focal_share)
    write_recording(replace(recording, arm=arm), tmp_path / "a.mcap")
    assert read_recording(tmp_path / "a.mcap").arm.focal_share == share


@pytest.mark.parametrize("share", [-0.1, 0.9, "much"])
def test_a_wrong_share_is_refused(tmp_path: Path, share: object) -> None:
    path = tmp_path / "lens.toml"
    path.write_text(f"fx = 900\nfy = 900\ncx = 640\ncy = 360\nfocal_share = {json.dumps(share)}\n")
    with pytest.raises(CalibrationError, match=r"lens\.toml"):
        read_camera_file(path)


def test_without_a_lens_by_score_and_beside_their_own_skeleton(tmp_path: Path) -> None:
    """As an import of a video writes them: of two, the skeleton that was made of the keypoints is taken."""
    path = tmp_path / "a.mcap"
    write_recording(made("first"), path)
    flat, file = open_recording(path), open_recording(path)
    file.arms[0].state[:] = JointState.TRACKED
    file.arms[0].position[...] = [640.0, 360.0, 0.9]
    file.arms[0].position[:3, 0, 2] = 0.05, 0.3, 0.5
    write_recording(file, path, force=True)
    states = open_recording(path).arms[0].state[:3, 0]
    assert states.tolist() == [JointState.NOT_TRACKED, JointState.INFERRED, JointState.TRACKED]
    file.lenses = {}
    write_recording(file, path, force=True)
    again = open_recording(path)
    assert not again.arms and any("lens is not known" in note for note in again.notes)
    with pytest.raises(RecordingError, match="skeleton"):
        read_recording(path)
    write_recording(made("none"), path, force=True)
    both = open_recording(path)
    both.arms += flat.arms
    both.lenses = flat.lenses
    write_recording(both, path, force=True)
    read = read_recording(path)
    assert (read.arm.name, read.cameras) == ("/skeleton", ())
    assert read_recording(path, skeleton="/camera/keypoints_2d").arm.pixel_rad is not None


def test_a_lens_as_plain_values() -> None:
    lens = Intrinsics(1280, 720, 900.0, 905.0, 640.0, 350.0, (-0.1, 0.02, 0.0, 0.0, 0.0))
    assert lens_from_plain(lens_plain(lens)) == lens
    with pytest.raises(ValueError, match="not a key"):
        lens_from_plain({**lens_plain(lens), "focus": 1.0})
    with pytest.raises(ValueError, match="above zero"):
        lens_from_plain({**lens_plain(replace(lens, fx=-1.0))})


LENS = np.array([[FOCAL_PX, 0.0, 639.5], [0.0, FOCAL_PX, 359.5], [0.0, 0.0, 1.0]])


def keypoints(arm: JointTracks, names: list[str]) -> list[list[float]]:
    """u, v and score of a set of points by frame; zeros for those that are not there."""
    table = np.zeros((len(arm), len(names), 3))
    for at, name in enumerate(names):
        meaning = joint_name(name)
        if meaning is not None and meaning.joint in ("shoulder_right", "elbow_right", "wrist_right"):
            joint = meaning.joint.removesuffix("_right")
            seen = arm.tracked(joint)
            pixels = FOCAL_PX * arm.joint(joint)[:, :2] + LENS[:2, 2]
            table[seen, at] = np.column_stack([pixels[seen], np.full(seen.sum(), 0.9)])
    return [row.ravel().tolist() for row in table]


@pytest.fixture(scope="module")
def simulated() -> SimulatedArm:
    config = ArmSimulation.preset(
        "realistic", protocol="random", duration_s=6.0, rgb="all", cameras=(75.0,), side="right"
    )
    return simulate_arm(config, 960)


@pytest.fixture
def folder(simulated: SimulatedArm, tmp_path: Path) -> Path:
    recording = simulated.recording
    (camera,) = recording.cameras
    frames = [
        {"timestamp_s": float(t), "people": [{"pose_keypoints_2d": row}]}
        for t, row in zip(recording.arm.t_s, keypoints(recording.arm, BODY_25), strict=True)
    ]
    (tmp_path / "front.json").write_text(json.dumps(frames))
    coco: list[dict[str, Any]] = [
        {"image_id": at, "category_id": 1, "keypoints": row, "score": 0.9}
        for at, row in enumerate(keypoints(camera.arm, COCO_17))
    ]
    (tmp_path / "side.json").write_text(json.dumps(coco))
    imu = recording.imu
    rows = np.column_stack([imu.t_s, imu.acc, imu.gyro])
    head = "t_s,acc_x_m/s^2,acc_y_m/s^2,acc_z_m/s^2,gyro_x_rad/s,gyro_y_rad/s,gyro_z_rad/s"
    np.savetxt(tmp_path / "imu.csv", rows, delimiter=",", header=head, comments="")
    assert camera.pose is not None
    R, p = camera.pose.R_K_C, camera.pose.p_K_C_m
    from scipy.spatial.transform import Rotation

    places = [(np.zeros(3), np.zeros(3)), (Rotation.from_matrix(R.T).as_rotvec(), -R.T @ p)]
    (tmp_path / "Calib.toml").write_text(
        "".join(
            f'[cam_{at}]\nname = "{name}"\nsize = [1280.0, 720.0]\nmatrix = {LENS.tolist()}\n'
            f"distortions = [0.0, 0.0, 0.0, 0.0]\nrotation = {turn.tolist()}\ntranslation = {t.tolist()}\n"
            for at, (name, (turn, t)) in enumerate(zip(("front", "side"), places, strict=True))
        )
    )
    return tmp_path


def command(folder: Path, *more: str) -> int:
    return run(
        ["import", "files", "--skeleton", f"front={folder / 'front.json'}", "--skeleton",
         f"side={folder / 'side.json'}", "--imu", f"forearm_right={folder / 'imu.csv'}", *more,
         "-o", str(folder / "rec.mcap")]
    )  # fmt: skip


def test_rays_and_places_come_back(
    simulated: SimulatedArm, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(folder, "--intrinsics", str(folder / "Calib.toml")) == 0, capsys.readouterr().err
    assert "front.json: MediaPipe or OpenPose" in capsys.readouterr().out
    file = open_recording(folder / "rec.mcap")
    assert sorted({arm.topic for arm in file.arms}) == ["/camera/keypoints_2d", "/camera/side/keypoints_2d"]
    read, true = read_recording(folder / "rec.mcap"), simulated.recording
    (camera,), (expected,) = read.cameras, true.cameras
    assert camera.name == "side"
    assert camera.pose is not None
    assert expected.pose is not None
    np.testing.assert_allclose(camera.pose.R_K_C, expected.pose.R_K_C, atol=1e-9)
    np.testing.assert_allclose(camera.pose.p_K_C_m, expected.pose.p_K_C_m, atol=1e-9)
    for back, sent in ((read.arm, true.arm), (camera.arm, expected.arm)):
        assert back.pixel_rad == pytest.approx(1 / FOCAL_PX)
        for joint in ("shoulder", "elbow", "wrist"):
            rows = sent.tracked(joint)
            np.testing.assert_array_equal(back.tracked(joint), rows)
            np.testing.assert_allclose(back.joint(joint)[rows], sent.joint(joint)[rows], atol=1e-9)


def test_without_a_lens_it_says_what_to_give(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(folder) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "front.json contains keypoints in the image, which need the camera's lens, front" in said
    assert "--intrinsics FILE" in said
    text = (folder / "Calib.toml").read_text()
    (folder / "other.toml").write_text(text.replace('"side"', '"left"'))
    assert command(folder, "--intrinsics", str(folder / "other.toml")) == 1
    assert "need the camera's lens, side: give --intrinsics FILE (it contains 'front', 'left')" in " ".join(
        capsys.readouterr().err.split()
    )
