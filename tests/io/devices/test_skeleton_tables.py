"""Tables of joints: Azure Kinect, Kinect v2, MediaPipe and others, with and without headers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import skeleton_files as made
from importers import tables
from numpy.testing import assert_allclose, assert_array_equal

from smoother.errors import RecordingError
from smoother.io.registry import recognise
from smoother.io.tables.joints import AZURE, BLAZEPOSE, KINECT_V2
from smoother.io.tables.table import read_head
from smoother.io.tables.times import repaired_skeleton
from smoother.recording import CameraFrame, JointState

FRAMES = 40
ARM = [f"{joint}_{side}" for joint in ("shoulder", "elbow", "wrist", "hand") for side in ("left", "right")]


def write(path: Path, rows: list[list[object]], separator: str = ",") -> Path:
    path.write_text("\n".join(separator.join(map(str, row)) for row in rows) + "\n")
    return path


def test_mkv_extractor(tmp_path: Path) -> None:
    path = tmp_path / "any.name"
    made.azure_csv(path, FRAMES)
    (table,) = tables(path, "azure-kinect")
    assert (table.body, table.frame, table.units, table.relative) == (1, CameraFrame.OPTICAL, "mm", False)
    assert_allclose(table.t_s, 0.200219 + 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert set(table.position) == set(ARM)
    for joint in ARM:  # half of the last printed digit, and the shift of body 1
        wanted = made.expected(joint, FRAMES, "optical") + np.array([0.1, 0, 0])
        assert_allclose(table.position[joint], wanted, atol=1e-9)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()
    assert (table.state["hand_right"] == JointState.INFERRED).all()
    assert any("hand_left, hand_right: confidence 0" in note for note in table.notes)


def test_confidences_of_single_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    made.azure_csv(path, FRAMES)
    lines = path.read_text().splitlines()
    at = 2 + 4 * AZURE.index("WRIST_RIGHT")
    for row, value in ((5, "1"), (6, "0"), (7, "3")):
        cells = lines[row + 1].split(";")
        lines[row + 1] = ";".join([*cells[:at], value, *cells[at + 1 :]])
    path.write_text("\n".join(lines))
    (table,) = tables(path, "azure-kinect")
    states = [JointState.TRACKED, JointState.INFERRED, JointState.NOT_TRACKED, JointState.TRACKED]
    assert table.state["wrist_right"][4:8].tolist() == states


def test_two_bodies_and_absent_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    made.azure_csv(path, FRAMES, body=(1, 4))
    lines = path.read_text().splitlines()
    gone = [2 + 2 * frame for frame in range(10, 20)]  # the second body's rows of ten frames
    path.write_text("\n".join(line for at, line in enumerate(lines) if at not in gone))
    first, second = tables(path, "azure-kinect")
    assert (first.body, second.body) == (1, 4)
    assert_array_equal(first.t_s, second.t_s)
    assert len(second.t_s) == FRAMES
    absent = np.isnan(second.position["wrist_left"]).all(axis=1)
    assert_array_equal(np.flatnonzero(absent), np.arange(10, 20))
    assert not second.state["wrist_left"][10:20].any()
    assert np.isfinite(first.position["wrist_left"]).all()


def test_bodies_one_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    made.azure_csv(path, FRAMES, body=(1, 2))
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[::2], *rows[1::2]]))
    first, second = tables(path, "azure-kinect")
    assert len(first.t_s) == len(second.t_s) == FRAMES
    assert np.isfinite(second.position["wrist_left"]).all()


@pytest.mark.parametrize(("per_joint", "leading"), [(3, 0), (7, 0), (7, 1), (4, 1), (8, 2)])
def test_kinect_v2_without_header(tmp_path: Path, per_joint: int, leading: int) -> None:
    joints = made.kinect_v2(FRAMES)
    turn = {3: [], 4: [2], 7: [0.0, 0.6, 0.0, 0.8], 8: [0.0, 0.6, 0.0, 0.8, 2]}[per_joint]
    front = [[0.033 * at, 3][:leading] for at in range(FRAMES)]
    rows = [[*front[at], *(v for point in joints[at] for v in (*point, *turn))] for at in range(FRAMES)]
    (table,) = tables(write(tmp_path / "a.txt", rows, " "), "kinect-numbers")
    assert table.frame is CameraFrame.KINECT
    assert table.body == (3 if leading == 2 else 0)
    if leading:
        assert_allclose(table.t_s, 0.033 * np.arange(FRAMES))
    wanted = joints[:, KINECT_V2.index("WristRight")]
    assert_allclose(table.position["wrist_right"], wanted, atol=1e-9)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()


@pytest.mark.parametrize("end", [",", ", "])
def test_without_header_lines_may_end_with_a_separator(tmp_path: Path, end: str) -> None:
    rows = [[*made.kinect_v2(FRAMES)[at].ravel()] for at in range(FRAMES)]
    path = write(tmp_path / "a.txt", rows)
    path.write_text(path.read_text().replace("\n", f"{end}\n"))
    (table,) = tables(path, "kinect-numbers")
    assert_allclose(table.position["wrist_right"], made.kinect_v2(FRAMES)[:, KINECT_V2.index("WristRight")])


def test_a_table_of_one_column_is_none_of_a_kinect(tmp_path: Path) -> None:
    """Its first line ends with a separator, and nothing would be left without that."""
    path = tmp_path / "a.csv"
    path.write_text(",\ne\n1,")
    assert recognise(read_head(path)) is None


@pytest.mark.parametrize("style", ["{}_{}", "{}.{}", "{} {}", "joint_{}_{}", "{}({})"])
def test_kinect_v2_by_name(tmp_path: Path, style: str) -> None:
    joints = made.kinect_v2(FRAMES)
    header = ["Time", "TrackingId"] + [
        style.format(n, f) for n in KINECT_V2 for f in ("X", "Y", "Z", "State")
    ]
    words = ["Tracked", "Inferred", "NotTracked"]
    rows: list[list[object]] = [header]
    for at in range(FRAMES):
        cells = [v for point in joints[at] for v in (*np.round(point, 6), words[at % 3])]
        rows.append([f"{333_333 * at}", "72057594037928081", *cells])  # .NET ticks
    (table,) = tables(write(tmp_path / "a.csv", rows), "kinect-v2")
    assert table.frame is CameraFrame.KINECT
    assert_allclose(table.t_s, 0.0333333 * np.arange(FRAMES), atol=1e-9)
    assert_array_equal(table.state["wrist_left"][:6], [2, 1, 0, 2, 1, 0])
    wanted = joints[::3, KINECT_V2.index("ElbowLeft")]
    assert_allclose(table.position["elbow_left"][::3], wanted, atol=1e-6)
    assert any("72057594037928081" in note or "is called 0" in note for note in table.notes)


def test_a_row_a_joint(tmp_path: Path) -> None:
    joints = made.kinect_v2(FRAMES)
    rows: list[list[object]] = [["Timestamp", "JointID", "Position.X", "Position.Y", "Position.Z", "State"]]
    for at in range(FRAMES):
        rows += [[33.3 * at, j, *np.round(joints[at, j], 6), 1 if j == 10 else 2] for j in range(25)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "joint-rows")
    assert table.frame is CameraFrame.KINECT
    assert_allclose(table.t_s, 0.0333 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], joints[:, 7], atol=1e-6)
    assert (table.state["wrist_right"] == JointState.INFERRED).all()
    assert (table.state["wrist_left"] == JointState.TRACKED).all()


def test_a_row_a_joint_of_a_clock_that_was_set_back(tmp_path: Path) -> None:
    """Stamps of both sides are equal: frames must not be mixed."""
    joints = made.kinect_v2(FRAMES)
    rows: list[list[object]] = [["Timestamp", "JointID", "Position.X", "Position.Y", "Position.Z", "State"]]
    for at in range(FRAMES):
        stamp = 33.0 * (at - 10 * (at >= FRAMES // 2))
        rows += [[stamp, j, *np.round(joints[at, j], 6), 2] for j in range(25)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "joint-rows")
    assert len(table.t_s) == FRAMES
    assert_allclose(table.position["hand_left"], joints[:, 7], atol=1e-6)
    assert_allclose(repaired_skeleton(table, "a.csv").t_s, 0.033 * np.arange(FRAMES), atol=1e-9)


def mediapipe_rows(points: np.ndarray, style: str) -> list[list[object]]:
    header = ["frame", "timestamp_ms"]
    names = BLAZEPOSE if "{name}" in style else range(33)
    for at, name in enumerate(names):
        header += [style.format(name=name, at=at, axis=axis) for axis in ("x", "y", "z", "visibility")]
    rows: list[list[object]] = [header]
    for at, frame in enumerate(points):
        rows.append([at, round(at * 1000 / 30), *(v for point in frame for v in (*point, 0.9))])
    return rows


@pytest.mark.parametrize(
    "style", ["{axis}{at}", "landmark_{at}_{axis}", "{name}_{axis}", "{name}.world.{axis}"]
)
def test_mediapipe_world_landmarks(tmp_path: Path, style: str) -> None:
    points = made.landmarks(FRAMES)
    (table,) = tables(write(tmp_path / "a.csv", mediapipe_rows(points, style)), "mediapipe")
    assert table.relative
    assert table.frame is CameraFrame.OPTICAL
    assert any("relative to the hips" in note for note in table.notes)
    assert_allclose(table.t_s, np.arange(FRAMES) / 30, atol=6e-4)  # whole milliseconds
    for joint in ARM[:6]:
        name, _, side = joint.partition("_")
        wanted = points[:, BLAZEPOSE.index(f"{side}_{name}")]
        assert_allclose(table.position[joint], wanted, atol=1e-9)


def test_world_landmarks_beside_those_in_the_image(tmp_path: Path) -> None:
    points = made.landmarks(FRAMES)
    rows = mediapipe_rows(0.5 + 0.2 * points, "{name}_{axis}")
    beside = mediapipe_rows(points, "{name}_world_{axis}")
    both = [[*row, *other[2:]] for row, other in zip(rows, beside, strict=True)]
    (table,) = tables(write(tmp_path / "a.csv", both), "mediapipe")
    assert_allclose(table.position["wrist_right"], points[:, BLAZEPOSE.index("right_wrist")], atol=1e-9)


def test_low_visibility_is_inferred(tmp_path: Path) -> None:
    rows = mediapipe_rows(made.landmarks(FRAMES), "{name}_{axis}")
    column = rows[0].index("right_wrist_visibility")
    rows[8][column] = 0.3
    (table,) = tables(write(tmp_path / "a.csv", rows), "mediapipe")
    assert table.state["wrist_right"][7] == JointState.INFERRED
    assert (np.delete(table.state["wrist_right"], 7) == JointState.TRACKED).all()


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("cm", 100.0), ("m", 1.0)])
@pytest.mark.parametrize("z_up", [True, False])
def test_any_table_of_joints(tmp_path: Path, unit: str, scale: float, z_up: bool) -> None:
    names = ["right_shoulder", "right_elbow", "right_wrist", "left_hip", "right_hip", "nose"]
    points = np.stack([made.part(name, FRAMES) for name in names], axis=1) + np.array([3.0, 0.0, 2.0])
    points = points[:, :, [0, 2, 1]] * [1, -1, 1] if z_up else points
    header = [f"body_{name}_{axis}" for name in names for axis in "xyz"]
    rows: list[list[object]] = [["t_s", *header]]
    rows += [[at / 30, *(scale * points[at]).ravel().tolist()] for at in range(FRAMES)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "joint-table")
    assert table.units == unit
    assert table.frame is (CameraFrame.ZUP if z_up else None)
    assert table.gravity_hint is not None
    assert_array_equal(table.gravity_hint, [0, 0, -1] if z_up else [0, -1, 0])
    assert_allclose(table.position["wrist_right"], points[:, 2], atol=1e-9)


def test_hips_that_were_never_seen(tmp_path: Path) -> None:
    """Nothing shows which way is up: it is read all the same."""
    names = ["right_shoulder", "right_elbow", "right_wrist"]
    points = np.stack([made.part(name, FRAMES) for name in names], axis=1).reshape(FRAMES, -1)
    header = ["t_s", *(f"{name}_{axis}" for name in [*names, "left_hip", "right_hip"] for axis in "xyz")]
    rows = [[at / 30, *points[at], *[np.nan] * 6] for at in range(FRAMES)]
    (table,) = tables(write(tmp_path / "a.csv", [header, *rows]), "joint-table")
    assert_allclose(table.position["wrist_right"], points[:, 6:], atol=1e-9)


def test_landmarks_with_one_hip_are_about_the_hips(tmp_path: Path) -> None:
    rows = mediapipe_rows(made.landmarks(FRAMES), "{name}_{axis}")
    kept = [at for at, name in enumerate(rows[0]) if not str(name).startswith("left_hip")]
    (table,) = tables(write(tmp_path / "a.csv", [[row[at] for at in kept] for row in rows]), "mediapipe")
    assert table.relative and any("relative to the hips" in note for note in table.notes)


def test_numbered_frames_keep_their_gaps(tmp_path: Path) -> None:
    rows = mediapipe_rows(made.landmarks(FRAMES), "{name}_{axis}")
    rows = [[row[0], *row[2:]] for row in rows]  # no times
    del rows[11:21]
    (table,) = tables(write(tmp_path / "a.csv", rows), "mediapipe")
    assert table.rate_hz == 30.0
    assert np.diff(table.t_s).max() == pytest.approx(11 / 30)
    assert any("30 frames per second" in note for note in table.notes)


def test_pixels_are_refused(tmp_path: Path) -> None:
    names = ["right_shoulder", "right_elbow", "right_wrist"]
    points = np.stack([made.part(name, FRAMES) for name in names], axis=1) * 4000.0
    header = [f"{name}_{axis}" for name in names for axis in "xyz"]
    path = write(tmp_path / "a.csv", [header, *points.reshape(FRAMES, -1).tolist()])
    with pytest.raises(RecordingError, match=r"a\.csv: .*in neither m.*export positions in metres"):
        tables(path, "joint-table")


def test_no_body_in_view(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    made.azure_csv(path, FRAMES)
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *(";".join([*row.split(";")[:2], *["0"] * 128]) for row in rows)]))
    with pytest.raises(RecordingError, match=r"a\.csv names joints and has no position"):
        tables(path, "azure-kinect")


@pytest.mark.parametrize(
    "style",
    [
        "{name}_{axis} (mm)",
        "{name}_pos_{axis}",
        "{axis}_{name}",
        "{lower}.position.{axis}",
        "K4ABT_JOINT_{name} {axis}",
    ],
)
@pytest.mark.parametrize(
    ("time", "step"),
    [("timestamp_usec", 33_333), ("Time", 0.033333), ("ts_ms", 33.333), ("time [s]", 0.033333)],
)
def test_spellings(tmp_path: Path, style: str, time: str, step: float) -> None:
    header = [time] + [style.format(name=n, lower=n.lower(), axis=a) for n in AZURE for a in "xyz"]
    points = 1000 * np.stack([made.optical(made.part(name, FRAMES)) for name in AZURE], axis=1)
    rows: list[list[object]] = [header, *([at * step, *points[at].ravel().tolist()] for at in range(FRAMES))]
    (table,) = tables(write(tmp_path / "a.csv", rows), "azure-kinect")
    assert_allclose(table.t_s, 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], made.expected("hand_left", FRAMES, "optical"), atol=1e-9)


def test_lsl_kinect_with_shares_of_one(tmp_path: Path) -> None:
    joints = made.kinect_v2(FRAMES)
    rows: list[list[object]] = [
        ["Timestamp"] + [f"{n}_{f}" for n in KINECT_V2 for f in ("X", "Y", "Z", "Conf")]
    ]
    for at in range(FRAMES):
        rows.append(
            [1_593_777_707.5 + at / 15, *(v for point in joints[at] for v in (*point, 1.0 - 0.5 * (at == 3)))]
        )
    path = write(tmp_path / "a.csv", rows)
    path.write_text("Software : LSL_Kinect,Version : 1.0,Stream nominal rate : 15\n" + path.read_text())
    (table,) = tables(path, "kinect-v2")
    assert table.state["wrist_left"][:5].tolist() == [2, 2, 2, 1, 2]


def test_a_column_that_counts_rows_names_no_bodies(tmp_path: Path) -> None:
    rows = mediapipe_rows(made.landmarks(FRAMES), "{name}_{axis}")
    rows = [["id" if at == 0 else at, *row] for at, row in enumerate(rows)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "mediapipe")
    assert np.isfinite(table.position["wrist_left"]).all()
