"""Further cameras, and IMUs on the upper arm and the trunk: from files to a recording and back."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from importers import select_recording
from made_recordings import make
from made_results import assert_same as assert_same_result
from made_results import recovery as made_recovery

from smoother.array_types import FloatArray
from smoother.calibration import LeverArm, SegmentMounting
from smoother.cli.imports import skeleton_file
from smoother.errors import UnoccludeError
from smoother.io import (
    describe,
    open_recording,
    read_recording,
    read_recovery,
    write_recording,
    write_recovery,
)
from smoother.io.export.prepare import export_csv
from smoother.io.recording.choose import choose_arms
from smoother.io.recording.write import as_file
from smoother.recording import FOREARM_JOINTS, ImuStream, JointState, Recording, TrunkSensors
from smoother.result import Recovery, SegmentMotion, TrunkMotion
from smoother.simulation import ArmSimulation, simulate_arm


def two_cameras() -> Recording:
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=4.0, cameras=(70.0, -60.0))
    return simulate_arm(config, 910).recording


def test_cameras_of_a_written_recording_are_read_back(tmp_path: Path) -> None:
    recording, path = two_cameras(), tmp_path / "a.mcap"
    down = np.array([0.0, -1.0, 0.0])
    first, second = recording.cameras
    recording = replace(recording, cameras=(replace(first, gravity_hint=down), second))
    write_recording(recording, path)
    read = read_recording(path)
    assert [camera.name for camera in read.cameras] == ["camera_2", "camera_3"]
    for camera, written in zip(read.cameras, recording.cameras, strict=True):
        np.testing.assert_allclose(camera.arm.t_s, written.arm.t_s, atol=1e-9)
        np.testing.assert_allclose(camera.arm.position, written.arm.position)
        assert camera.camera_frame == written.camera_frame
    np.testing.assert_allclose(read.cameras[0].gravity_hint, down)  # type: ignore[arg-type]
    assert read.arm.name == "/skeleton"
    named = read_recording(path, skeleton="/skeleton/camera_3")
    assert named.arm.name == "/skeleton/camera_3" and not named.cameras


def test_skeletons_of_several_frames_are_several_cameras_in_any_file(tmp_path: Path) -> None:
    """As a recorder of somebody else writes them: nothing names the cameras but their frames."""
    recording = two_cameras()
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


def test_a_skeleton_option_may_name_its_camera(tmp_path: Path) -> None:
    file = tmp_path / "left=1.csv"
    assert skeleton_file(f"left={file}") == ("left", file)
    file.write_text("")
    assert skeleton_file(str(file)) == ("", file)
    with pytest.raises(UnoccludeError, match="NAME=FILE"):
        skeleton_file("=a.csv")


def with_upper(name: str = "/imu/upper_arm_right", side: str = "right") -> Recording:
    made = make(side=side)
    imu = made.imu
    return made.with_imu("upper_arm", ImuStream(name, imu.t_s + 0.25, imu.acc + 0.1, 0.5 * imu.gyro))


@pytest.mark.parametrize("name", ["/imu/upper_arm_right", "Sensor 00B4"])  # written as the upper arm's
def test_round_trip(tmp_path: Path, name: str) -> None:
    made = with_upper(name)
    write_recording(made, tmp_path / "a.mcap")
    back = read_recording(tmp_path / "a.mcap")
    assert back.upper_imu is not None and made.upper_imu is not None
    assert back.imu.name == "/imu/forearm_right" and back.upper_imu.name == "/imu/upper_arm_right"
    np.testing.assert_array_equal(np.rint(back.upper_imu.t_s * 1e9), np.rint(made.upper_imu.t_s * 1e9))
    np.testing.assert_array_equal(back.upper_imu.acc, made.upper_imu.acc)
    np.testing.assert_array_equal(back.upper_imu.gyro, made.upper_imu.gyro)
    assert any("upper_arm_right is on the same arm" in note for note in back.notes)
    assert describe(tmp_path / "a.mcap")["arms"][0]["upper_imu"] == "/imu/upper_arm_right"


@pytest.mark.parametrize(
    ("name", "is_taken"),
    [("/imu/upper_arm", True), ("/imu/upperArmRight", True), ("/imu/upper_arm_left", False)],
)
def test_which_one_is_meant(name: str, is_taken: bool) -> None:
    file = as_file(with_upper())
    file.imus[1] = replace(file.imus[1], topic=name, frame_id="")
    assert ("upper_arm" in choose_arms(file, alone=True)[0][0].further) == is_taken


def turns(count: int, rng: np.random.Generator) -> FloatArray:
    quaternion = rng.normal(size=(count, 4))
    return quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)


def result() -> Recovery:
    made = made_recovery()
    rng = np.random.default_rng(3)
    root = rng.normal(size=(len(made), 6, 6))
    upper = SegmentMotion(
        rng.normal(size=(len(made), 3)),
        turns(len(made), rng),
        1e-4 * root @ root.transpose(0, 2, 1),
        np.array([0.02, 0.05, 0.02]),
        0.123,
        "/imu/upper_arm_right",
    )
    for values in (upper.position, upper.quaternion, upper.pose_covariance):
        values[30:35] = np.nan
    assert made.calibration is not None
    levers = {joint: LeverArm(rng.normal(size=3), np.full(3, 0.01)) for joint in ("elbow", "shoulder")}
    calibration = replace(
        made.calibration,
        mountings={"upper_arm": SegmentMounting(levers, R_bone=np.diag([1.0, -1.0, -1.0]))},
    )
    return replace(
        made,
        segments={"upper_arm": upper},
        calibration=calibration,
        gravity_direction=np.array([0.0, -1.0, 0.0]),
    )


def rows_of_csv(recovery: Recovery, path: Path) -> list[dict[str, str]]:
    export_csv(recovery, path)
    return list(csv.DictReader(path.read_text().splitlines()))


def test_columns(tmp_path: Path) -> None:
    made = result()
    rows = rows_of_csv(made, tmp_path / "a.csv")
    assert made.upper is not None
    assert [float(rows[10][f"upper_imu_{axis}"]) for axis in "xyz"] == pytest.approx(made.upper.position[10])
    assert float(rows[10]["upper_imu_qw"]) == pytest.approx(made.upper.quaternion[10, 0], abs=1e-8)
    assert float(rows[10]["upper_sigma_deg"]) == pytest.approx(made.upper.sigma_deg[10], abs=1e-8)
    for name in ("plane", "elevation", "rotation"):
        assert np.isfinite(float(rows[10][f"shoulder_{name}_deg"]))
        assert float(rows[10][f"shoulder_{name}_sigma_deg"]) > 0.0
    assert rows[31]["upper_imu_x"] == ""  # it pauses there, and the skeleton alone has the shoulder's angles
    by_joints = replace(made, segments={}).angles()
    for name in ("plane", "elevation", "rotation"):
        assert float(rows[31][f"shoulder_{name}_deg"]) == pytest.approx(
            by_joints.values[f"shoulder_{name}"][31]
        )
    assert list(rows[0])[-1] == "usable"


def with_trunk(side: str = "right") -> Recording:
    made = make(side=side)
    imu, arm = made.imu, made.arm
    other = replace(arm, position=arm.position + np.array([0.36, 0.0, 0.0]))
    other = other.hide(np.ones(len(other), bool), FOREARM_JOINTS)  # as the simulation has it
    return replace(
        made, trunk=TrunkSensors(ImuStream("/imu/trunk", imu.t_s, 0.5 * imu.acc, 0.1 * imu.gyro), other)
    )


@pytest.mark.parametrize("side", ["left", "right"])
def test_round_trip_with_the_trunk(tmp_path: Path, side: str) -> None:
    made = with_trunk(side)
    write_recording(made, tmp_path / "a.mcap")
    back = read_recording(tmp_path / "a.mcap")
    assert back.trunk is not None and made.trunk is not None
    assert back.side == side and back.imu.name == f"/imu/forearm_{side}"
    np.testing.assert_array_equal(back.trunk.imu.acc, made.trunk.imu.acc)
    np.testing.assert_array_equal(back.trunk.imu.gyro, made.trunk.imu.gyro)
    assert back.trunk.other_arm is not None and made.trunk.other_arm is not None
    tracked = made.trunk.other_arm.tracked("shoulder")
    assert tracked.any()
    np.testing.assert_array_equal(back.trunk.other_arm.tracked("shoulder"), tracked)
    np.testing.assert_array_equal(
        back.trunk.other_arm.joint("shoulder")[tracked], made.trunk.other_arm.joint("shoulder")[tracked]
    )
    assert any("is on the trunk by its name" in note for note in back.notes)
    assert describe(tmp_path / "a.mcap")["arms"][0]["trunk_imu"] == "/imu/trunk"


def test_both_arms_share_the_trunk() -> None:
    """Each arm's other arm is the one with the other IMU, whole."""
    file = as_file([with_trunk("right"), with_trunk("left")])
    assert sum(imu.topic == "/imu/trunk" for imu in file.imus) == 1
    for side in ("left", "right"):
        one = select_recording(file, side=side)
        assert one.side == side and one.trunk is not None and one.trunk.other_arm is not None
        assert "wrist" in one.trunk.other_arm.present


