"""Keypoints in images, imported by the real command with the lenses of a calibration file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smoother.cli.run import run
from smoother.io import open_recording, read_recording
from smoother.io.tables.joint_columns import BODY_25, COCO_17, joint_name
from smoother.recording import JointTracks
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.simulation.camera import FOCAL_PX

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
