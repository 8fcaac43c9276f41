"""Skeletons in JSON, arrays, TRC and C3D: names of joints, what is taken, which way is up."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import skeleton_files as made
from importers import tables
from numpy.testing import assert_allclose, assert_array_equal

from smoother.errors import RecordingError
from smoother.io.tables.joints import AZURE, BLAZEPOSE, BODY_25, JointName, joint_name
from smoother.recording import CameraFrame, JointState

FRAMES = 30


def write(path: Path, value: object) -> Path:
    path.write_text(json.dumps(value))
    return path


def offline_processor(frames: int = FRAMES, scale: float = 1000, **more: object) -> dict[str, object]:
    points = scale * np.stack([made.optical(made.part(name, frames)) for name in AZURE], axis=1)
    rows = []
    for at in range(frames):
        bodies = [] if at in (3, 4) else [{"body_id": 2, "joint_positions": points[at].tolist(), **more}]
        rows.append({"bodies": bodies, "num_bodies": len(bodies), "timestamp_usec": 500 + 33_333 * at})
    return {"bone_list": [["NECK", "HEAD"]], "frames": rows, "joint_names": AZURE}


def test_offline_processor(tmp_path: Path) -> None:
    path = write(tmp_path / "a.json", offline_processor())
    (table,) = tables(path, "azure-kinect-json")
    assert (table.body, table.frame, table.units) == (2, CameraFrame.OPTICAL, "mm")
    assert_allclose(table.t_s, (500 + 33_333 * np.arange(FRAMES)) * 1e-6, atol=1e-12)
    there = np.delete(np.arange(FRAMES), [3, 4])
    wanted = made.expected("wrist_right", FRAMES, "optical")
    assert_allclose(table.position["wrist_right"][there], wanted[there], atol=1e-12)
    assert np.isnan(table.position["wrist_right"][3:5]).all()
    assert (table.state["wrist_right"][there] == JointState.TRACKED).all()
    levels = [1] * 8 + [0] * 3 + [2] * 4 + [0] * 3 + [2] * 14
    write(path, offline_processor(scale=1, confidence_levels=levels))
    (table,) = tables(path, "azure-kinect-json")
    wanted = {"wrist_left": {1}, "wrist_right": {2}, "hand_right": {1}}
    assert table.units == "m" and wanted == {joint: set(table.state[joint][5:].tolist()) for joint in wanted}
    path.write_text(path.read_text()[:20_000])
    with pytest.raises(RecordingError, match=r"a\.json should be JSON of body tracking.*is cut off"):
        tables(path, "azure-kinect-json")


def world(frames: int) -> list[list[dict[str, float]]]:
    points = made.landmarks(frames)
    return [[{"x": x, "y": y, "z": z, "visibility": 0.9} for x, y, z in frame] for frame in points.tolist()]


@pytest.mark.parametrize("layout", ["rows", "fps", "nested", "names", "numbered", "lines", "tfjs", "arrays"])
def test_world_landmarks(tmp_path: Path, layout: str) -> None:
    rows = world(FRAMES)
    path = tmp_path / "a.json"
    named = [dict(zip(BLAZEPOSE, row, strict=True)) for row in rows]
    values: dict[str, object] = {
        "rows": [{"timestamp_ms": 40 * at, "pose_world_landmarks": row} for at, row in enumerate(rows)],
        "fps": {"fps": 25, "frames": [{"frame": at, "landmarks": row} for at, row in enumerate(rows)]},
        "nested": {"fps": 25.0, "frames": [{"world_landmarks": [row], "landmarks": [row]} for row in rows]},
        "names": {"fps": 25, "frames": [{"time": 0.04 * at, **row} for at, row in enumerate(named)]},
        "numbered": {"fps": 25, "positions": {f"{at + 1}.0": row for at, row in enumerate(named)}},
        "lines": None,
        "tfjs": [
            {"timestamp": 40 * at, "keypoints3D": [{**p, "name": n} for n, p in row.items()]}
            for at, row in enumerate(named)
        ],
        "arrays": {"fps": 25, "frames": [[list(p.values()) for p in row] for row in rows]},
    }
    if layout == "lines":
        lines = [json.dumps({"t": 0.04 * at, "pose_world_landmarks": row}) for at, row in enumerate(rows)]
        path.write_text("\n".join(lines))
    else:
        write(path, values[layout])
    if layout == "arrays":  # no name in it: asked for by --skeleton-format
        from smoother.io.registry import format_named

        (table,) = format_named("pose-json").read(path)
    else:
        (table,) = tables(path, "pose-json")
    assert table.relative
    assert table.frame is CameraFrame.OPTICAL
    wanted = made.landmarks(FRAMES)[:, BLAZEPOSE.index("left_elbow")]
    assert_allclose(table.position["elbow_left"], wanted, atol=1e-12)
    start = 0.04 if layout == "numbered" else 0.0
    assert table.t_s is None or np.allclose(table.t_s, start + 0.04 * np.arange(FRAMES), atol=1e-9)
    if table.t_s is None:
        assert table.rate_hz == 25


def test_landmarks_in_the_image_are_refused(tmp_path: Path) -> None:
    frames = {
        f"{at}.0": dict(zip(BLAZEPOSE, frame, strict=True))
        for at, frame in enumerate((0.5 + 0.2 * made.landmarks(FRAMES)).tolist())
    }
    with pytest.raises(RecordingError, match=r"not metres; export pose_world_landmarks"):
        tables(write(tmp_path / "a.json", {"positions": frames}), "pose-json")


def test_openpose_in_space(tmp_path: Path) -> None:
    flat = [np.column_stack([frame, np.full(25, 0.8)]).ravel().tolist() for frame in made.body_25(FRAMES)]
    value = [{"version": 1.3, "people": [{"pose_keypoints_3d": row}]} for row in flat]
    (table,) = tables(write(tmp_path / "a.json", value), "pose-json")
    assert not table.relative
    assert_array_equal(table.gravity_hint, [0, -1, 0])
    assert_allclose(table.position["wrist_right"], made.expected("wrist_right", FRAMES), atol=1e-12)


def test_openpose_in_the_image_is_read_as_pixels(tmp_path: Path) -> None:
    row = [value for at in range(25) for value in (10.0 * at, 5.0 * at, 0.8)]
    row[3 * 4 : 3 * 4 + 3] = [0.0, 0.0, 0.0]  # the right wrist was not found
    value = {"fps": 25, "frames": [{"people": [{"pose_keypoints_2d": row}]}, {"people": []}] * 3}
    (table,) = tables(write(tmp_path / "a.json", value), "pose-json")
    assert (table.units, table.frame) == ("pixels", CameraFrame.OPTICAL)
    assert_allclose(table.t_s, np.arange(6) / 25)
    assert_allclose(table.position["elbow_right"][0], [30.0, 15.0, 0.8])
    assert np.isnan(table.position["elbow_right"][1]).all()
    assert np.isnan(table.position["wrist_right"]).all()
    assert table.state["elbow_right"].tolist() == [2, 0] * 3


def test_coco_takes_the_surest_person_and_its_visibilities(tmp_path: Path) -> None:
    def person(image: int, at: float, **more: float) -> dict[str, object]:
        return {"image_id": image, "keypoints": [v for k in range(17) for v in (at + k, at, k % 3)], **more}

    listed = [person(2, 50.0, area=10), person(1, 100.0, area=5), person(1, 200.0, area=9)]
    value = {"images": [{"id": 1}, {"id": 2}, {"id": 3}], "annotations": listed}
    (table,) = tables(write(tmp_path / "a.json", value), "pose-json")
    elbow = table.position["elbow_left"]  # COCO's eighth: 7 % 3 = 1, labelled and hidden
    assert_allclose(elbow[:2], [[207.0, 200.0, 0.3], [57.0, 50.0, 0.3]])
    assert np.isnan(elbow[2]).all()
    assert table.state["elbow_left"].tolist() == [1, 1, 0]
    assert "30 frames per second" in " ".join(table.notes)


def test_a_number_of_keypoints_that_is_no_known_set(tmp_path: Path) -> None:
    value = [{"people": [{"pose_keypoints_2d": [1.0] * 33}]}] * 5
    with pytest.raises(RecordingError, match="11 keypoints per person are not a known set"):
        tables(write(tmp_path / "a.json", value), "pose-json")


@pytest.mark.parametrize("points", [33, 553])
def test_freemocap_array(tmp_path: Path, points: int) -> None:
    body = np.stack([made.part(name, FRAMES) for name in BLAZEPOSE], axis=1)[:, :, [0, 2, 1]] * [1, -1, 1]
    array = np.full((FRAMES, points, 3), np.nan)
    array[:, :33] = 1000 * body
    path = tmp_path / "a.npy"
    np.save(path, array)
    (table,) = tables(path, "joint-array")
    assert (table.frame, table.units, table.relative) == (CameraFrame.ZUP, "mm", False)
    assert_allclose(table.position["wrist_left"], body[:, BLAZEPOSE.index("left_wrist")], atol=1e-12)
    assert table.rate_hz == 30.0


def test_arrays_that_are_no_joints(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((10, 7, 3)))
    with pytest.raises(RecordingError, match=r"a\.npy is an array of 10 x 7 x 3"):
        tables(path, "joint-array")
    np.save(path, np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(RecordingError, match=r"a\.npy was recognised as array of joints.*is damaged"):
        tables(path, "joint-array")


#: Names by what they mean; of single words and of parts of the arm that are no joint nothing is made.
NAMES = {
    JointName("wrist", "right"): "RWrist WRIST_RIGHT",
    JointName("elbow", "left"): "K4ABT_JOINT_ELBOW_LEFT lelbow",
    JointName("hand", "left"): "JointType_HandLeft mano_izquierda",
    JointName("wrist", "left"): "HandgelenkLinks linkes_Handgelenk",
    JointName("shoulder", "right"): "ÉPAULE_DROITE",
    JointName("hip", "right"): "right_hip",
    JointName("wrist", "right", "skin", "a"): "Subject1:RWRA r_lwrist_study",
    JointName("wrist", "right", "skin", "b"): "R.Wrist.Med",
    JointName("elbow", "right", "skin", "a"): "R_elbow_lat",
    JointName("elbow", "left", "skin", "b"): "L_melbow_study",
    JointName("shoulder", "right", "skin"): "r_shoulder_study",
    JointName("shoulder", "left", "centre"): "LSJC",
    JointName("elbow", "right", "centre"): "RHUO R_Elbow_Center",
    None: "HandTipRight HANDTIP_LEFT SpineShoulder RHandWrist R_forearm wrist RightHandIndex1 Handgelenk"
    " Gelenk_rechts",
}


def test_names() -> None:
    found = {name: joint_name(name) for listed in NAMES.values() for name in listed.split()}
    assert found == {name: meaning for meaning, listed in NAMES.items() for name in listed.split()}


def z_up(points: np.ndarray) -> np.ndarray:
    return points[:, [0, 2, 1]] * [1, -1, 1]


POSE2SIM = [name for name in BODY_25 if name[-3:] not in ("Eye", "Ear")]
RIGHT = ["RShoulder", "RElbow", "RWrist"]
#: Names of markers, how the body stands, the unit that is stated and the scale of the values; what is found.
TRC = {
    "Pose2Sim in m": (POSE2SIM, np.array, "m", 1.0, None, [0, -1, 0], ""),
    "Pose2Sim in mm": (POSE2SIM, np.array, "mm", 1000.0, None, [0, -1, 0], ""),
    "Azure Kinect": (AZURE, made.optical, "m", 1.0, CameraFrame.OPTICAL, None, ""),
    "z up": (BODY_25[:9], z_up, "m", 1.0, CameraFrame.ZUP, [0, 0, -1], "Assumed axes: z up"),
    "an arm alone": (RIGHT, np.array, "m", 1.0, None, [0, -1, 0], "y up, as usual in this format"),
    "another unit": (RIGHT, np.array, "m", 1000.0, None, [0, -1, 0], "positions: mm, not the usual m"),
}


@pytest.mark.parametrize("case", TRC)
def test_trc(tmp_path: Path, case: str) -> None:
    names, placed, unit, scale, frame, down, said = TRC[case]
    path = tmp_path / "a.dat"  # the name is not what recognises it
    prefix = "K4ABT_JOINT_" if names is AZURE else ""
    made.trc(path, {prefix + name: scale * placed(made.part(name, FRAMES)) for name in names}, unit)
    (table,) = tables(path, "trc")
    assert_allclose(table.position["wrist_right"], placed(made.part("RWrist", FRAMES)), atol=1e-6)
    assert_allclose(table.t_s, np.arange(FRAMES) / 30, atol=1e-8)
    assert (table.frame, table.units) == (frame, unit)
    assert_array_equal(table.gravity_hint, down)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()
    assert said in " ".join(table.notes)


def test_joint_centres_before_skin_markers(tmp_path: Path) -> None:
    shift = np.array([0.03, 0.0, 0.0])
    shoulder, elbow, wrist = (made.part(name, FRAMES) for name in RIGHT)
    points = {"r_shoulder_study": shoulder + shift, "RShoulder": shoulder, "RWRA": wrist + shift}
    points |= {"RWJC": wrist, "r_lelbow_study": elbow + shift, "r_melbow_study": elbow - shift}
    made.trc(tmp_path / "a.trc", points)
    (table,) = tables(tmp_path / "a.trc", "trc")
    for joint, place in (("shoulder", shoulder), ("elbow", elbow), ("wrist", wrist)):
        assert_allclose(table.position[f"{joint}_right"], place, atol=1e-6)
    words = " ".join(table.notes)
    assert "shoulder_right is the marker RShoulder" in words
    assert "elbow_right is the middle of r_lelbow_study and r_melbow_study" in words
    assert "wrist_right is the joint centre RWJC" in words and "Skin markers" in words


def test_lost_markers_and_files_without_an_arm(tmp_path: Path) -> None:
    arm = {name: made.part(name, FRAMES) for name in RIGHT}
    arm["RWrist"][5:9] = 0.0
    path = tmp_path / "a.trc"
    made.trc(path, arm)
    (table,) = tables(path, "trc")
    assert np.isnan(table.position["wrist_right"][5:9]).all()
    assert table.state["wrist_right"][4:10].tolist() == [2, 0, 0, 0, 0, 2]
    hips = {name: made.part("LHip", FRAMES) for name in ("LASI", "RASI", "LWRIST")}
    for points, said in (
        ({name: 1e9 * rows for name, rows in arm.items()}, r"a\.trc"),  # no length of an arm
        (hips, r"a\.trc: no arm with an elbow and a wrist.*LASI.*export"),
    ):
        made.trc(path, points, "mm")
        with pytest.raises(RecordingError, match=said):
            tables(path, "trc")


@pytest.mark.parametrize("names", [("RSJC", "REJC", "RWJC"), ("Subject:RShoulder", "RElbow", "RWrist")])
def test_c3d(tmp_path: Path, names: tuple[str, ...]) -> None:
    points = [z_up(made.part(name, FRAMES)) for name in (*RIGHT, "LHip", "Head")]
    labels = [*names, "LHip", "Head"]
    path = made.c3d(tmp_path / "a.c3d", 1000 * np.stack(points, axis=1), rate=30.0, labels=labels)
    path = path.rename(tmp_path / "any.bin")
    (table,) = tables(path, "c3d")
    assert (table.frame, table.units) == (CameraFrame.ZUP, "mm")
    assert_allclose(table.position["wrist_right"], points[2], atol=1e-6)  # single precision of mm
    assert table.rate_hz == pytest.approx(30.0)


def test_theia_segments_in_c3d(tmp_path: Path) -> None:
    labels = ["r_uarm_4X4", "r_larm_4X4", "r_hand_4X4", "pelvis_4X4", "head_4X4", "r_foot_4X4", "l_larm_4X4"]
    names = ["RShoulder", "RElbow", "RWrist", "pelvis", "Head", "RAnkle", "LElbow"]
    origins = [z_up(made.part(name, FRAMES)) for name in names]
    segments = {label: 1000 * rows for label, rows in zip(labels, origins, strict=True)}
    path = made.c3d(tmp_path / "a.c3d", np.ones((FRAMES, 1, 3)), rate=60.0, segments=segments)
    (table,) = tables(path, "c3d")
    assert set(table.position) == {"shoulder_right", "elbow_right", "wrist_right", "elbow_left"}
    assert_allclose(table.position["wrist_right"], origins[2], atol=1e-6)  # single precision of mm
    assert (table.frame, table.rate_hz) == (CameraFrame.ZUP, 60.0)
    assert any("origins of the segments r_uarm_4X4" in note for note in table.notes)
