"""Skeletons in TRC and C3D files: names of markers, what is taken, which way is up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import skeleton_files as made
from numpy.testing import assert_allclose, assert_array_equal

from smoother.errors import RecordingError
from smoother.io.devices.registry import recognise
from smoother.io.tables.joint_columns import AZURE, BODY_25, JointName, joint_name
from smoother.io.tables.protocol import read_head
from smoother.recording import CameraFrame, JointState

FRAMES = 30


def read(path: Path, key: str):
    importer = recognise(read_head(path))
    assert importer is not None
    assert importer.key == key
    (table,) = importer.read(path)
    return table


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("RWrist", JointName("wrist", "right")),
        ("WRIST_RIGHT", JointName("wrist", "right")),
        ("K4ABT_JOINT_ELBOW_LEFT", JointName("elbow", "left")),
        ("JointType_HandLeft", JointName("hand", "left")),
        ("Subject1:RWRA", JointName("wrist", "right", "skin", "a")),
        ("r_lwrist_study", JointName("wrist", "right", "skin", "a")),
        ("L_melbow_study", JointName("elbow", "left", "skin", "b")),
        ("R_elbow_lat", JointName("elbow", "right", "skin", "a")),
        ("R.Wrist.Med", JointName("wrist", "right", "skin", "b")),
        ("r_shoulder_study", JointName("shoulder", "right", "skin")),
        ("LSJC", JointName("shoulder", "left", "centre")),
        ("RHUO", JointName("elbow", "right", "centre")),
        ("R_Elbow_Center", JointName("elbow", "right", "centre")),
        ("lelbow", JointName("elbow", "left")),
        ("right_hip", JointName("hip", "right")),
        ("HandTipRight", None),
        ("HANDTIP_LEFT", None),
        ("SpineShoulder", None),
        ("RHandWrist", None),
        ("R_forearm", None),
        ("wrist", None),
        ("RightHandIndex1", None),
    ],
)
def test_names(name: str, meaning: JointName | None) -> None:
    assert joint_name(name) == meaning


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("mm", 1000.0)])
def test_pose2sim(tmp_path: Path, unit: str, scale: float) -> None:
    points = {name: scale * made.part(name, FRAMES) for name in BODY_25 if name[-3:] not in ("Eye", "Ear")}
    path = tmp_path / "a.dat"  # the name is not what recognises it
    made.trc(path, points, unit)
    table = read(path, "trc")
    assert_allclose(table.position["wrist_left"], made.expected("wrist_left", FRAMES), atol=1e-6)
    assert_allclose(table.t_s, np.arange(FRAMES) / 30, atol=1e-8)
    assert (table.frame, table.units) == (None, unit)
    assert_array_equal(table.gravity_hint, [0, -1, 0])
    assert (table.state["wrist_left"] == JointState.TRACKED).all()


def test_joint_centres_before_skin_markers(tmp_path: Path) -> None:
    shift = np.array([0.03, 0.0, 0.0])
    wrist, elbow = made.part("RWrist", FRAMES), made.part("RElbow", FRAMES)
    points = {
        "r_shoulder_study": made.part("RShoulder", FRAMES) + shift,
        "RShoulder": made.part("RShoulder", FRAMES),
        "r_lelbow_study": elbow + shift,
        "r_melbow_study": elbow - shift,
        "RWRA": wrist + shift,
        "RWJC": wrist,
    }
    path = tmp_path / "a.trc"
    made.trc(path, points)
    table = read(path, "trc")
    assert_allclose(table.position["shoulder_right"], made.part("RShoulder", FRAMES), atol=1e-6)
    assert_allclose(table.position["elbow_right"], elbow, atol=1e-6)
    assert_allclose(table.position["wrist_right"], wrist, atol=1e-6)
    words = " ".join(table.notes)
    assert "shoulder_right is the marker RShoulder" in words
    assert "elbow_right is the middle of r_lelbow_study and r_melbow_study" in words
    assert "wrist_right is the joint centre RWJC" in words
    assert "Skin markers" in words


def test_azure_kinect_in_trc(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    made.trc(path, {f"K4ABT_JOINT_{name}": made.optical(made.part(name, FRAMES)) for name in AZURE})
    table = read(path, "trc")
    assert table.frame is CameraFrame.OPTICAL
    assert_allclose(table.position["hand_left"], made.expected("hand_left", FRAMES, "optical"), atol=1e-6)


def test_z_up(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    made.trc(path, {name: made.part(name, FRAMES)[:, [0, 2, 1]] * [1, -1, 1] for name in BODY_25[:9]})
    table = read(path, "trc")
    assert table.frame is CameraFrame.ZUP
    assert any("Assumed axes: z up" in note for note in table.notes)


def test_arm_alone_is_y_up_by_the_format(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    made.trc(path, {name: made.part(name, FRAMES) for name in ("RShoulder", "RElbow", "RWrist")})
    table = read(path, "trc")
    assert_array_equal(table.gravity_hint, [0, -1, 0])
    assert any("the body does not show them" in note for note in table.notes)


def test_lost_markers(tmp_path: Path) -> None:
    rows = {name: made.part(name, FRAMES) for name in ("RShoulder", "RElbow", "RWrist")}
    rows["RWrist"][5:9] = 0.0
    path = tmp_path / "a.trc"
    made.trc(path, rows)
    table = read(path, "trc")
    assert np.isnan(table.position["wrist_right"][5:9]).all()
    assert not table.state["wrist_right"][5:9].any()
    assert table.state["wrist_right"][9] == JointState.TRACKED


def test_a_unit_that_is_not_so(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    points = {name: 1000 * made.part(name, FRAMES) for name in ("RShoulder", "RElbow", "RWrist")}
    made.trc(path, points, "m")
    table = read(path, "trc")
    assert_allclose(table.position["wrist_right"], made.part("RWrist", FRAMES), atol=1e-6)
    assert any("The file states m" in note and "multiplied by 0.001" in note for note in table.notes)
    made.trc(path, {name: 1e6 * rows for name, rows in points.items()}, "mm")
    with pytest.raises(RecordingError, match=r"a\.trc"):
        read(path, "trc")


def test_no_arm(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    made.trc(path, {name: made.part("LHip", FRAMES) for name in ("LASI", "RASI", "LWRIST")})
    with pytest.raises(RecordingError, match=r"a\.trc: no arm with an elbow and a wrist.*LASI.*export"):
        read(path, "trc")


@pytest.mark.parametrize("names", [("RSJC", "REJC", "RWJC"), ("Subject:RShoulder", "RElbow", "RWrist")])
def test_c3d(tmp_path: Path, names: tuple[str, ...]) -> None:
    import ezc3d

    points = [made.part(name, FRAMES)[:, [0, 2, 1]] for name in ("RShoulder", "RElbow", "RWrist")]
    points += [made.part(name, FRAMES)[:, [0, 2, 1]] for name in ("LHip", "Head")]
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [30.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = [*names, "LHip", "Head"]
    data = np.ones((4, len(points), FRAMES))
    data[:3] = 1000.0 * np.moveaxis(np.stack(points), 2, 0)
    file["data"]["points"] = data
    file.write(str(tmp_path / "a.c3d"))
    path = (tmp_path / "a.c3d").rename(tmp_path / "any.bin")
    table = read(path, "c3d")
    assert (table.frame, table.units) == (CameraFrame.ZUP, "mm")
    assert_allclose(table.position["wrist_right"], points[2], atol=1e-6)  # single precision of mm
    assert table.rate_hz == pytest.approx(30.0)


def test_theia_segments_in_c3d(tmp_path: Path) -> None:
    import ezc3d

    labels = ["r_uarm_4X4", "r_larm_4X4", "r_hand_4X4", "pelvis_4X4", "head_4X4", "r_foot_4X4", "l_larm_4X4"]
    names = ["RShoulder", "RElbow", "RWrist", "pelvis", "Head", "RAnkle", "LElbow"]
    origins = np.stack([made.part(name, FRAMES)[:, [0, 2, 1]] * [1, -1, 1] for name in names])
    poses = np.tile(np.eye(4)[:, :, None, None], (1, 1, len(names), FRAMES))
    poses[:3, 3] = 1000 * np.moveaxis(origins, 2, 0)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [60.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = ["origin"]  # ezc3d writes no file without points
    file["data"]["points"] = np.ones((4, 1, FRAMES))
    for name, value in (("USED", [len(names)]), ("RATE", [60.0]), ("RATIO", [1]), ("LABELS", labels)):
        file.add_parameter("ROTATION", name, value)
    file["data"]["rotations"] = poses
    path = tmp_path / "a.c3d"
    file.write(str(path))
    table = read(path, "c3d")
    assert set(table.position) == {"shoulder_right", "elbow_right", "wrist_right", "elbow_left"}
    assert_allclose(table.position["wrist_right"], origins[2], atol=1e-6)  # single precision of mm
    assert (table.frame, table.rate_hz) == (CameraFrame.ZUP, 60.0)
    assert any("origins of the segments r_uarm_4X4" in note for note in table.notes)
