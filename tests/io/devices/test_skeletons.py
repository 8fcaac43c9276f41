"""Skeletons of camera programs, landmarkers and motion capture: joints, units, states, which way is up."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skeleton_files as made
from importers import tables
from numpy.testing import assert_allclose, assert_array_equal

from smoother.errors import RecordingError
from smoother.io.registry import format_named, recognise
from smoother.io.tables.joints import AZURE, BLAZEPOSE, BODY_25, KINECT_V2, ZED_38, JointName, joint_name
from smoother.io.tables.table import read_head
from smoother.io.tables.times import repaired_skeleton
from smoother.recording import CameraFrame, JointState

FRAMES = 40
ARM = [f"{joint}_{side}" for joint in ("shoulder", "elbow", "wrist", "hand") for side in ("left", "right")]
RIGHT = ["right_shoulder", "right_elbow", "right_wrist"]
Rows = list[list[Any]]


def write(path: Path, content: Any, mark: str = ",") -> Path:
    """An array, rows of a table or a value in JSON, by the file's ending; a table may be changed as text."""
    if path.suffix == ".npy":
        np.save(path, content, allow_pickle=True)
    else:
        is_table = path.suffix == ".csv"
        lines = (mark.join(map(str, row)) for row in content) if is_table else ()
        path.write_text("\n".join(lines) + "\n" if is_table else json.dumps(content))
    return path


def one(path: Path, key: str, content: Any = None, mark: str = ",") -> Any:
    """The one skeleton of a file of that format."""
    (table,) = tables(path if content is None else write(path, content, mark), key)
    return table


def azure(path: Path, change: Callable[[list[str]], list[str]] = list, body: tuple[int, ...] = (1,)) -> Path:
    """The table of Microsoft's extractor, its lines changed."""
    made.azure_csv(path, FRAMES, body=body)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    return path


def z_up(points: np.ndarray) -> np.ndarray:
    return points[..., [0, 2, 1]] * [1, -1, 1]


# ------------------------------------------------------------------------------------ a row of all joints


def test_mkv_extractor(tmp_path: Path) -> None:
    def changed(lines: list[str]) -> list[str]:
        at = 2 + 4 * AZURE.index("WRIST_LEFT")
        for row, value in ((5, "1"), (6, "0"), (7, "3")):
            cells = lines[row + 1].split(";")
            lines[row + 1] = ";".join([*cells[:at], value, *cells[at + 1 :]])
        return lines

    table = one(azure(tmp_path / "any.name", changed), "azure-kinect")
    assert (table.body, table.frame, table.units, table.relative) == (1, CameraFrame.OPTICAL, "mm", False)
    assert_allclose(table.t_s, 0.200219 + 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert set(table.position) == set(ARM)
    for joint in ARM:  # half of the last printed digit, and the shift of body 1
        wanted = made.expected(joint, FRAMES, "optical") + np.array([0.1, 0, 0])
        assert_allclose(table.position[joint], wanted, atol=1e-9)
    assert table.state["wrist_left"][4:8].tolist() == [2, 1, 0, 2]
    assert (table.state["wrist_right"] == JointState.TRACKED).all()
    assert (table.state["hand_right"] == JointState.INFERRED).all()
    assert any("hand_left, hand_right: confidence 0" in note for note in table.notes)


def test_two_bodies_absent_frames_and_one_body_after_the_other(tmp_path: Path) -> None:
    gone = [2 + 2 * frame for frame in range(10, 20)]  # the second body's rows of ten frames
    kept = lambda lines: [line for at, line in enumerate(lines) if at not in gone]  # noqa: E731
    path = azure(tmp_path / "a.csv", kept, (1, 4))
    first, second = tables(path, "azure-kinect")
    assert (first.body, second.body) == (1, 4)
    assert_array_equal(first.t_s, second.t_s)
    absent = np.isnan(second.position["wrist_left"]).all(axis=1)
    assert_array_equal(np.flatnonzero(absent), np.arange(10, 20))
    assert not second.state["wrist_left"][10:20].any() and np.isfinite(first.position["wrist_left"]).all()
    path = azure(path, lambda lines: [lines[0], *lines[1::2], *lines[2::2]], (1, 2))
    first, second = tables(path, "azure-kinect")
    assert len(first.t_s) == len(second.t_s) == FRAMES and np.isfinite(second.position["wrist_left"]).all()


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
    points = 1000 * made.optical(made.parts(AZURE, FRAMES))
    rows = [header, *([at * step, *points[at].ravel().tolist()] for at in range(FRAMES))]
    table = one(tmp_path / "a.csv", "azure-kinect", rows)
    assert_allclose(table.t_s, 0.033333 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], made.expected("hand_left", FRAMES, "optical"), atol=1e-9)


