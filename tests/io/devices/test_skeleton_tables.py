"""Tables of joints: Azure Kinect, Kinect v2, MediaPipe and others, with and without headers."""

from __future__ import annotations

from collections.abc import Callable
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
RIGHT = ["right_shoulder", "right_elbow", "right_wrist"]
Rows = list[list[object]]


def write(path: Path, rows: Rows, separator: str = ",") -> Path:
    path.write_text("\n".join(separator.join(map(str, row)) for row in rows) + "\n")
    return path


def azure(path: Path, change: Callable[[list[str]], list[str]] = list, body: tuple[int, ...] = (1,)) -> Path:
    """The table of Microsoft's extractor, its lines changed."""
    made.azure_csv(path, FRAMES, body=body)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    return path


def test_mkv_extractor(tmp_path: Path) -> None:
    def changed(lines: list[str]) -> list[str]:
        at = 2 + 4 * AZURE.index("WRIST_LEFT")
        for row, value in ((5, "1"), (6, "0"), (7, "3")):
            cells = lines[row + 1].split(";")
            lines[row + 1] = ";".join([*cells[:at], value, *cells[at + 1 :]])
        return lines

    (table,) = tables(azure(tmp_path / "any.name", changed), "azure-kinect")
    assert table.state["wrist_left"][4:8].tolist() == [2, 1, 0, 2]
    assert (table.body, table.frame, table.units, table.relative) == (1, CameraFrame.OPTICAL, "mm", False)
    assert_allclose(table.t_s, 0.200219 + 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert set(table.position) == set(ARM)
    for joint in ARM:  # half of the last printed digit, and the shift of body 1
        wanted = made.expected(joint, FRAMES, "optical") + np.array([0.1, 0, 0])
        assert_allclose(table.position[joint], wanted, atol=1e-9)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()
    assert (table.state["hand_right"] == JointState.INFERRED).all()
    assert any("hand_left, hand_right: confidence 0" in note for note in table.notes)


def test_two_bodies_absent_frames_and_one_body_after_the_other(tmp_path: Path) -> None:
    gone = [2 + 2 * frame for frame in range(10, 20)]  # the second body's rows of ten frames
    kept = lambda lines: [line for at, line in enumerate(lines) if at not in gone]  # noqa: E731
    path = azure(tmp_path / "a.csv", kept, (1, 4))
    first, second = tables(path, "azure-kinect")
    assert (first.body, second.body, len(second.t_s)) == (1, 4, FRAMES)
    assert_array_equal(first.t_s, second.t_s)
    absent = np.isnan(second.position["wrist_left"]).all(axis=1)
    assert_array_equal(np.flatnonzero(absent), np.arange(10, 20))
    assert not second.state["wrist_left"][10:20].any() and np.isfinite(first.position["wrist_left"]).all()
    path = azure(path, lambda lines: [lines[0], *lines[1::2], *lines[2::2]], (1, 2))
    first, second = tables(path, "azure-kinect")
    assert len(first.t_s) == len(second.t_s) == FRAMES and np.isfinite(second.position["wrist_left"]).all()


@pytest.mark.parametrize(
    ("per_joint", "leading", "end"),
    [(3, 0, ""), (7, 0, ""), (7, 1, ""), (4, 1, ""), (8, 2, ""), (3, 0, " "), (3, 0, "  ")],
)
def test_kinect_v2_without_header(tmp_path: Path, per_joint: int, leading: int, end: str) -> None:
    joints, mark = made.kinect_v2(FRAMES), "," if end else " "
    turn = {3: [], 4: [2], 7: [0.0, 0.6, 0.0, 0.8], 8: [0.0, 0.6, 0.0, 0.8, 2]}[per_joint]
    front = [[0.033 * at, 3][:leading] for at in range(FRAMES)]
    rows: Rows = [[*front[at], *(v for point in joints[at] for v in (*point, *turn))] for at in range(FRAMES)]
    path = write(tmp_path / "a.txt", rows, mark)
    path.write_text(path.read_text().replace("\n", f",{end[1:]}\n" if end else "\n"))
    (table,) = tables(path, "kinect-numbers")
    assert table.frame is CameraFrame.KINECT and table.body == (3 if leading == 2 else 0)
    if leading:
        assert_allclose(table.t_s, 0.033 * np.arange(FRAMES))
    assert_allclose(table.position["wrist_right"], joints[:, KINECT_V2.index("WristRight")], atol=1e-9)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()


def test_a_table_of_one_column_is_none_of_a_kinect(tmp_path: Path) -> None:
    """Its first line ends with a separator, and nothing would be left without that."""
    (tmp_path / "a.csv").write_text(",\ne\n1,")
    assert recognise(read_head(tmp_path / "a.csv")) is None


@pytest.mark.parametrize("style", ["{}_{}", "{}.{}", "{} {}", "joint_{}_{}", "{}({})"])
def test_kinect_v2_by_name(tmp_path: Path, style: str) -> None:
    joints, words = made.kinect_v2(FRAMES), ["Tracked", "Inferred", "NotTracked"]
    names = [style.format(n, f) for n in KINECT_V2 for f in ("X", "Y", "Z", "State")]
    rows: Rows = [["Time", "TrackingId", *names]]
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


@pytest.mark.parametrize("set_back", [0, 10])
def test_a_row_a_joint(tmp_path: Path, set_back: int) -> None:
    """Where the clock was set back, stamps of both sides are equal: frames must not be mixed."""
    joints = made.kinect_v2(FRAMES)
    rows: Rows = [["Timestamp", "JointID", "Position.X", "Position.Y", "Position.Z", "State"]]
    for at in range(FRAMES):
        stamp = 33.0 * (at - set_back * (at >= FRAMES // 2))
        rows += [[stamp, j, *np.round(joints[at, j], 6), 1 if j == 10 else 2] for j in range(25)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "joint-rows")
    assert table.frame is CameraFrame.KINECT and len(table.t_s) == FRAMES
    assert_allclose(repaired_skeleton(table, "a.csv").t_s, 0.033 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], joints[:, 7], atol=1e-6)
    assert (table.state["wrist_right"] == JointState.INFERRED).all()
    assert (table.state["wrist_left"] == JointState.TRACKED).all()


def mediapipe(style: str = "{name}_{axis}", points: np.ndarray | None = None) -> Rows:
    header = ["frame", "timestamp_ms"]
    for at, name in enumerate(BLAZEPOSE if "{name}" in style else range(33)):
        header += [style.format(name=name, at=at, axis=axis) for axis in ("x", "y", "z", "visibility")]
    points = made.landmarks(FRAMES) if points is None else points
    numbers = [
        [at, round(at * 1000 / 30), *(v for p in frame for v in (*p, 0.9))] for at, frame in enumerate(points)
    ]
    return [header, *numbers]  # type: ignore[list-item]


@pytest.mark.parametrize(
    "style", ["{axis}{at}", "landmark_{at}_{axis}", "{name}_{axis}", "{name}.world.{axis}", "beside"]
)
def test_mediapipe_world_landmarks(tmp_path: Path, style: str) -> None:
    points = made.landmarks(FRAMES)
    rows = mediapipe(style)
    if style == "beside":  # those in the image
        rows = mediapipe(points=0.5 + 0.2 * points)
        beside = mediapipe("{name}_world_{axis}")
        rows = [[*row, *other[2:]] for row, other in zip(rows, beside, strict=True)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "mediapipe")
    assert table.relative and table.frame is CameraFrame.OPTICAL
    assert any("relative to the hips" in note for note in table.notes)
    assert_allclose(table.t_s, np.arange(FRAMES) / 30, atol=6e-4)  # whole milliseconds
    for joint in ARM[:6]:
        name, _, side = joint.partition("_")
        wanted = points[:, BLAZEPOSE.index(f"{side}_{name}")]
        assert_allclose(table.position[joint], wanted, atol=1e-9)


def test_habits_of_landmarks(tmp_path: Path) -> None:
    """A low visibility; a hip that is not there; frames without times; a column that counts rows."""
    path, rows = tmp_path / "a.csv", mediapipe()
    rows[8][rows[0].index("right_wrist_visibility")] = 0.3
    (table,) = tables(write(path, rows), "mediapipe")
    assert np.flatnonzero(table.state["wrist_right"] == JointState.INFERRED).tolist() == [7]
    kept = [at for at, name in enumerate(rows[0]) if not str(name).startswith("left_hip")]
    (table,) = tables(write(path, [[row[at] for at in kept] for row in rows]), "mediapipe")
    assert table.relative and any("relative to the hips" in note for note in table.notes)
    without = [[row[0], *row[2:]] for row in rows]
    (table,) = tables(write(path, without[:11] + without[21:]), "mediapipe")
    assert table.rate_hz == 30.0 and np.diff(table.t_s).max() == pytest.approx(11 / 30)
    assert any("30 frames per second" in note for note in table.notes)
    (table,) = tables(write(path, [["id" if at == 0 else at, *r] for at, r in enumerate(rows)]), "mediapipe")
    assert np.isfinite(table.position["wrist_left"]).all()


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("cm", 100.0), ("m", 1.0)])
@pytest.mark.parametrize("z_up", [True, False])
def test_any_table_of_joints(tmp_path: Path, unit: str, scale: float, z_up: bool) -> None:
    names = [*RIGHT, "left_hip", "right_hip", "nose"]
    points = np.stack([made.part(name, FRAMES) for name in names], axis=1) + np.array([3.0, 0.0, 2.0])
    points = points[:, :, [0, 2, 1]] * [1, -1, 1] if z_up else points
    rows: Rows = [["t_s", *(f"body_{name}_{axis}" for name in names for axis in "xyz")]]
    rows += [[at / 30, *(scale * points[at]).ravel().tolist()] for at in range(FRAMES)]
    (table,) = tables(write(tmp_path / "a.csv", rows), "joint-table")
    assert table.units == unit and table.frame is (CameraFrame.ZUP if z_up else None)
    assert_array_equal(table.gravity_hint, [0, 0, -1] if z_up else [0, -1, 0])
    assert_allclose(table.position["wrist_right"], points[:, 2], atol=1e-9)


