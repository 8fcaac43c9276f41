"""Orientations for OpenSense, read back plainly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from results import made, without_answer
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration, SegmentMounting
from smoother.errors import UnoccludeError
from smoother.io import write_recovery
from smoother.io.export.prepare import prepare_export
from smoother.result import Recovery, SegmentMotion, TrunkMotion

R_F_A = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_matrix()
R_U_B = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
UPPER_M, FORE_M = 0.31, 0.25


def two_imus(side: str = "right", count: int = 60) -> Recovery:
    """A rigid arm in front of a level Kinect, with an IMU on forearm and upper arm, moved by known angles.

    The geometry is written out here: the humerus turns R_y(a) R_x(-b) R_y(c - a), the elbow bends about z,
    the forearm turns about its bone; x forward, y up, z to the right. A left arm is the mirror image.
    """
    t = np.arange(count) / 50.0
    a, b, c = np.radians(40 + 30 * np.sin(t)), np.radians(60 + 25 * np.sin(2 * t)), np.radians(-20 + 40 * t)
    bend, turn = np.radians(70 + 40 * np.cos(3 * t)), np.radians(-30 + 50 * np.sin(2.5 * t))

    def about(axis: str, angle: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(angle[:, None] * np.eye(3)["xyz".index(axis)])

    humerus = about("y", a) * about("x", -b) * about("y", c - a)
    radius = humerus * about("z", bend) * about("y", turn)
    elbow = humerus.apply([0.0, -UPPER_M, 0.0])
    wrist = elbow + radius.apply([0.0, -FORE_M, 0.0])
    # {F}: y elbow to wrist, x to the back of the hand, which at pro_sup 0 (thumb up) faces right
    F = np.stack([radius.apply(axis) for axis in ([0, 0, 1], [0, -1, 0], [1, 0, 0])], axis=2)
    U = humerus.as_matrix()
    to_K = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # who faces the camera
    if side == "left":
        flip = np.diag([1.0, 1.0, -1.0])
        elbow, wrist = elbow @ flip, wrist @ flip
        F = flip @ F @ np.diag([1.0, 1.0, -1.0])  # z is x cross y, whichever the hand
        U = flip @ U @ np.diag([-1.0, 1.0, 1.0])  # z to the lateral epicondyle, x = y cross z
    place = np.array([0.1, 0.2, 2.0])
    base = made(side).rows(slice(0, count))
    q_A = Rotation.from_matrix(to_K @ F @ R_F_A).as_quat(scalar_first=True)
    q_B = Rotation.from_matrix(to_K @ U @ R_U_B).as_quat(scalar_first=True)
    at = place + (0.9 * wrist + 0.1 * elbow) @ to_K.T
    joints = {
        "shoulder": np.tile(place, (count, 1)),
        "elbow": place + elbow @ to_K.T,
        "wrist": place + wrist @ to_K.T,
    }
    upper = SegmentMotion(joints["elbow"], q_B, np.zeros((count, 6, 6)), np.zeros(3))
    return replace(
        base,
        t_s=t,
        position=at,
        quaternion=q_A,
        joints=joints,
        joint_covariance={},
        segments={"upper_arm": upper},
        calibration=ArmCalibration(
            side=side, R_F_A=R_F_A, mountings={"upper_arm": SegmentMounting({}, R_bone=R_U_B)}
        ),
        gravity_direction=np.array([0.0, -1.0, 0.0]),
        gaps=(),
        residuals=None,
    )


def read_sto(path: Path) -> tuple[dict[str, str], np.ndarray, dict[str, np.ndarray]]:
    """A plain reading: header, times, quaternions by column."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    names = lines[end + 1].split("\t")
    rows = [line.split("\t") for line in lines[end + 2 :]]
    cells = {
        name: np.array([[float(part) for part in row[k].split(",")] for row in rows])
        for k, name in enumerate(names)
    }
    return dict(line.split("=") for line in lines[:end]), cells.pop("time")[:, 0], cells


def written(recovery: Recovery, path: Path) -> Path:
    prepare_export(recovery, "sto").write(path, False)
    return path


def test_what_is_written_is_the_motion_in_y_up_axes(tmp_path: Path):
    recovery = two_imus()
    header, t_s, columns = read_sto(written(recovery, tmp_path / "a.sto"))
    assert header == {"DataRate": "50.000000", "DataType": "Quaternion", "version": "3"}
    assert list(columns) == ["radius_imu", "humerus_imu"]
    np.testing.assert_allclose(t_s, recovery.t_s, atol=1e-9)
    R_O_K = np.array(
        [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    )  # z of a Kinect points away from it
    for name, answer in (("radius_imu", recovery.quaternion), ("humerus_imu", recovery.upper.quaternion)):
        R_K_S = Rotation.from_quat(answer, scalar_first=True).as_matrix()
        found = Rotation.from_quat(columns[name], scalar_first=True).as_matrix()
        np.testing.assert_allclose(found, R_O_K @ R_K_S, atol=1e-7)
        assert np.all(np.einsum("ni,ni->n", columns[name][1:], columns[name][:-1]) > 0.9)  # no jump of sign


def test_rows_without_an_orientation_are_left_out_and_counted(tmp_path: Path):
    recovery = without_answer(two_imus(), 0.3, 0.5)
    export = prepare_export(recovery, "sto")
    _, t_s, columns = read_sto(written(recovery, tmp_path / "a.sto"))
    gone = int(((recovery.t_s > 0.3) & (recovery.t_s < 0.5)).sum())
    assert gone > 5 and len(t_s) == export.rows == len(recovery) - gone
    assert not ((t_s > 0.3) & (t_s < 0.5)).any()
    assert f"{gone} of {len(recovery)} samples are left out" in export.notes[0]
    assert all(np.isfinite(values).all() for values in columns.values())


def test_a_trunk_and_one_imu_alone(tmp_path: Path):
    recovery = two_imus()
    turned = Rotation.from_rotvec([0.0, 0.4, 0.0]).as_quat(scalar_first=True)
    trunk = TrunkMotion(
        np.tile(turned, (len(recovery), 1)), np.zeros((len(recovery), 3, 3)), np.eye(3), np.zeros(3)
    )
    *_, columns = read_sto(written(replace(recovery, trunk=trunk), tmp_path / "a.sto"))
    assert list(columns) == ["radius_imu", "humerus_imu", "torso_imu"]
    alone = prepare_export(replace(recovery, segments={}), "sto")
    assert any("does not show OpenSense how the elbow is bent" in note for note in alone.notes)
    assert not prepare_export(recovery, "sto").notes


def test_nothing_to_write_is_said():
    with pytest.raises(UnoccludeError, match="there is none of the forearm"):
        prepare_export(without_answer(two_imus(), -1.0, 100.0), "sto")


def test_the_command_of_orientations(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_recovery(made(), tmp_path / "out.mcap")
    command = ["export", str(tmp_path / "out.mcap"), "--format", "sto", "-o", str(tmp_path / "out.sto")]
    done(*command, "--json", tmp_path / "s.json")
    assert "take trc and Inverse Kinematics" in capsys.readouterr().out
    [figures] = json.loads((tmp_path / "s.json").read_text())["files"]
    assert figures["frame"] == "opensim" and figures["rows"] == len(read_sto(tmp_path / "out.sto")[1])
    said = refused(capsys, *command, "--force", "--rate", "50", code=2)
    assert "--rate is for trc, mot, c3d, not for sto" in said
