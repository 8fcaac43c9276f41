"""Skeletons in tables, arrays and JSON: with joints in the header, a row per joint, by number, by frame.

Tables with a header and one row per frame are a row of `SKELETON_FORMATS` each.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ..recording.streams import SkeletonTable
from .joints import (
    AZURE,
    BLAZEPOSE,
    BODY_WORDS,
    FRAME_WORDS,
    KINECT_V2,
    POINT_SETS,
    TIME_WORDS,
    column_named,
    find_joint_columns,
    has_arm,
    joint_name,
    plain_words,
    program_of,
    time_among,
    time_unit_of,
)
from .skeletons import (
    AZURE_AXES,
    KINECT_AXES,
    PIXELS,
    STATE_WORDS,
    Conventions,
    RawSkeleton,
    gathered,
    unit_by_arm,
)
from .table import DeviceTable, FileHead, Format, begins, decode, read_bytes, read_table, seconds_of_dates
from .units import CAMERA_RATES, time_unit


def state_numbers(table: DeviceTable, column: int) -> FloatArray:
    """A column of confidences or states; words as `STATE_WORDS` has them, also behind a prefix."""
    cells = [cell.lower() for cell in table.texts(column)]
    sample = next((cell for cell in cells if cell), "")
    if not any(map(str.isalpha, sample)) or sample == "nan":
        return table.numbers(column)
    code = {
        cell: STATE_WORDS.get(cell, STATE_WORDS.get(cell.rpartition("_")[2], np.nan)) for cell in set(cells)
    }
    return np.array([code[cell] for cell in cells])


def body_numbers(table: DeviceTable, column: int) -> FloatArray:
    """A column of the bodies' numbers; names are numbered in their order, no body (-1, 2^32 - 1) is nan."""
    cells = table.texts(column)
    if any(cell.isdigit() and int(cell) >= 2**53 for cell in cells[:50]):  # a Kinect v2's begin at 2^56
        return np.array([float(int(cell) % 2**32) if cell.isdigit() else np.nan for cell in cells])
    if any(character.isalpha() for cell in cells[:50] for character in cell if cell.lower() != "nan"):
        order = {cell: float(number) for number, cell in enumerate(dict.fromkeys(cells)) if cell}
        return np.array([order.get(cell, np.nan) for cell in cells])
    numbers = table.numbers(column).copy()
    numbers[(numbers < 0) | (numbers == 2**32 - 1)] = np.nan
    return numbers


# ---------------------------------------------------------------------------------------- one row per frame


def _header_of(head: FileHead) -> tuple[str, ...]:
    return () if head.table is None else head.table.names


def _read_wide(path: Path, conventions: Conventions | None) -> list[SkeletonTable]:
    """Read all bodies of a table with one row per frame and body; without conventions they are landmarks."""
    table = read_table(path, "a table of joints")
    table.refuse_nameless()
    columns = find_joint_columns(table.names)
    raw = RawSkeleton(path, notes=table.notes)
    raw.add_columns(columns, table.numbers, partial(state_numbers, table))
    time, unit = columns.time, ""
    if time is None:
        time, unit = time_among(table, columns.others(table.width), CAMERA_RATES, raw.notes)
    if time is not None:
        raw.set_times(table, time)
        raw.time_unit = raw.time_unit or unit
        assert raw.time is not None
        step = np.diff(raw.time[np.isfinite(raw.time)])
        counts = len(step) > 2 and (step == 1).mean() > 0.5 and np.isin(step, np.arange(100)).all()
        if counts and not raw.time_unit:  # whole numbers, the next one at nearly every row
            raw.frame, raw.time = raw.time, None
    elif columns.frame is not None:
        raw.frame = table.numbers(columns.frame)
    raw.rate_hz = table.above_rate_hz()
    if columns.body is not None:
        raw.body = body_numbers(table, columns.body)
    if conventions is None:
        return raw.landmarks(columns.world, columns.normalised)
    return raw.skeletons(conventions)


def _wide_format(
    key: str, title: str, recognised_by: str, program: str, conventions: Conventions | None
) -> Format:
    def recognises(head: FileHead) -> bool:
        columns = find_joint_columns(_header_of(head))
        is_numbered = columns.numbered or columns.world
        found = program_of(_header_of(head)) or ("blazepose" if is_numbered else "")
        return has_arm(columns.axes) and program in ("", found)

    read = partial(_read_wide, conventions=conventions)
    return Format(key, title, "skeleton", recognised_by, recognises, read)


