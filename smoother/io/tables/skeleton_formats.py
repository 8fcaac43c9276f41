"""Tables of skeletons: with joints in the header, with one row per joint, or with joints by number.

Tables with a header and one row per frame are a row of `SKELETON_FORMATS` each.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
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
)
from .skeletons import (
    AZURE_AXES,
    KINECT_AXES,
    STATE_WORDS,
    Conventions,
    RawSkeleton,
    SkeletonTable,
    gathered,
    unit_by_arm,
)
from .table import DeviceTable, FileHead, Format, begins, read_table
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