def test_an_arm_alone_and_two_trunks(tmp_path: Path) -> None:
    made = with_trunk()
    assert made.trunk is not None
    file = as_file(replace(made, trunk=TrunkSensors(made.trunk.imu)))
    alone = select_recording(file)
    assert alone.trunk is not None and alone.trunk.other_arm is None
    (trunk,) = (imu for imu in file.imus if imu.topic == "/imu/trunk")
    file.imus.append(replace(trunk, topic="/imu/chest"))
    both = select_recording(file)
    assert both.trunk is None
    assert any("/imu/trunk, /imu/chest none was taken" in note for note in both.notes)


def trunk_of(count: int) -> TrunkMotion:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(count, 3, 3))
    covariance = 1e-3 * root @ root.transpose(0, 2, 1)
    motion = TrunkMotion(turns(count, rng), covariance, np.eye(3), np.full(3, 0.02), 0.05, "/imu/trunk")
    for values in (motion.quaternion, motion.covariance):
        values[40:44] = np.nan
    return motion


def test_a_result_keeps_both(tmp_path: Path) -> None:
    made = replace(result(), trunk=trunk_of(len(result())))
    write_recovery(made, tmp_path / "a.mcap")
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert_same_result(made, back)
    assert made.trunk is not None
    rows = rows_of_csv(replace(back, segments={}), tmp_path / "a.csv")
    assert float(rows[10]["trunk_qw"]) == pytest.approx(made.trunk.quaternion[10, 0], abs=1e-8)
    assert float(rows[10]["trunk_sigma_deg"]) == pytest.approx(made.trunk.sigma_deg[10], abs=1e-8)
    assert rows[41]["trunk_qw"] == "" and list(rows[0])[-1] == "usable"
    # no IMU on the upper arm: the shoulder's angles against the trunk are the skeleton's
    assert np.isfinite(float(rows[10]["shoulder_plane_trunk_deg"]))
    assert rows[41]["shoulder_plane_trunk_deg"] == ""