#: Where two recognise a table, the upper one has it.
SKELETON_FORMATS = (
    # Positions in mm in the depth camera's axes, times in us. Confidence 2 and 3 is tracked, 1 (occluded,
    # guessed) inferred, 0 (out of range) not tracked. Orbbec's wrapper of this SDK writes the same joints.
    _wide_format(
        "azure-kinect",
        "Azure Kinect or Orbbec body tracking, table",
        "columns x, y, z of joints by the SDK's names (SPINE_NAVEL, CLAVICLE_LEFT, WRIST_RIGHT ..)",
        "azure",
        AZURE_AXES,
    ),
    # Positions in m, x left, y up, z forward; tracking states 0, 1, 2 or in words where there are any.
    _wide_format(
        "kinect-v2",
        "Kinect v2 joints, table",
        "columns x, y, z of joints by the SDK's names (SpineBase, SpineShoulder, WristRight ..)",
        "kinect",
        KINECT_AXES,
    ),
    # BlazePose's 33 landmarks by number or name; world landmarks are metres about the hips.
    _wide_format(
        "mediapipe",
        "MediaPipe world landmarks, table",
        "columns x, y, z of 33 numbered landmarks, or of landmarks such as right_pinky, mouth_left",
        "blazepose",
        None,
    ),
    # The unit is found by the arms' lengths, up by how the body stands.
    _wide_format(
        "joint-table",
        "table of joints by name (FreeMoCap, Pose2Sim and others)",
        "columns x, y, z of an elbow and a wrist of one side, such as right_wrist_x or RWrist_X",
        "",
        Conventions(),
    ),
)

# ---------------------------------------------------------------------------------------- one row per joint

_COLUMNS = {
    **{
        axis: (axis, f"position {axis}", f"pos {axis}", f"world {axis}", f"{axis} world", f"{axis} position")
        for axis in "xyz"
    },
    "joint": (
        *("joint", "jointid", "joint id", "joint name", "jointname", "joint type", "jointtype", "landmark"),
        *("landmark id", "landmark name", "landmark index", "landmark idx", "keypoint", "keypoint id"),
        *("point", "marker", "body part", "bodypart", "name", "keypoint name", "joint index", "landmark no"),
    ),
    "time": TIME_WORDS,
    "frame": FRAME_WORDS,
    "body": BODY_WORDS,
    "state": (
        *("state", "tracking state", "trackingstate", "confidence", "confidence level", "visibility", "conf"),
        "score",
    ),
}


def _joint_columns(names: tuple[str, ...]) -> dict[str, int]:
    """Columns by what they are; {} where the table has no row per joint."""
    found = {what: at for what, words in _COLUMNS.items() if (at := column_named(names, words)) is not None}
    return found if {"joint", *"xyz"} <= found.keys() and {"time", "frame"} & found.keys() else {}


def _read_joint_rows(path: Path) -> list[SkeletonTable]:
    """One row per joint, joints by name or by their number in a Kinect v2, an Azure Kinect or BlazePose."""
    table = read_table(path, "a table with one row per joint")
    columns = _joint_columns(table.names)
    if not columns:
        raise RecordingError(
            f"{path} has no columns for joint, x, y, z and a time or frame; export it with these."
        )
    names, kind = _joints(table, columns["joint"])
    raw = RawSkeleton(path, notes=table.notes)
    if "time" in columns:
        raw.set_times(table, columns["time"])
    frame = table.numbers(columns["frame"]) if "frame" in columns else None
    key = raw.time if frame is None else frame
    assert key is not None
    body = body_numbers(table, columns["body"]) if "body" in columns else np.zeros(len(key))
    points = table.vectors([columns[axis] for axis in "xyz"])
    if "state" in columns:
        points = np.column_stack([points, state_numbers(table, columns["state"])])
    first, by_joint = gathered(key, body, names, points)
    raw.time = None if raw.time is None else raw.time[first]
    raw.frame = None if frame is None else frame[first]
    raw.body = body[first] if "body" in columns else None
    for name, rows in by_joint.items():
        raw.add(name, rows)
    if kind == "blazepose":
        return raw.landmarks(any("world" in plain_words(table.names[columns[axis]]) for axis in "xyz"))
    return raw.skeletons({"azure": AZURE_AXES, "kinect": KINECT_AXES}.get(kind, Conventions()))