@pytest.mark.parametrize(
    ("time", "joints", "hips"),
    [
        ("Zeit (s)", ("Schulter rechts {}", "Ellenbogen rechts {}", "Handgelenk rechts {}"), ()),
        ("Temps (s)", ("Épaule droite {}", "Coude droit {}", "Poignet droit {}"), ()),
        ("Tiempo (s)", ("Hombro derecho {}", "Codo derecho {}", "Muñeca derecha {}"), ()),
        ("t_s", tuple(f"{name}_{{}}" for name in RIGHT), ("left_hip_{}", "right_hip_{}")),  # never seen
    ],
)
def test_other_languages_and_hips_that_were_never_seen(
    tmp_path: Path, time: str, joints: tuple[str, ...], hips: tuple[str, ...]
) -> None:
    places = np.stack([made.part(name, FRAMES) for name in RIGHT], axis=1)
    nothing = np.full((FRAMES, 3 * len(hips)), np.nan)
    numbers = np.column_stack([np.arange(FRAMES) / 30, places.reshape(FRAMES, -1), nothing])
    rows: Rows = [[time, *(joint.format(axis) for joint in (*joints, *hips) for axis in "xyz")]]
    rows += [[f"{value:.9g}".replace(".", ",") for value in row] for row in numbers]
    (table,) = tables(write(tmp_path / "a.csv", rows, ";"), "joint-table")
    assert_allclose(table.position["wrist_right"], places[:, 2], atol=1e-6)


