"""Further cameras in files: written and read back, from plain files and from files of devices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.imports import skeleton_file
from smoother.errors import UnoccludeError
from smoother.io import import_csv, open_recording, read_recording, write_recording
from smoother.recording import JOINTS, JointState, Recording
from smoother.simulation import ArmSimulation, simulate_arm


def made() -> Recording:
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=4.0, cameras=(70.0, -60.0))
    return simulate_arm(config, 910).recording


def test_cameras_of_a_written_recording_are_read_back(tmp_path: Path) -> None:
    recording = made()
    down = np.array([0.0, -1.0, 0.0])
    first, second = recording.cameras
    recording = replace(recording, cameras=(replace(first, gravity_hint=down), second))
    write_recording(recording, tmp_path / "a.mcap")
    read = read_recording(tmp_path / "a.mcap")
    assert [camera.name for camera in read.cameras] == ["camera_2", "camera_3"]
    for camera, written in zip(read.cameras, recording.cameras, strict=True):
        np.testing.assert_allclose(camera.arm.t_s, written.arm.t_s, atol=1e-9)
        np.testing.assert_allclose(camera.arm.position, written.arm.position)
        assert camera.camera_frame == written.camera_frame
    np.testing.assert_allclose(read.cameras[0].gravity_hint, down)  # type: ignore[arg-type]
    assert read.arm.name == "/skeleton"


def test_a_skeleton_that_is_named_is_taken_alone(tmp_path: Path) -> None:
    write_recording(made(), tmp_path / "a.mcap")
    read = read_recording(tmp_path / "a.mcap", skeleton="/skeleton/camera_3")
    assert read.arm.name == "/skeleton/camera_3"
    assert not read.cameras


def test_skeletons_of_several_frames_are_several_cameras_in_any_file(tmp_path: Path) -> None:
    """As a recorder of somebody else writes them: nothing names the cameras but their frames."""
    recording = made()
    write_recording(recording, tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    file.cameras = {}
    for arm, name in zip(file.arms, ("left", "middle", "right"), strict=True):
        arm.topic, arm.frame_id = f"/{name}/bodies", f"{name}_depth"
    file.arms[1].state = np.minimum(file.arms[1].state, JointState.INFERRED)  # hardly ever tracked
    file.arms[1].state[:5] = JointState.TRACKED
    write_recording(file, tmp_path / "b.mcap")
    read = read_recording(tmp_path / "b.mcap")
    assert read.arm.name in ("/left/bodies", "/right/bodies")
    assert len(read.cameras) == 2
    assert {camera.name for camera in read.cameras} < {"left_depth", "middle_depth", "right_depth"}


TABLE = "t_s,joint,x,y,z,state\n"


def write_skeleton(path: Path, moved_m: float) -> None:
    rows = [
        f"{0.1 * k:.2f},{joint},{0.1 * n + moved_m},{0.01 * k},2.0,tracked"
        for k in range(20)
        for n, joint in enumerate(("shoulder", "elbow", "wrist"))
    ]
    path.write_text(TABLE + "\n".join(rows) + "\n")


def write_folder(folder: Path, cameras: str) -> None:
    write_skeleton(folder / "skeleton.csv", 0.0)
    write_skeleton(folder / "left.csv", 0.5)
    imu = [f"{0.02 * k:.2f},0,9.8,0,{0.1 * k % 1},0,0" for k in range(100)]
    (folder / "imu.csv").write_text("t_s,ax,ay,az,gx,gy,gz\n" + "\n".join(imu) + "\n")
    (folder / "recording.toml").write_text(cameras + '[imu.forearm]\nfile = "imu.csv"\n')


FIRST = '[camera]\nskeleton = "skeleton.csv"\nframe = "kinect"\n'
LEFT = '[camera.left]\nskeleton = "left.csv"\nframe = "optical"\ngravity = [0, 1, 0]\n'


def test_a_recording_toml_may_have_several_cameras(tmp_path: Path) -> None:
    write_folder(tmp_path, FIRST + LEFT)
    recording = import_csv(tmp_path)
    (left,) = recording.cameras
    assert left.name == "left"
    assert left.camera_frame == "optical"
    np.testing.assert_allclose(left.gravity_hint, [0, 1, 0])  # type: ignore[arg-type]
    apart = left.arm.position - recording.arm.position
    np.testing.assert_allclose(apart[:, JOINTS.index("wrist"), 0], 0.5)


def test_without_a_camera_of_its_own_the_first_named_one_is_it(tmp_path: Path) -> None:
    write_folder(tmp_path, LEFT)
    recording = import_csv(tmp_path)
    assert not recording.cameras
    assert recording.camera_frame == "optical"


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ('[camera.left]\nframe = "kinect"\n', "names no skeleton"),
        (LEFT.replace("[0, 1, 0]", "[0, 0, 0]"), r"\[camera.left\] gravity"),
        (LEFT.replace("skeleton", "skelton"), "is not known here"),
        (LEFT.replace("left.csv", "../left.csv"), "outside"),
    ],
)
def test_what_is_wrong_with_a_further_camera_is_named(tmp_path: Path, section: str, words: str) -> None:
    write_folder(tmp_path, FIRST + section)
    with pytest.raises(UnoccludeError, match=words):
        import_csv(tmp_path)


def test_a_skeleton_option_may_name_its_camera(tmp_path: Path) -> None:
    file = tmp_path / "left=1.csv"
    assert skeleton_file(f"left={file}") == ("left", file)
    file.write_text("")
    assert skeleton_file(str(file)) == ("", file)
    with pytest.raises(UnoccludeError, match="NAME=FILE"):
        skeleton_file("=a.csv")