JOINT_ROWS = Format(
    "joint-rows",
    "table with one row per joint",
    "skeleton",
    "columns for joint (or landmark), x, y, z, and a time or frame number",
    lambda head: bool(_joint_columns(_header_of(head))),
    _read_joint_rows,
)


def _joints(table: DeviceTable, column: int) -> tuple[list[str], str]:
    """Name of the joint of every row, and whose joints they are."""
    cells = table.texts(column)
    different = set(cells)
    if not all(cell.isdigit() for cell in different):
        return cells, program_of(sorted(different))
    last = max(int(cell) for cell in different)
    for order, kind in ((KINECT_V2, "kinect"), (AZURE, "azure"), (BLAZEPOSE, "blazepose")):
        if last == len(order) - 1:
            return [order[int(cell)] for cell in cells], kind
    raise RecordingError(
        f"{table.path}: joints are numbered 0 to {last}, which is neither a Kinect v2 (24), an Azure Kinect"
        " (31) nor BlazePose (32); export their names."
    )


# ----------------------------------------------------------------------------------------- joints by number

#: Columns in front of the joints at most: a time and a body's number.
_LEADING = 2
#: Left and right arms are equally long within this share.
_SAME = 0.25


def _numbered(table: DeviceTable) -> tuple[list[str], int, FloatArray, FloatArray] | None:
    """Names of joints, numbers of each, the columns in front of them, and points (N, joints, 3 or 4).

    They are the joints of a Kinect's SDK that fit the table's width and make two arms of an arm's length, of
    3 numbers (a position), 4 (with a state), 7 (with a quaternion) or 8 (with both) each.
    """
    rows = table.vectors(range(table.width))
    if not np.isfinite(rows[:, -1]).any():  # a separator at the end of the line makes an empty column
        rows = rows[:, :-1]
    for names in (AZURE, KINECT_V2):
        for per_joint in (3, 4, 7, 8):
            leading = rows.shape[1] - per_joint * len(names)
            if not 0 <= leading <= _LEADING:
                continue
            cells = rows[:, leading:].reshape(len(rows), len(names), per_joint)
            state_last = cells[..., [0, 1, 2, -1]] if per_joint in (4, 8) else cells[..., :3]
            for points in (state_last, *([cells[..., [1, 2, 3, 0]]] if per_joint == 4 else [])):
                if _are_arms(names, points):
                    return names, per_joint, rows[:, :leading], points
    return None


def _are_arms(names: list[str], points: FloatArray) -> bool:
    """Whether states are codes from 0 to 3 or shares of one, and both arms an arm's length."""
    states = points[..., 3][np.isfinite(points[..., 3])] if points.shape[2] > 3 else np.zeros(1)
    is_code = (states % 1 == 0) & (states <= 3)
    if not ((states >= 0) & (is_code | (states <= 1))).all():
        return False
    lengths = []
    joints = {name.joint: at for at, each in enumerate(names) if (name := joint_name(each))}
    for side in ("left", "right"):
        arm = {joint: points[:, at, :3] for joint, at in joints.items() if joint.endswith(side)}
        if (unit := unit_by_arm(arm)) is None:
            return False
        length = np.linalg.norm(arm[f"shoulder_{side}"] - arm[f"elbow_{side}"], axis=1)
        lengths.append(float(np.nanmedian(length)) * unit[1])
    return min(lengths) > 0 and abs(lengths[0] - lengths[1]) < _SAME * max(lengths)


def _are_kinect_numbers(head: FileHead) -> bool:
    """Whether rows have this many numbers, and both arms an arm's length in them."""
    if not head.text:
        return False
    try:
        table = read_table(head.path, text="\n".join(head.lines[:40]) + "\n")
        return bool(not table.names and len(table) and _numbered(table) is not None)
    except RecordingError:
        return False


