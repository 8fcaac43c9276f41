"""An upper-arm IMU in files: found by its name, written and read back, in results and exports."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import make
from made_results import recovery as made_recovery

from smoother.calibration import LeverArm
from smoother.io import (
    describe,
    export_csv,
    open_recording,
    read_recording,
    read_recovery,
    select_recording,
    write_recording,
    write_recovery,
)
from smoother.io.recording.assign import choose
from smoother.io.recording.streams import RecordingFile
from smoother.recording import ImuStream, Recording
from smoother.result import Recovery
from smoother.result.upper_motion import UpperMotion


def with_upper(name: str = "/imu/upper_arm_right", side: str = "right") -> Recording:
    made = make(side=side)
    imu = made.imu
    return replace(made, upper_imu=ImuStream(name, imu.t_s + 0.25, imu.acc + 0.1, 0.5 * imu.gyro))


def test_round_trip(tmp_path: Path) -> None:
    made = with_upper()
    write_recording(made, tmp_path / "a.mcap")
    back = read_recording(tmp_path / "a.mcap")
    assert back.upper_imu is not None and made.upper_imu is not None
    assert back.imu.name == "/imu/forearm_right" and back.upper_imu.name == "/imu/upper_arm_right"
    np.testing.assert_array_equal(np.rint(back.upper_imu.t_s * 1e9), np.rint(made.upper_imu.t_s * 1e9))
    np.testing.assert_array_equal(back.upper_imu.acc, made.upper_imu.acc)
    np.testing.assert_array_equal(back.upper_imu.gyro, made.upper_imu.gyro)
    assert any("upper_arm_right is on the same arm" in note for note in back.notes)
    assert describe(tmp_path / "a.mcap").upper_imu == "/imu/upper_arm_right"


def test_any_name_is_written_as_the_upper_arms(tmp_path: Path) -> None:
    write_recording(with_upper("Sensor 00B4"), tmp_path / "a.mcap")
    back = read_recording(tmp_path / "a.mcap")
    assert back.upper_imu is not None and back.upper_imu.name == "/imu/upper_arm_right"


def renamed(file: RecordingFile, **names: str) -> RecordingFile:
    imus = [
        replace(imu, topic=names.get(imu.topic.rpartition("/")[2], imu.topic), frame_id="")
        for imu in file.imus
    ]
    return replace(file, imus=imus)


@pytest.mark.parametrize(
    ("name", "is_taken"),
    [("/imu/upper_arm", True), ("/imu/upperArmRight", True), ("/imu/upper_arm_left", False)],
)
def test_which_one_is_meant(tmp_path: Path, name: str, is_taken: bool) -> None:
    write_recording(with_upper(), tmp_path / "a.mcap")
    file = renamed(open_recording(tmp_path / "a.mcap"), upper_arm_right=name)
    assert (choose(file).upper is not None) == is_taken


def test_both_arms_each_take_their_own(tmp_path: Path) -> None:
    both = [with_upper(), replace(with_upper("/imu/upper_arm_left", "left"))]
    write_recording(both, tmp_path / "a.mcap")
    file = open_recording(tmp_path / "a.mcap")
    for side in ("left", "right"):
        one = select_recording(file, side=side)
        assert one.upper_imu is not None
        assert (one.imu.name, one.upper_imu.name) == (f"/imu/forearm_{side}", f"/imu/upper_arm_{side}")


def result() -> Recovery:
    made = made_recovery()
    rng = np.random.default_rng(3)
    root = rng.normal(size=(len(made), 6, 6))
    quaternion = rng.normal(size=(len(made), 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    upper = UpperMotion(
        rng.normal(size=(len(made), 3)),
        quaternion,
        1e-4 * root @ root.transpose(0, 2, 1),
        np.array([0.02, 0.05, 0.02]),
        0.123,
        "/imu/upper_arm_right",
    )
    for values in (upper.position, upper.quaternion, upper.pose_covariance):
        values[30:35] = np.nan
    assert made.calibration is not None
    levers = {joint: LeverArm(rng.normal(size=3), np.full(3, 0.01)) for joint in ("elbow", "shoulder")}
    calibration = replace(made.calibration, upper_imu=levers, R_U_B=np.diag([1.0, -1.0, -1.0]))
    return replace(made, upper=upper, calibration=calibration, gravity_direction=np.array([0.0, -1.0, 0.0]))


def test_a_result_keeps_it(tmp_path: Path) -> None:
    made = result()
    write_recovery(made, tmp_path / "a.mcap")
    (back,) = read_recovery(tmp_path / "a.mcap")
    assert back.upper is not None and made.upper is not None
    assert back.calibration is not None and made.calibration is not None
    np.testing.assert_array_equal(back.upper.position, made.upper.position)
    np.testing.assert_allclose(back.upper.quaternion, made.upper.quaternion, atol=1e-12)
    np.testing.assert_array_equal(back.upper.pose_covariance, made.upper.pose_covariance)
    np.testing.assert_array_equal(back.upper.mount_sigma_rad, made.upper.mount_sigma_rad)
    assert (back.upper.clock_offset_s, back.upper.name) == (0.123, "/imu/upper_arm_right")
    for joint, lever in made.calibration.upper_imu.items():
        np.testing.assert_array_equal(back.calibration.upper_imu[joint].position_m, lever.position_m)
    np.testing.assert_array_equal(back.calibration.R_U_B, made.calibration.R_U_B)


def test_columns(tmp_path: Path) -> None:
    made = result()
    export_csv(made, tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert made.upper is not None
    assert [float(rows[10][f"upper_imu_{axis}"]) for axis in "xyz"] == pytest.approx(made.upper.position[10])
    assert float(rows[10]["upper_imu_qw"]) == pytest.approx(made.upper.quaternion[10, 0], abs=1e-8)
    assert float(rows[10]["upper_sigma_deg"]) == pytest.approx(made.upper.sigma_deg[10], abs=1e-8)
    for name in ("plane", "elevation", "rotation"):
        assert np.isfinite(float(rows[10][f"shoulder_{name}_deg"]))
        assert float(rows[10][f"shoulder_{name}_sigma_deg"]) > 0.0
    assert rows[31]["upper_imu_x"] == "" and rows[31]["shoulder_plane_deg"] == ""
    assert list(rows[0])[-1] == "usable"


def test_without_one_the_columns_are_as_before(tmp_path: Path) -> None:
    export_csv(made_recovery(), tmp_path / "a.csv")
    assert "upper" not in (tmp_path / "a.csv").read_text().splitlines()[0]