@pytest.mark.parametrize(
    ("per_joint", "leading", "end"),
    [(3, 0, ""), (7, 0, ""), (7, 1, ""), (4, 1, ""), (8, 2, ""), (3, 0, " "), (3, 0, "  ")],
)
def test_kinect_v2_without_header(tmp_path: Path, per_joint: int, leading: int, end: str) -> None:
    joints = made.kinect_v2(FRAMES)
    turn = {3: [], 4: [2], 7: [0.0, 0.6, 0.0, 0.8], 8: [0.0, 0.6, 0.0, 0.8, 2]}[per_joint]
    front = [[0.033 * at, 3][:leading] for at in range(FRAMES)]
    rows = [[*front[at], *(v for point in joints[at] for v in (*point, *turn))] for at in range(FRAMES)]
    path = write(tmp_path / "a.csv", rows, "," if end else " ")
    path.write_text(path.read_text().replace("\n", f",{end[1:]}\n" if end else "\n"))
    table = one(path, "kinect-numbers")
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
    for at in range(FRAMES):  # .NET ticks
        cells = [v for point in joints[at] for v in (*np.round(point, 6), words[at % 3])]
        rows.append([f"{333_333 * at}", "72057594037928081", *cells])
    table = one(tmp_path / "a.csv", "kinect-v2", rows)
    assert table.frame is CameraFrame.KINECT
    assert_allclose(table.t_s, 0.0333333 * np.arange(FRAMES), atol=1e-9)
    assert_array_equal(table.state["wrist_left"][:6], [2, 1, 0, 2, 1, 0])
    wanted = joints[::3, KINECT_V2.index("ElbowLeft")]
    assert_allclose(table.position["elbow_left"][::3], wanted, atol=1e-6)
    assert table.body == 72057594037928081 % 2**32


def test_lsl_kinect_with_shares_of_one(tmp_path: Path) -> None:
    rows: Rows = [
        ["Software : LSL_Kinect", "Version : 1.0", "Stream nominal rate : 15"],
        ["Timestamp", *(f"{n}_{f}" for n in KINECT_V2 for f in ("X", "Y", "Z", "Conf"))],
    ]
    for at, frame in enumerate(made.kinect_v2(FRAMES)):
        cells = [v for point in frame for v in (*point, 1.0 - 0.5 * (at == 3))]
        rows.append([1_593_777_707.5 + at / 15, *cells])
    table = one(tmp_path / "a.csv", "kinect-v2", rows)
    assert table.state["wrist_left"][:5].tolist() == [2, 2, 2, 1, 2]


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000.0), ("cm", 100.0), ("m", 1.0)])
@pytest.mark.parametrize("is_up", [True, False])
def test_any_table_of_joints(tmp_path: Path, unit: str, scale: float, is_up: bool) -> None:
    names = [*RIGHT, "left_hip", "right_hip", "nose"]
    points = made.parts(names, FRAMES) + np.array([3.0, 0.0, 2.0])
    points = z_up(points) if is_up else points
    rows: Rows = [["t_s", *(f"body_{name}_{axis}" for name in names for axis in "xyz")]]
    rows += [[at / 30, *(scale * points[at]).ravel().tolist()] for at in range(FRAMES)]
    table = one(tmp_path / "a.csv", "joint-table", rows)
    assert table.units == unit and table.frame is (CameraFrame.ZUP if is_up else None)
    assert_array_equal(table.gravity_hint, [0, 0, -1] if is_up else [0, -1, 0])
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
    places = made.parts(RIGHT, FRAMES)
    nothing = np.full((FRAMES, 3 * len(hips)), np.nan)
    numbers = np.column_stack([np.arange(FRAMES) / 30, places.reshape(FRAMES, -1), nothing])
    rows: Rows = [[time, *(joint.format(axis) for joint in (*joints, *hips) for axis in "xyz")]]
    rows += [[f"{value:.9g}".replace(".", ",") for value in row] for row in numbers]
    table = one(tmp_path / "a.csv", "joint-table", rows, ";")
    assert_allclose(table.position["wrist_right"], places[:, 2], atol=1e-6)