def _read_kinect_numbers(path: Path) -> list[SkeletonTable]:
    """32 or 25 joints of 3, 4, 7 or 8 numbers, with or without a time and a body's number in front."""
    table = read_table(path, "rows of numbers of a Kinect's joints")
    if (found := _numbered(table)) is None:
        raise RecordingError(
            f"{path}: {table.width} numbers per row are not 32 joints of an Azure Kinect or 25 of a"
            " Kinect v2 in their SDK's order; export the table with a header."
        )
    names, per_joint, leading, points = found
    raw, is_azure = RawSkeleton(path, notes=list(table.notes)), names is AZURE
    for at, name in enumerate(names):
        raw.add(name, points[:, at])
    for column in leading.T:  # time and body in front of the joints: what rises is the time
        step = np.diff(column)
        if raw.time is None and len(step) and (step >= 0).all() and (step > 0).any():
            if np.isin(step, (0, 1)).all() and (column % 1 == 0).all():
                raw.frame = column
            elif time_unit("", column, CAMERA_RATES) is not None:
                raw.time = column
        elif raw.body is None and (column % 1 == 0).all():
            raw.body = column
    device = "32 joints of an Azure Kinect" if is_azure else "25 joints of a Kinect v2"
    raw.notes.append(f"Rows assumed to be {device}, {per_joint} numbers each, in the SDK's order.")
    return raw.skeletons(AZURE_AXES if is_azure else KINECT_AXES)


KINECT_NUMBERS = Format(
    "kinect-numbers",
    "Azure Kinect or Kinect v2 joints without a header",
    "skeleton",
    "no header, and 32 or 25 joints of 3, 4, 7 or 8 numbers whose arms are as long as arms",
    _are_kinect_numbers,
    _read_kinect_numbers,
)