def test_refusals(tmp_path: Path) -> None:
    points = np.stack([made.part(name, FRAMES) for name in RIGHT], axis=1) * 4000.0
    header = [f"{name}_{axis}" for name in RIGHT for axis in "xyz"]
    path = write(tmp_path / "a.csv", [header, *points.reshape(FRAMES, -1).tolist()])
    with pytest.raises(RecordingError, match=r"a\.csv: .*in neither m.*export positions in metres"):
        tables(path, "joint-table")

    def nobody(lines: list[str]) -> list[str]:
        return [lines[0], *(";".join([*row.split(";")[:2], *["0"] * 128]) for row in lines[1:])]

    with pytest.raises(RecordingError, match=r"a\.csv names joints and has no position"):
        tables(azure(path, nobody), "azure-kinect")


STYLES = (
    *("{name}_{axis} (mm)", "{name}_pos_{axis}", "{axis}_{name}", "{lower}.position.{axis}"),
    "K4ABT_JOINT_{name} {axis}",
)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize(
    ("time", "step"),
    [("timestamp_usec", 33_333), ("Time", 0.033333), ("ts_ms", 33.333), ("time [s]", 0.033333)],
)
def test_spellings(tmp_path: Path, style: str, time: str, step: float) -> None:
    header = [time] + [style.format(name=n, lower=n.lower(), axis=a) for n in AZURE for a in "xyz"]
    points = 1000 * np.stack([made.optical(made.part(name, FRAMES)) for name in AZURE], axis=1)
    rows: Rows = [header, *([at * step, *points[at].ravel().tolist()] for at in range(FRAMES))]
    (table,) = tables(write(tmp_path / "a.csv", rows), "azure-kinect")
    assert_allclose(table.t_s, 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], made.expected("hand_left", FRAMES, "optical"), atol=1e-9)


def test_lsl_kinect_with_shares_of_one(tmp_path: Path) -> None:
    joints = made.kinect_v2(FRAMES)
    rows: Rows = [["Timestamp"] + [f"{n}_{f}" for n in KINECT_V2 for f in ("X", "Y", "Z", "Conf")]]
    for at in range(FRAMES):
        cells = [v for point in joints[at] for v in (*point, 1.0 - 0.5 * (at == 3))]
        rows.append([1_593_777_707.5 + at / 15, *cells])
    path = write(tmp_path / "a.csv", rows)
    path.write_text("Software : LSL_Kinect,Version : 1.0,Stream nominal rate : 15\n" + path.read_text())
    (table,) = tables(path, "kinect-v2")
    assert table.state["wrist_left"][:5].tolist() == [2, 2, 2, 1, 2]