@pytest.mark.parametrize("set_back", [0, 10])
def test_a_row_a_joint(tmp_path: Path, set_back: int) -> None:
    """Where the clock was set back, stamps of both sides are equal: frames must not be mixed."""
    joints = made.kinect_v2(FRAMES)
    rows: Rows = [["Timestamp", "JointID", "Position.X", "Position.Y", "Position.Z", "State"]]
    for at in range(FRAMES):
        stamp = 33.0 * (at - set_back * (at >= FRAMES // 2))
        rows += [[stamp, j, *np.round(joints[at, j], 6), 1 if j == 10 else 2] for j in range(25)]
    table = one(tmp_path / "a.csv", "joint-rows", rows)
    assert table.frame is CameraFrame.KINECT and len(table.t_s) == FRAMES
    assert_allclose(repaired_skeleton(table, "a.csv").t_s, 0.033 * np.arange(FRAMES), atol=1e-9)
    assert_allclose(table.position["hand_left"], joints[:, 7], atol=1e-6)
    assert (table.state["wrist_right"] == JointState.INFERRED).all()
    assert (table.state["wrist_left"] == JointState.TRACKED).all()


# ------------------------------------------------------------------------------------ landmarks


def mediapipe(style: str = "{name}_{axis}", points: np.ndarray | None = None) -> Rows:
    header = ["frame", "timestamp_ms"]
    for at, name in enumerate(BLAZEPOSE if "{name}" in style else range(33)):
        header += [style.format(name=name, at=at, axis=axis) for axis in ("x", "y", "z", "visibility")]
    points = made.landmarks(FRAMES) if points is None else points
    cells = [[v for point in frame for v in (*point, 0.9)] for frame in points]
    return [header, *([at, round(at * 1000 / 30), *row] for at, row in enumerate(cells))]


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
    table = one(tmp_path / "a.csv", "mediapipe", rows)
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
    table = one(path, "mediapipe", rows)
    assert np.flatnonzero(table.state["wrist_right"] == JointState.INFERRED).tolist() == [7]
    kept = [at for at, name in enumerate(rows[0]) if not str(name).startswith("left_hip")]
    table = one(path, "mediapipe", [[row[at] for at in kept] for row in rows])
    assert table.relative and any("relative to the hips" in note for note in table.notes)
    without = [[row[0], *row[2:]] for row in rows]
    table = one(path, "mediapipe", without[:11] + without[21:])
    assert table.rate_hz == 30.0 and np.diff(table.t_s).max() == pytest.approx(11 / 30)
    assert any("30 frames per second" in note for note in table.notes)
    table = one(path, "mediapipe", [["id" if at == 0 else at, *r] for at, r in enumerate(rows)])
    assert np.isfinite(table.position["wrist_left"]).all()


#: World landmarks in JSON, of a frame's number, points and points by name; "lines" are of JSON too.
FRAME: dict[str, Callable[[int, list[Any], dict[str, Any]], Any]] = {
    "rows": lambda at, points, _: {"timestamp_ms": 40 * at, "pose_world_landmarks": points},
    "lines": lambda at, points, _: {"t": 0.04 * at, "pose_world_landmarks": points},
    "tfjs": lambda at, _, by_name: {
        "timestamp": 40 * at,
        "keypoints3D": [{**point, "name": name} for name, point in by_name.items()],
    },
    "fps": lambda at, points, _: {"frame": at, "landmarks": points},
    "nested": lambda _, points, __: {"world_landmarks": [points], "landmarks": [points]},
    "names": lambda at, _, by_name: {"time": 0.04 * at, **by_name},
    "numbered": lambda _, __, by_name: by_name,
    "arrays": lambda _, points, __: [list(point.values()) for point in points],
}


@pytest.mark.parametrize("layout", FRAME)
def test_world_landmarks_in_json(tmp_path: Path, layout: str) -> None:
    points = made.landmarks(FRAMES)
    rows = [[dict(zip("xyz", p, strict=True), visibility=0.9) for p in frame] for frame in points.tolist()]
    named = (dict(zip(BLAZEPOSE, row, strict=True)) for row in rows)
    value: Any = [FRAME[layout](at, *both) for at, both in enumerate(zip(rows, named, strict=True))]
    if layout == "numbered":
        value = {"fps": 25, "positions": {f"{at}.0": frame for at, frame in enumerate(value)}}
    elif layout in ("fps", "nested", "names", "arrays"):
        value = {"fps": 25, "frames": value}
    path = write(tmp_path / "a.json", value)
    if layout == "lines":
        path.write_text("\n".join(map(json.dumps, value)))
    # no name in arrays: asked for by --skeleton-format
    table = format_named("pose-json").read(path)[0] if layout == "arrays" else one(path, "pose-json")
    assert table.relative and table.frame is CameraFrame.OPTICAL
    assert_allclose(table.position["elbow_left"], points[:, BLAZEPOSE.index("left_elbow")], atol=1e-12)
    assert_allclose(repaired_skeleton(table, "a.json").t_s, 0.04 * np.arange(FRAMES), atol=1e-9)


# ------------------------------------------------------------------------------------- other JSON, and arrays


def offline_processor(scale: float = 1000, **more: object) -> dict[str, object]:
    points = scale * made.optical(made.parts(AZURE, FRAMES))
    rows = []
    for at in range(FRAMES):
        bodies = [] if at in (3, 4) else [{"body_id": 2, "joint_positions": points[at].tolist(), **more}]
        rows.append({"bodies": bodies, "num_bodies": len(bodies), "timestamp_usec": 500 + 33_333 * at})
    return {"bone_list": [["NECK", "HEAD"]], "frames": rows, "joint_names": AZURE}


def test_offline_processor(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    table = one(path, "azure-kinect-json", offline_processor())
    assert (table.body, table.frame, table.units) == (2, CameraFrame.OPTICAL, "mm")
    assert_allclose(table.t_s, (500 + 33_333 * np.arange(FRAMES)) * 1e-6, atol=1e-12)
    there = np.delete(np.arange(FRAMES), [3, 4])
    wanted = made.expected("wrist_right", FRAMES, "optical")
    assert_allclose(table.position["wrist_right"][there], wanted[there], atol=1e-12)
    assert np.isnan(table.position["wrist_right"][3:5]).all()
    assert (table.state["wrist_right"][there] == JointState.TRACKED).all()
    levels = [1] * 8 + [0] * 3 + [2] * 4 + [0] * 3 + [2] * 14
    table = one(path, "azure-kinect-json", offline_processor(scale=1, confidence_levels=levels))
    states = {"wrist_left": {1}, "wrist_right": {2}, "hand_right": {1}}
    assert table.units == "m" and states == {joint: set(table.state[joint][5:].tolist()) for joint in states}
    path.write_text(path.read_text()[:20_000])
    with pytest.raises(RecordingError, match=r"a\.json should be JSON of body tracking.*is cut off"):
        tables(path, "azure-kinect-json")


STARTS = 1_700_000_000
ZED = [*AZURE, "HEEL_LEFT", "HEEL_RIGHT"]
PLACES = made.parts(ZED, FRAMES) - [0.0, 1.0, 2.5]


def points_of(places: np.ndarray, names: list[str], form: Callable[[str, dict[str, float]], Any]) -> Any:
    return [
        [form(name, dict(zip("xyz", place, strict=True))) for name, place in zip(names, frame, strict=True)]
        for frame in places.tolist()
    ]


def kinect_node(name: str, place: dict[str, float]) -> dict[str, float]:
    return {f"camera{axis.upper()}": value for axis, value in place.items()} | {
        "trackingState": 2,
        "colorX": 0.4,
    }


def kinect_net(name: str, place: dict[str, float]) -> tuple[str, dict[str, Any]]:
    return name, {"Position": {axis.upper(): value for axis, value in place.items()}, "TrackingState": 2}


def nuitrack(name: str, place: dict[str, float]) -> dict[str, Any]:
    real = {axis: 1000 * value for axis, value in place.items()}
    return {"type": f"JOINT_{name}", "confidence": 0.9, "real": real, "proj": {"x": 0.1, "y": 0.2, "z": 3}}


#: JSON of trackers: what a frame is, of its number and its points.
TRACKERS: dict[str, Callable[[], Any]] = {
    "zed": lambda: {
        str(1000 * STARTS + 40 * at): {
            "timestamp": 1_000_000 * (1000 * STARTS + 40 * at),
            "body_list": [{"id": 3, "keypoint": points, "keypoint_confidence": [80] * 34, "confidence": 90}],
        }
        for at, points in enumerate(PLACES.tolist())
    },
    "zed before 4": lambda: {
        str(1000 * STARTS + 40 * at): {"body_list": [{"id": 3, "keypoint": points}]}
        for at, points in enumerate(PLACES.tolist())
    },
    "nuitrack": lambda: [
        {"Timestamp": str(40_000 * at), "skeletons": [{"user_id": 3, "joints": points}]}
        for at, points in enumerate(points_of(PLACES, ZED, nuitrack))
    ],
    "kinect of node": lambda: [
        {"time": 0.04 * at, "bodies": [{"trackingId": 2**56 + 3, "tracked": True, "joints": points}]}
        for at, points in enumerate(points_of(made.kinect_v2(FRAMES), KINECT_V2, kinect_node))
    ],
    "kinect with numbers as text, and a frame without joints": lambda: [
        {"time": 0.04 * at, "bodies": [{"trackingId": f"{2**56 + 3}", "joints": points if at else None}]}
        for at, points in enumerate(points_of(made.kinect_v2(FRAMES), KINECT_V2, kinect_node))
    ],
    "kinect of .NET": lambda: [
        {"RelativeTime": f"00:00:{0.04 * at:010.7f}", "Bodies": [{"TrackingId": 3, "Joints": dict(points)}]}
        for at, points in enumerate(points_of(made.kinect_v2(FRAMES), KINECT_V2, kinect_net))
    ],
}


@pytest.mark.parametrize("tracker", TRACKERS)
def test_json_of_other_trackers(tmp_path: Path, tracker: str) -> None:
    assert ZED_38[16:18] == ["LEFT_WRIST", "RIGHT_WRIST"]
    table = one(tmp_path / "a.json", "azure-kinect-json", TRACKERS[tracker]())
    lost = int("without joints" in tracker)
    assert table.body == 3 and (table.state["wrist_right"][lost:] == JointState.TRACKED).all()
    by_name = dict(zip(KINECT_V2, np.moveaxis(made.kinect_v2(FRAMES), 1, 0), strict=True))
    wanted = by_name["WristRight"] if "kinect" in tracker else PLACES[:, ZED.index("WRIST_RIGHT")]
    assert_allclose(table.position["wrist_right"][lost:], wanted[lost:], atol=1e-9)
    assert_allclose(np.diff(table.t_s), 0.04, atol=1e-6)
    assert table.frame is (CameraFrame.KINECT if "kinect" in tracker else None)


@pytest.mark.parametrize("key", ["timestamp", "captured"])
def test_times_of_json_are_dates_or_rise(tmp_path: Path, key: str) -> None:
    stamp: Callable[[int], Any] = lambda at: f"2026-03-12T10:00:{0.04 * at:06.3f}Z"  # noqa: E731
    stamp = stamp if key == "timestamp" else lambda at: 500.0 + 40 * at
    joints = {name: made.part(name, FRAMES).tolist() for name in ("RShoulder", "RElbow", "RWrist")}
    frames = [{"frame": at, key: stamp(at), **{n: p[at] for n, p in joints.items()}} for at in range(FRAMES)]
    table = one(tmp_path / "a.json", "pose-json", frames)
    assert_allclose(np.diff(table.t_s), 0.04, atol=1e-6)
    assert key == "timestamp" or any("key captured was taken for the time, in ms" in n for n in table.notes)


MARKERS = ["RShoulder", "RElbow", "RWrist", "Head", "RHip"]
FILLED = ",".join(name + ",," for name in MARKERS)
THREE = ",".join("X,Y,Z" for _ in MARKERS)
#: Lines above markers of Nexus and of Motive, and whether the time is a column.
ABOVE = {
    "nexus": (["Trajectories", "100", f",,{FILLED}", f"Frame,Sub Frame,{THREE}", "," + ",mm" * 15], False),
    "motive": (
        [
            "Format Version,1.23,Take Name,a,Capture Frame Rate,120.0,Length Units,Meters",
            "",
            ",Type" + ",Marker" * 15,
            ",Name," + ",".join(f"S:{name}" for name in MARKERS for _ in range(3)),
            ",ID," + ",".join(f"F{at}" for at in range(5) for _ in range(3)),
            "," + ",Position" * 15,
            f"Frame,Time (Seconds),{THREE}",
        ],
        True,
    ),
}


@pytest.mark.parametrize("program", ABOVE)
def test_markers_named_above_their_axes(tmp_path: Path, program: str) -> None:
    lines, is_timed = ABOVE[program]
    places = made.parts(MARKERS, FRAMES)
    for at, frame in enumerate(places.reshape(FRAMES, -1).tolist()):
        lines = [*lines, ",".join(map(str, [at + 1, 0.01 * at if is_timed else 0, *frame]))]
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    table = one(tmp_path / "a.csv", "joint-table")
    assert_allclose(table.position["wrist_right"], places[:, 2], atol=1e-9)
    assert_allclose(np.diff(repaired_skeleton(table, "a.csv").t_s), 0.01, atol=1e-9)


def test_openpose_in_space_and_in_the_image(tmp_path: Path) -> None:
    flat = [np.column_stack([frame, np.full(25, 0.8)]).ravel().tolist() for frame in made.body_25(FRAMES)]
    value: Any = [{"version": 1.3, "people": [{"pose_keypoints_3d": row}]} for row in flat]
    table = one(tmp_path / "a.json", "pose-json", value)
    assert not table.relative
    assert_array_equal(table.gravity_hint, [0, -1, 0])
    assert_allclose(table.position["wrist_right"], made.expected("wrist_right", FRAMES), atol=1e-12)
    row = [value for at in range(25) for value in (10.0 * at, 5.0 * at, 0.8)]
    row[3 * 4 : 3 * 4 + 3] = [0.0, 0.0, 0.0]  # the right wrist was not found
    value = {"fps": 25, "frames": [{"people": [{"pose_keypoints_2d": row}]}, {"people": []}] * 3}
    table = one(tmp_path / "a.json", "pose-json", value)
    assert (table.units, table.frame) == ("pixels", CameraFrame.OPTICAL)
    assert_allclose(table.t_s, np.arange(6) / 25)
    assert_allclose(table.position["elbow_right"][0], [30.0, 15.0, 0.8])
    assert np.isnan(table.position["elbow_right"][1]).all() and np.isnan(table.position["wrist_right"]).all()
    assert table.state["elbow_right"].tolist() == [2, 0] * 3


def test_coco_takes_the_surest_person_and_its_visibilities(tmp_path: Path) -> None:
    def person(image: int, at: float, **more: float) -> dict[str, object]:
        return {"image_id": image, "keypoints": [v for k in range(17) for v in (at + k, at, k % 3)], **more}

    listed = [person(2, 50.0, area=10), person(1, 100.0, area=5), person(1, 200.0, area=9)]
    value = {"images": [{"id": 1}, {"id": 2}, {"id": 3}], "annotations": listed}
    table = one(tmp_path / "a.json", "pose-json", value)
    elbow = table.position["elbow_left"]  # COCO's eighth: 7 % 3 = 1, labelled and hidden
    assert_allclose(elbow[:2], [[207.0, 200.0, 0.3], [57.0, 50.0, 0.3]])
    assert np.isnan(elbow[2]).all() and table.state["elbow_left"].tolist() == [1, 1, 0]
    assert "30 frames per second" in " ".join(table.notes)


@pytest.mark.parametrize("points", [33, 553])
def test_freemocap_array(tmp_path: Path, points: int) -> None:
    array = np.full((FRAMES, points, 3), np.nan)
    array[:, :33] = 1000 * z_up(made.parts(BLAZEPOSE, FRAMES))
    table = one(tmp_path / "a.npy", "joint-array", array)
    assert (table.frame, table.units, table.relative) == (CameraFrame.ZUP, "mm", False)
    wanted = array[:, BLAZEPOSE.index("left_wrist")] / 1000
    assert_allclose(table.position["wrist_left"], wanted, atol=1e-12)
    assert table.rate_hz == 30.0


IN_IMAGE = (0.5 + 0.2 * made.landmarks(FRAMES)).tolist()
#: What is refused, of each format, and what is said.
REFUSED = [
    (
        "joint-table",
        [
            [f"{name}_{axis}" for name in RIGHT for axis in "xyz"],
            *(4000 * made.parts(RIGHT, FRAMES)).reshape(FRAMES, -1).tolist(),
        ],
        r"a\.csv: .*in neither m.*export positions in metres",
    ),
    (
        "pose-json",
        {
            "positions": {
                f"{k}.0": dict(zip(BLAZEPOSE, frame, strict=True)) for k, frame in enumerate(IN_IMAGE)
            }
        },
        "not metres; export pose_world_landmarks",
    ),
    (
        "pose-json",
        [{"people": [{"pose_keypoints_2d": [1.0] * 33}]}] * 5,
        "11 keypoints per person are not a known set",
    ),
    ("joint-array", np.zeros((10, 7, 3)), r"a\.npy is an array of 10 x 7 x 3"),
    ("joint-array", np.array([{"a": 1}]), r"a\.npy was recognised as array of joints.*is damaged"),
]


@pytest.mark.parametrize(("key", "content", "said"), REFUSED)
def test_what_holds_no_joints_in_space_is_refused(tmp_path: Path, key: str, content: Any, said: str) -> None:
    path = tmp_path / {"pose-json": "a.json", "joint-array": "a.npy"}.get(key, "a.csv")
    with pytest.raises(RecordingError, match=said):
        one(path, key, content)


def test_nobody_in_view(tmp_path: Path) -> None:
    def nobody(lines: list[str]) -> list[str]:
        return [lines[0], *(";".join([*row.split(";")[:2], *["0"] * 128]) for row in lines[1:])]

    with pytest.raises(RecordingError, match=r"a\.csv names joints and has no position"):
        tables(azure(tmp_path / "a.csv", nobody), "azure-kinect")


# --------------------------------------------------------------------------- markers that are called joints

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


POSE2SIM = [name for name in BODY_25 if name[-3:] not in ("Eye", "Ear")]
R_ARM = ["RShoulder", "RElbow", "RWrist"]
#: Names of markers, how the body stands, the unit that is stated and the scale of the values; what is found.
TRC = {
    "Pose2Sim in m": (POSE2SIM, np.array, "m", 1.0, None, [0, -1, 0], ""),
    "Pose2Sim in mm": (POSE2SIM, np.array, "mm", 1000.0, None, [0, -1, 0], ""),
    "Azure Kinect": (AZURE, made.optical, "m", 1.0, CameraFrame.OPTICAL, None, ""),
    "z up": (BODY_25[:9], z_up, "m", 1.0, CameraFrame.ZUP, [0, 0, -1], "Assumed axes: z up"),
    "an arm alone": (R_ARM, np.array, "m", 1.0, None, [0, -1, 0], "y up, as usual in this format"),
    "another unit": (R_ARM, np.array, "m", 1000.0, None, [0, -1, 0], "positions: mm, not the usual m"),
}


@pytest.mark.parametrize("case", TRC)
def test_trc(tmp_path: Path, case: str) -> None:
    names, placed, unit, scale, frame, down, said = TRC[case]
    path = tmp_path / "a.dat"  # the name is not what recognises it
    prefix = "K4ABT_JOINT_" if names is AZURE else ""
    made.trc(path, {prefix + name: scale * placed(made.part(name, FRAMES)) for name in names}, unit)
    table = one(path, "trc")
    assert_allclose(table.position["wrist_right"], placed(made.part("RWrist", FRAMES)), atol=1e-6)
    assert_allclose(table.t_s, np.arange(FRAMES) / 30, atol=1e-8)
    assert (table.frame, table.units) == (frame, unit)
    assert_array_equal(table.gravity_hint, down)
    assert (table.state["wrist_right"] == JointState.TRACKED).all()
    assert said in " ".join(table.notes)


def test_joint_centres_before_skin_markers_and_lost_ones(tmp_path: Path) -> None:
    path, shift = tmp_path / "a.trc", np.array([0.03, 0.0, 0.0])
    shoulder, elbow, wrist = (made.part(name, FRAMES) for name in R_ARM)
    lost = np.where((np.arange(FRAMES) // 4 == 1)[:, None], 0.0, wrist)
    points = {"r_shoulder_study": shoulder + shift, "RShoulder": shoulder, "RWRA": wrist + shift}
    points |= {"RWJC": lost, "r_lelbow_study": elbow + shift, "r_melbow_study": elbow - shift}
    made.trc(path, points)
    table = one(path, "trc")
    for joint, place in (("shoulder", shoulder), ("elbow", elbow), ("wrist", lost)):
        wanted = np.where((place == 0).all(axis=1, keepdims=True), np.nan, place)
        assert_allclose(table.position[f"{joint}_right"], wanted, atol=1e-6)
    assert table.state["wrist_right"][3:9].tolist() == [2, 0, 0, 0, 0, 2]
    words = " ".join(table.notes)
    assert "shoulder_right is the marker RShoulder" in words
    assert "elbow_right is the middle of r_lelbow_study and r_melbow_study" in words
    assert "wrist_right is the joint centre RWJC" in words and "Skin markers" in words
    hips = {name: made.part("LHip", FRAMES) for name in ("LASI", "RASI", "LWRIST")}
    for others, said in (
        ({name: 1e9 * rows for name, rows in points.items()}, r"a\.trc"),  # no length of an arm
        (hips, r"a\.trc: no arm with an elbow and a wrist.*LASI.*export"),
    ):
        made.trc(path, others, "mm")
        with pytest.raises(RecordingError, match=said):
            tables(path, "trc")


@pytest.mark.parametrize("names", [("RSJC", "REJC", "RWJC"), ("Subject:RShoulder", "RElbow", "RWrist")])
def test_c3d(tmp_path: Path, names: tuple[str, ...]) -> None:
    points, labels = z_up(made.parts([*R_ARM, "LHip", "Head"], FRAMES)), [*names, "LHip", "Head"]
    path = made.c3d(tmp_path / "a.c3d", 1000 * points, rate=30.0, labels=labels)
    table = one(path.rename(tmp_path / "any.bin"), "c3d")
    assert (table.frame, table.units) == (CameraFrame.ZUP, "mm")
    assert_allclose(table.position["wrist_right"], points[:, 2], atol=1e-6)  # single precision of mm
    assert table.rate_hz == pytest.approx(30.0)


def test_theia_segments_in_c3d(tmp_path: Path) -> None:
    labels = ["r_uarm_4X4", "r_larm_4X4", "r_hand_4X4", "pelvis_4X4", "head_4X4", "r_foot_4X4", "l_larm_4X4"]
    names = ["RShoulder", "RElbow", "RWrist", "pelvis", "Head", "RAnkle", "LElbow"]
    origins = [z_up(made.part(name, FRAMES)) for name in names]
    segments = {label: 1000 * rows for label, rows in zip(labels, origins, strict=True)}
    path = made.c3d(tmp_path / "a.c3d", np.ones((FRAMES, 1, 3)), rate=60.0, segments=segments)
    table = one(path, "c3d")
    assert set(table.position) == {"shoulder_right", "elbow_right", "wrist_right", "elbow_left"}
    assert_allclose(table.position["wrist_right"], origins[2], atol=1e-6)  # single precision of mm
    assert (table.frame, table.rate_hz) == (CameraFrame.ZUP, 60.0)
    assert any("origins of the segments r_uarm_4X4" in note for note in table.notes)