def _read_joint_array(path: Path) -> list[SkeletonTable]:
    """An array of frames, points and x, y, z (and a score); points are identified by their number."""
    array = np.load(path, allow_pickle=False)
    if array.ndim == 2:
        widths = (w for w in (3, 4) if array.shape[1] % w == 0 and array.shape[1] // w in POINT_SETS)
        if width := next(widths, 0):
            array = array.reshape(len(array), -1, width)
    known = array.ndim == 3 and array.shape[2] in (3, 4) and array.shape[1] in POINT_SETS and len(array)
    if array.dtype.kind not in "fiu" or not known:
        shape = " x ".join(map(str, array.shape))
        points = ", ".join(map(str, sorted(POINT_SETS)))
        raise RecordingError(
            f"{path} is an array of {shape} {array.dtype}; joints are numbers of frames x points x 3, of"
            f" {points} points."
        )
    names = POINT_SETS[array.shape[1]]
    raw = RawSkeleton(path)
    for at, name in enumerate(names):
        raw.add(name, array[:, at].astype(float))
    raw.notes.append(f"{array.shape[1]} points per frame, assumed in the order {names[0]} .. {names[-1]}.")
    if names is BLAZEPOSE:
        return raw.landmarks(world=False)
    usual = AZURE_AXES if names is AZURE else Conventions()
    return raw.skeletons(replace(usual, states="share"))


JOINT_ARRAY = Format(
    "joint-array",
    "array of joints, npy (FreeMoCap)",
    "skeleton",
    "numpy's npy file of an array of frames x points x 3 (or 4)",
    begins(b"\x93NUMPY"),
    _read_joint_array,
)


#: x, y, z and the confidence of a point; of a keypoint u, v, and the score twice.
Point = tuple[float, float, float, float]
NAN = float("nan")
NOTHING: Point = (NAN,) * 4

# ---------------------------------------------------------------------------------------- values and points


def _read_json(path: Path, expected: str) -> Any:
    """The value that a JSON file contains, or a list of those of its lines."""
    text = decode(read_bytes(path))
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        lines = [line for line in text.splitlines() if line.strip()]
        rows: list[Any] = []
        with suppress(ValueError, RecursionError):
            rows += (json.loads(line) for line in lines)
        if len(rows) > 1 and len(rows) >= len(lines) - 1:
            return rows
        where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise RecordingError(
            f"{path} should be {expected}, and its JSON is cut off or damaged{where}; copy it again."
        ) from None


def _number(value: Any) -> float:
    """A number, or nan for anything else (words of confidence count 0 to 3)."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if abs(value) < 1e300 else NAN
    word = value.lower().rpartition("_")[2] if isinstance(value, str) else ""
    with suppress(ValueError):
        return STATE_WORDS[word] if word in STATE_WORDS else float(value if word else "")
    return NAN


def _first(value: Any, names: Iterable[str]) -> Any:
    """What is under the first of these names that is there and not empty."""
    return next((value[name] for name in names if value.get(name)), None)


def _first_number(value: Any, names: Iterable[str], default: float = NAN) -> float:
    """The number under the first of these names that is there."""
    there = value if isinstance(value, Mapping) else {}
    return next((_number(there[name]) for name in names if name in there), default)


_PLACES = ("position", "pos", "xyz", "location", "point", "real")
_NAMES = ("name", "type", "joint", "JointType", "jointType", "joint_type", "joint_name")
_SHARES = "visibility confidence confidence_level state trackingstate tracking_state score".split()  # noqa: SIM905


def _point_of(value: Any) -> Point:
    """A point as a list or a mapping; nan for what is missing."""
    if isinstance(value, Mapping):
        small = {str(key).lower(): entry for key, entry in value.items()}
        inner = next((small[k] for k in _PLACES if k in small), None)
        axes = (small.get(axis, small.get(f"camera{axis}")) for axis in "xyz")
        x, y, z = map(_number, axes) if inner is None else _point_of(inner)[:3]
        return x, y, z, _first_number(small, _SHARES)
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) >= 3:
        x, y, z, *rest = map(_number, value[:4])
        return x, y, z, rest[0] if rest else NAN
    return NOTHING


def _points_by_name(value: Any, order: Sequence[str] | None = None) -> dict[str, Point]:
    """Points by name; a list's by their own names, or in an order (of as many that are known)."""
    if isinstance(value, Mapping):
        return {str(name): _point_of(point) for name, point in value.items()}
    if not isinstance(value, list) or not value:
        return {}
    if isinstance(value[0], int | float):  # x, y, z, c one after the other
        width = next((w for w in (4, 3) if len(value) % w == 0 and len(value) // w in POINT_SETS), 0)
        value = [value[at : at + width] for at in range(0, len(value), width)] if width else []
    own = [name for p in value if isinstance(p, Mapping) and isinstance(name := _first(p, _NAMES), str)]
    names = own if len(set(own)) == len(value) else order or POINT_SETS.get(len(value), [])
    return {name: _point_of(point) for name, point in zip(names, value, strict=False)}


#: A row: what the frame states, its number, the body's, and points by name.
_Row = tuple[Any, float, float, dict[str, Point]]


def _raw(path: Path, rows: list[_Row]) -> RawSkeleton:
    """The skeleton of rows of frames and bodies, on the frames' times."""
    raw, times = RawSkeleton(path), []
    for frame, *_ in rows:
        names = [str(key) for key in frame] if isinstance(frame, Mapping) else []
        at = column_named(names, TIME_WORDS)
        times.append(None if at is None else frame[names[at]])
        raw.time_unit = raw.time_unit or ("" if at is None else time_unit_of(names[at]))
    raw.time = np.array([_number(time) for time in times])
    if not np.isfinite(raw.time).any():
        raw.time, raw.time_unit = seconds_of_dates([str(time or "") for time in times]), "s"
    if not np.isfinite(raw.time).any():
        _take_rising(raw, [frame for frame, *_ in rows])
    raw.frame, raw.body = np.array([row[1:3] for row in rows], dtype=float).reshape(-1, 2).T
    for name in dict.fromkeys(name for row in rows for name in row[3]):
        raw.add(name, np.array([row[3].get(name, NOTHING) for row in rows], dtype=float))
    return raw


def _take_rising(raw: RawSkeleton, frames: list[Any]) -> None:
    """Take the number of every frame that rises as times do, where no key says that it is the time."""
    for name in frames[0] if isinstance(frames[0], Mapping) else ():
        times = np.array([_first_number(frame, [name]) for frame in frames])
        step = np.diff(times)
        if (step > 0).all() and (step != 1).any() and (unit := time_unit("", times, CAMERA_RATES)):
            raw.time, raw.time_unit = times, unit
            raw.notes.append(f"The key {name[:40]} was taken for the time, in {unit}: it rises evenly.")
            return


# ------------------------------------------------------------------------------- body tracking of a Kinect

_POSITIONS = ("joint_positions", "jointPositions", "joints", "Joints", "positions", "skeleton", "keypoint")
_BODY = ("body_id", "bodyId", "id", "body_idx", "tracking_id", "trackingId", "TrackingId", "user_id")
_BODIES = ("bodies", "Bodies", "skeletons", "Skeletons", "body_list")
_CONFIDENCES = ("confidence_levels", "joint_confidences", "joint_confidence", "confidences", "confidence")
_KINECT_EXPECTED = "JSON of body tracking (frames with bodies and joint_positions)"


def _is_kinect_json(head: FileHead) -> bool:
    """Whether the fields' names are in the first 64 kB."""
    text = head.text.lstrip().lower()
    own = '"joint_positions"' in text or ('"bodies"' in text and ('"timestamp' in text or '"joints"' in text))
    others = '"body_list"' in text or ('"skeletons"' in text and '"real"' in text)  # ZED, Nuitrack
    return text.startswith(("{", "[")) and (own or others or "k4abt" in text)


def _read_kinect_json(path: Path) -> list[SkeletonTable]:
    """`frames`, each with `timestamp_usec` and `bodies`, each with `body_id` and `joint_positions` in mm."""
    value = _read_json(path, _KINECT_EXPECTED)
    names = value.get("joint_names") if isinstance(value, Mapping) else None
    frames = [
        {"of frames": key, **each} if isinstance(each, Mapping) else each for key, each in _frames_of(value)
    ]
    if not any(isinstance(frame, Mapping) and _first(frame, _BODIES) for frame in frames):
        raise RecordingError(
            f"{path} should be {_KINECT_EXPECTED}, and has no frame with a body; export it again."
        )
    order = [str(name) for name in names] if isinstance(names, list) and names else None
    rows: list[_Row] = []
    count = 0
    for at, frame in enumerate(frames):
        if not isinstance(frame, Mapping):
            continue
        bodies = _first(frame, _BODIES)
        there = [body for body in bodies if isinstance(body, Mapping)] if isinstance(bodies, list) else []
        of_frame = _first_number(frame, ("frame_id", "frame_number"), at)
        for body in there:
            number = next((body[name] for name in _BODY if name in body), 0)
            whole = int(number) if str(number).isdigit() else 0  # a Kinect v2's, as a number or as text
            of_body = _number(whole % 2**32 if whole >= 2**53 else number)
            value = _first(body, _POSITIONS) or []
            count = max(count, len(value))
            points = _points_by_name(value, order or (KINECT_V2 if len(value) == len(KINECT_V2) else None))
            known = (*_CONFIDENCES, "keypoint_confidence")
            levels = next((body[name] for name in known if isinstance(body.get(name), list)), None)
            if levels is not None:
                pairs = zip(points.items(), levels, strict=False)
                points = {name: (*point[:3], _number(level)) for (name, point), level in pairs}
            rows.append((frame, of_frame, of_body if 0 <= of_body < 2**32 - 1 else NAN, points))
        if not there:
            rows.append((frame, of_frame, NAN, {}))
    usual = {len(AZURE): AZURE_AXES, len(KINECT_V2): KINECT_AXES}
    return _raw(path, rows).skeletons(AZURE_AXES if order else usual.get(count, Conventions()))


KINECT_JSON = Format(
    "azure-kinect-json",
    "body tracking in JSON (Azure Kinect, Orbbec, Kinect v2, ZED, Nuitrack)",
    "skeleton",
    "JSON with joint_positions, or with bodies, body_list (ZED) or skeletons (Nuitrack)",
    _is_kinect_json,
    _read_kinect_json,
)


# ----------------------------------------------------------------------------------- landmarks and keypoints

_POSE_EXPECTED = "JSON of landmarks by frame (pose_world_landmarks, or joints by name)"
_WORLD = (
    "pose_world_landmarks", "poseWorldLandmarks", "world_landmarks", "worldLandmarks", "landmarks_world",
    "world", "pose_world",
)  # fmt: skip
_POINTS = (
    "pose_keypoints_3d", "keypoints3D", "keypoints_3d", "keypoints3d", "landmarks_3d", "joints_3d",
    "pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints", "joints", "points", "pose",
    "body", "positions", "data",
)  # fmt: skip
_FRAMES = (
    "frames", "positions", "poses", "results", "data", "motion", "pose_data", "instance_info", "records",
)  # fmt: skip
_NUMBERS = ("frame", "frame_number", "frameNumber", "frame_index", "frame_id", "frame_idx", "index")
_RATES = ("fps", "frame_rate", "frameRate", "framerate", "sampling_rate", "video_fps")
_MARK = re.compile(
    r'"(pose_?)?world_?landmarks"|"pose_keypoints_[23]d"|"keypoints_?3d"|"keypoints":\s*\[\s*[-\d]'
    r'|"[^"]{0,40}(right|left|r|l)[_ .]?wrist"|"[^"]{0,20}wrist[_ .]?(right|left|r|l)"|"(pose_?)?landmarks?"',
    re.IGNORECASE,
)


def _read_pose_json(path: Path) -> list[SkeletonTable]:
    """Frames of landmarks: in a list or by number, landmarks in a list or by name; or keypoints in images."""
    value = _read_json(path, _POSE_EXPECTED)
    rate = _first_number(value, _RATES)
    frames = _frames_of(value)
    flat = _coco(value) or _openpose(frames)
    rows: list[_Row] = []
    is_world = False
    for at, (key, frame) in enumerate(frames if flat is None else flat):
        number = _first_number(frame, _NUMBERS)
        digits = re.search(r"\d+(\.\d+)?", key)
        points, world = (frame.get("points"), False) if flat is not None else _points_in(frame)
        is_world |= world
        number = float(digits.group()) if digits else number if np.isfinite(number) else at
        named = _points_by_name(points) if flat is None else _keypoints(path, points)
        rows.append((frame, number, 0.0, named))
    if not any(row[3] for row in rows):
        raise RecordingError(f"{path} should be {_POSE_EXPECTED}, and no frame of it has points in space.")
    raw = _raw(path, rows)
    raw.rate_hz = rate if 1.0 <= rate <= 1000.0 else None
    assert raw.time is not None and raw.frame is not None
    known = np.isfinite(raw.time)
    in_use = known.mean() > 0.5 and np.ptp(raw.time[known]) > 0  # most rows have one, and they go on
    if flat is not None:
        raw.frame = raw.frame - raw.frame[0]
        in_use = in_use and bool(raw.time_unit or time_unit("", raw.time, CAMERA_RATES))
    raw.time = raw.time if in_use else None
    if flat is not None:
        return raw.skeletons(Conventions(PIXELS, CameraFrame.OPTICAL))
    names = {re.sub(r"[^a-z0-9]", "", name.lower()) for row in rows for name in row[3]}
    if is_world or {"rightpinky", "leftpinky"} & names or raw.is_about_hips():
        return raw.landmarks(is_world)
    return raw.skeletons(Conventions(states="share"))


POSE_JSON = Format(
    "pose-json",
    "MediaPipe or OpenPose landmarks in space, JSON",
    "skeleton",
    "JSON with pose_world_landmarks, pose_keypoints_3d, or a wrist by name",
    lambda head: head.text.lstrip()[:1] in ("{", "[") and bool(_MARK.search(head.text)),
    _read_pose_json,
)


def _frames_of(value: Any) -> list[tuple[str, Any]]:
    """The frames with what the file calls them ("" where it does not)."""
    if not isinstance(value, Mapping):
        return [("", frame) for frame in value] if isinstance(value, list) else []
    for name in _FRAMES:
        inner = value.get(name)
        if isinstance(inner, list | Mapping) and len(inner) and not _is_points(inner):
            return _frames_of(inner)
    columns = {
        str(key): rows
        for key, rows in value.items()
        if isinstance(rows, list) and rows and isinstance(rows[0], list | Mapping) and joint_name(str(key))
    }
    if columns:  # a list of positions by joint
        count = max(map(len, columns.values()))
        return [
            ("", {key: rows[at] for key, rows in columns.items() if at < len(rows)}) for at in range(count)
        ]
    if value and all(re.fullmatch(r"(?i)(frame[_ ]?)?\d+(\.\d+)?", str(key)) for key in value):
        return [(str(key), frame) for key, frame in value.items()]
    return [("", value)]


def _is_points(value: Any) -> bool:
    """Whether a value is the points of one frame: by name, or a list of them."""
    if isinstance(value, Mapping):
        return any((meaning := joint_name(str(key))) is not None and meaning.joint for key in value)
    first = value[0] if value else None
    return isinstance(first, Mapping) and "x" in first


def _points_in(frame: Any, depth: int = 0) -> tuple[Any, bool]:
    """The points of a frame, and whether they are called world landmarks."""
    if depth > 5:
        return None, False
    if isinstance(frame, Mapping):
        if _is_points(frame):
            return frame, False
        if world := _first(frame, _WORLD):
            return _points_in(world, depth + 1)[0], True
        people = frame.get("people", frame.get("persons", frame.get("instances")))
        if isinstance(people, list):
            return _points_in(people[0] if people and isinstance(people[0], Mapping) else None, depth + 1)
        return _points_in(_first(frame, _POINTS), depth + 1)
    if not isinstance(frame, list):
        return None, False
    is_one = len(frame) == 1 and isinstance(frame[0], list | Mapping) and "x" not in frame[0]
    return _points_in(frame[0], depth + 1) if is_one else (frame, False)  # one pose of several


#: Scores of COCO's visibilities: not labelled, labelled and hidden, visible.
_VISIBILITY = (0.0, 0.3, 1.0)
#: Frames of keypoints: name, and what it states with `points` beside it, u, v and score by turns.
_Flat = list[tuple[str, dict[str, Any]]]


def _openpose(frames: list[tuple[str, Any]]) -> _Flat | None:
    """The first person's keypoints of OpenPose by frame; None where the file contains none in images."""
    found: _Flat = []
    for key, frame in frames:
        people = frame.get("people") if isinstance(frame, Mapping) else None
        person = (people[0] if people else None) if isinstance(people, list) else frame
        flat = person.get("pose_keypoints_2d") if isinstance(person, Mapping) else None
        if isinstance(person, Mapping) and person.get("pose_keypoints_3d"):
            return None
        stated = frame if isinstance(frame, Mapping) else {}
        found.append((key, {**stated, "points": flat if isinstance(flat, list) else []}))
    return found if any(frame["points"] for _, frame in found) else None


def _coco(value: Any) -> _Flat | None:
    """Of COCO's annotations or results the surest person of each image, by the images' numbers."""
    listed = value.get("annotations") if isinstance(value, Mapping) else value
    if not isinstance(listed, list) or not listed:
        return None
    if not all(isinstance(one, Mapping) and "image_id" in one and "keypoints" in one for one in listed):
        return None
    best: dict[float, tuple[float, list[float]]] = {}
    if isinstance(value, Mapping):
        best = {_number(image.get("id")): (-1.0, []) for image in value.get("images", [])}
    for one in listed:
        image, score = _number(one["image_id"]), _number(one.get("score", one.get("area", 0.0)))
        if image not in best or score > best[image][0]:
            best[image] = score, list(one["keypoints"])
    ordered = sorted((image, flat) for image, (_, flat) in best.items() if np.isfinite(image))
    thirds = {flat for _, each in ordered for flat in each[2::3]}
    if max(thirds, default=0.0) > 1.0 and thirds <= {0, 1, 2}:  # labelled by hand
        for _, flat in ordered:
            flat[2::3] = [_VISIBILITY[int(one)] for one in flat[2::3]]
    return [(f"{image:f}", {"points": flat}) for image, flat in ordered]


def _keypoints(path: Path, flat: list[Any]) -> dict[str, Point]:
    """Keypoints by name; what was not found is stored as 0, 0 with a score of 0, and left out."""
    count = len(flat) // 3
    if flat and count not in POINT_SETS:
        raise RecordingError(
            f"{path}: {count} keypoints per person are not a known set"
            f" ({', '.join(map(str, POINT_SETS))} are); export COCO's 17 or OpenPose's BODY_25."
        )
    rows = [tuple(map(_number, flat[at : at + 3])) for at in range(0, 3 * count, 3)]
    points = {name: (u, v, s, s) for name, (u, v, s) in zip(POINT_SETS.get(count, []), rows, strict=False)}
    return {name: point if point[3] > 0.0 else NOTHING for name, point in points.items()}
