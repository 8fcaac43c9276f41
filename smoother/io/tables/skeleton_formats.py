"""Tables of skeletons: with joints in the header, with one row per joint, or with joints by number.

Tables with a header and one row per frame are a row of `SKELETON_FORMATS` each.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
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
    joint_name,
    plain_words,
    program_of,
)
from .skeletons import Conventions, RawSkeleton, SkeletonTable, gathered, unit_by_arm
from .table import DeviceTable, FileHead, Format, begins, read_table
from .times import stated_time_unit, time_among
from .units import CAMERA_RATES, time_unit

AZURE_AXES, KINECT_AXES = Conventions("mm", CameraFrame.OPTICAL), Conventions("m", CameraFrame.KINECT)

# --------------------------------------------------------------------------------------------------- states

#: What exporters write for states, as numbers.
STATE_WORDS = {
    **dict.fromkeys(("nottracked", "not tracked", "not_tracked", "none", "false"), 0.0),
    **dict.fromkeys(("inferred", "low", "true"), 1.0),
    **dict.fromkeys(("tracked", "medium"), 2.0),
    "high": 3.0,
}


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


def kinect_states(confidence: FloatArray) -> NDArray[np.int8]:
    """States of a Kinect's numbers: 0 none, 1 inferred (occluded, guessed), 2 (and 3 of an Azure) tracked."""
    state = np.zeros(len(confidence), np.int8)
    state[confidence == 1] = JointState.INFERRED
    state[confidence >= 2] = JointState.TRACKED
    return state


def share_states(confidence: FloatArray) -> NDArray[np.int8]:
    """States of a visibility or score from 0 to 1: inferred up to one half, tracked above."""
    return np.where(confidence <= 0.5, JointState.INFERRED, JointState.TRACKED).astype(np.int8)


def states_of(confidence: dict[str, FloatArray], azure: bool = False) -> dict[str, NDArray[np.int8]]:
    """States of all joints; but for an Azure Kinect's, values up to 1 are shares of one."""
    largest = max((float(np.nanmax(c)) for c in confidence.values() if np.isfinite(c).any()), default=0.0)
    states = kinect_states if azure or largest > 1.0 else share_states
    return {joint: states(values) for joint, values in confidence.items()}


def inferred_throughout(raw: RawSkeleton) -> None:
    """Joints with positions that are never tracked are treated as inferred, with a note."""
    joints = []
    for joint, state in raw.state.items():
        there = np.isfinite(raw.position[joint]).all(axis=1) & (raw.position[joint] != 0).any(axis=1)
        if there.any() and not state.any():
            state[there] = JointState.INFERRED
            joints.append(joint)
    if joints:
        raw.notes.append(
            f"{', '.join(joints)}: confidence 0 in every frame, though with positions; they are treated as"
            " inferred, so they are kept and not measured by."
        )


# ----------------------------------------------------------------------------------- landmarks of BlazePose

#: World landmarks have the middle of the hips within this of their origin, m.
_ABOUT_HIPS_M = 0.06
RELATIVE_NOTE = (
    "World landmarks of MediaPipe are about the middle of the hips: motion is relative to the hips, the place"
    " in the room is not known, and a step or a bow of the trunk looks like a motion of the arm."
)


def landmarks_in_metres(raw: RawSkeleton, world: bool, normalised: bool = False) -> list[SkeletonTable]:
    """Skeletons of BlazePose's landmarks: about the hips in metres, or a room's (FreeMoCap)."""
    fits = unit_by_arm(raw.position)
    is_about_hips = about_hips(raw)
    if not world and fits is not None and fits[0] in ("mm", "cm") and not normalised:
        return raw.skeletons(Conventions())
    if normalised or (not is_about_hips and (_in_image(raw) or (fits is None and not world))):
        raise RecordingError(
            f"{raw.path} contains landmarks as parts of the image's width and height (pose_landmarks), which"
            " are not metres; export pose_world_landmarks of the same video."
        )
    if is_about_hips or world or _middle_of_hips(raw) is None:
        raw.notes.append(RELATIVE_NOTE)
        return raw.skeletons(Conventions("m", CameraFrame.OPTICAL, relative=True))
    return raw.skeletons(Conventions())


def about_hips(raw: RawSkeleton) -> bool:
    """Whether the middle of the hips is the origin."""
    middle = _middle_of_hips(raw)
    return middle is not None and bool(np.abs(middle).max() < _ABOUT_HIPS_M)


def _middle_of_hips(raw: RawSkeleton) -> FloatArray | None:
    """Median middle of the hips (3,), None where the file has none."""
    hips = {name.side: rows for name, rows in raw.rest if name.part == "hip" and name.side}
    if len(hips) < 2:
        return None
    middle = 0.5 * (hips["left"] + hips["right"])
    middle = middle[np.isfinite(middle).all(axis=1)]
    return np.median(middle, axis=0) if len(middle) else None


def _in_image(raw: RawSkeleton) -> bool:
    """Whether shoulders and elbows are between 0 and 1 in x and y, y down, as in an image."""
    hips = [rows[:, 1] for name, rows in raw.rest if name.part == "hip"]
    shoulders = [rows[:, 1] for joint, rows in raw.position.items() if joint.startswith("shoulder")]
    if hips and shoulders and np.nanmedian(np.concatenate(shoulders)) > np.nanmedian(np.concatenate(hips)):
        return False
    rows = [rows[:, :2] for joint, rows in raw.position.items() if joint.startswith(("shoulder", "elbow"))]
    if not rows:
        return False
    points = np.concatenate(rows)
    points = points[np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)]
    inside = ((points > -0.05) & (points < 1.05)).all(axis=1)
    return bool(len(points) and inside.mean() > 0.9)


# ---------------------------------------------------------------------------------------- one row per frame


def _header_of(head: FileHead) -> tuple[str, ...]:
    return () if head.table is None else head.table.names


def _read_wide(path: Path, program: str, conventions: Conventions | None) -> list[SkeletonTable]:
    """Read all bodies of a table with one row per frame and body; without conventions they are landmarks."""
    table = read_table(path, "a table of joints")
    table.refuse_nameless()
    columns = find_joint_columns(table.names)
    raw = RawSkeleton(
        path,
        {joint: table.vectors(triple) for joint, triple in columns.axes.items()},
        rest=[(name, table.vectors(triple)) for name, triple in columns.rest],
    )
    time = columns.time
    if time is None:
        used = {columns.frame, columns.body, *columns.confidence.values()}
        used |= {
            at for three in (*columns.axes.values(), *(each for _, each in columns.rest)) for at in three
        }
        free = [at for at in range(table.width) if at not in used]
        time, raw.time_unit = time_among(table, free, CAMERA_RATES, raw.notes)
    if time is not None:
        raw.time, dates = table.times(time)
        raw.time_unit = "s" if dates else raw.time_unit or stated_time_unit(table, time)
        step = np.diff(raw.time[np.isfinite(raw.time)])
        counts = len(step) > 2 and (step == 1).mean() > 0.5 and np.isin(step, np.arange(100)).all()
        if counts and not raw.time_unit:  # whole numbers, the next one at nearly every row
            raw.frame, raw.time = raw.time, None
    elif columns.frame is not None:
        raw.frame = table.numbers(columns.frame)
    if columns.body is not None:
        raw.body = body_numbers(table, columns.body)
    is_azure, is_share = program == "azure", conventions is None
    values = {joint: state_numbers(table, column) for joint, column in columns.confidence.items()}
    raw.state = {j: share_states(v) for j, v in values.items()} if is_share else states_of(values, is_azure)
    raw.notes += table.notes
    if is_azure:
        inferred_throughout(raw)
    if conventions is None:
        return landmarks_in_metres(raw, columns.world, columns.normalised)
    return raw.skeletons(conventions)


def _wide_format(
    key: str, title: str, recognised_by: str, program: str, conventions: Conventions | None
) -> Format:
    def recognises(head: FileHead) -> bool:
        columns = find_joint_columns(_header_of(head))
        is_numbered = columns.numbered or columns.world
        found = program_of(_header_of(head)) or ("blazepose" if is_numbered else "")
        return columns.has_arm() and program in ("", found)

    read = partial(_read_wide, program=program, conventions=conventions)
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

_JOINT = (
    *("joint", "jointid", "joint id", "joint name", "jointname", "joint type", "jointtype", "landmark"),
    *("landmark id", "landmark name", "landmark index", "landmark idx", "keypoint", "keypoint id", "point"),
    *("marker", "body part", "bodypart", "name", "keypoint name", "joint index", "landmark no"),
)
_STATE = (
    *("state", "tracking state", "trackingstate", "confidence", "confidence level", "visibility", "conf"),
    "score",
)
_AXES = tuple(
    (axis, f"position {axis}", f"pos {axis}", f"world {axis}", f"{axis} world", f"{axis} position")
    for axis in "xyz"
)


def _joint_columns(names: tuple[str, ...]) -> dict[str, int]:
    """Columns by what they are; {} where the table has no row per joint."""
    wanted = dict(zip("xyz", _AXES, strict=True)) | {
        "joint": _JOINT,
        "time": TIME_WORDS,
        "frame": FRAME_WORDS,
        "body": BODY_WORDS,
        "state": _STATE,
    }
    found = {what: at for what, words in wanted.items() if (at := column_named(names, words)) is not None}
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
    time = frame = None
    if "time" in columns:
        time, dates = table.times(columns["time"])
        raw.time_unit = "s" if dates else stated_time_unit(table, columns["time"])
    if "frame" in columns:
        frame = table.numbers(columns["frame"])
    key = time if frame is None else frame
    assert key is not None
    body = body_numbers(table, columns["body"]) if "body" in columns else np.zeros(len(key))
    said = None
    if "state" in columns:
        said = states_of({"all": state_numbers(table, columns["state"])}, kind == "azure")["all"]
    xyz = table.vectors([columns[axis] for axis in "xyz"])
    first, position, state = gathered(key, body, names, xyz, said)
    raw.time = None if time is None else time[first]
    raw.frame = None if frame is None else frame[first]
    raw.body = body[first] if "body" in columns else None
    for name, rows in position.items():
        raw.add(name, rows, None if said is None else state[name])
    if kind == "blazepose":
        world = any("world" in plain_words(table.names[columns[axis]]) for axis in "xyz")
        return landmarks_in_metres(raw, world=world)
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

#: Numbers a joint: position; with a state; with a quaternion; with both.
_PER_JOINT = (3, 4, 7, 8)
#: Columns in front of the joints at most: a time and a body's number.
_LEADING = 2
#: Left and right arms are equally long within this share.
_SAME = 0.25


@dataclass(frozen=True)
class _Numbers:
    """Rows of numbers as joints in the order of a Kinect's SDK."""

    names: list[str]
    per_joint: int
    leading: FloatArray  # (N, 0 to 2): columns in front of the joints
    position: FloatArray  # (N, joints, 3)
    state: FloatArray | None  # (N, joints)

    def fit(self) -> bool:
        """Whether states are codes from 0 to 3 or shares of one, and both arms an arm's length."""
        states = np.zeros(1) if self.state is None else self.state[np.isfinite(self.state)]
        is_code = (states % 1 == 0) & (states <= 3)
        if not ((states >= 0) & (is_code | (states <= 1))).all():
            return False
        lengths = []
        of_arm = {name.joint: at for at, each in enumerate(self.names) if (name := joint_name(each))}
        for side in ("left", "right"):
            arm = {joint: self.position[:, at] for joint, at in of_arm.items() if joint.endswith(side)}
            if (unit := unit_by_arm(arm)) is None:
                return False
            length = np.linalg.norm(arm[f"shoulder_{side}"] - arm[f"elbow_{side}"], axis=1)
            lengths.append(float(np.nanmedian(length)) * unit[1])
        return min(lengths) > 0 and abs(lengths[0] - lengths[1]) < _SAME * max(lengths)


def _numbers_of(table: DeviceTable) -> _Numbers | None:
    """The joints that fit the width of a table, and make two arms of an arm's length."""
    rows = table.vectors(range(table.width))
    if not np.isfinite(rows[:, -1]).any():  # a separator at the end of the line makes an empty column
        rows = rows[:, :-1]
    for names in (AZURE, KINECT_V2):
        for per_joint in _PER_JOINT:
            leading = rows.shape[1] - per_joint * len(names)
            if not 0 <= leading <= _LEADING:
                continue
            cells = rows[:, leading:].reshape(len(rows), len(names), per_joint)
            for first in (0, 1) if per_joint == 4 else (0,):
                state = cells[..., 0 if first else -1] if per_joint in (4, 8) else None
                found = _Numbers(names, per_joint, rows[:, :leading], cells[..., first : first + 3], state)
                if found.fit():
                    return found
    return None


def _are_kinect_numbers(head: FileHead) -> bool:
    """Whether rows have this many numbers, and both arms an arm's length in them."""
    if not head.text:
        return False
    try:
        table = read_table(head.path, text="\n".join(head.lines[:40]) + "\n")
        return bool(not table.names and len(table) and _numbers_of(table) is not None)
    except RecordingError:
        return False


def _read_kinect_numbers(path: Path) -> list[SkeletonTable]:
    """32 or 25 joints of 3, 4, 7 or 8 numbers, with or without a time and a body's number in front."""
    table = read_table(path, "rows of numbers of a Kinect's joints")
    numbers = _numbers_of(table)
    if numbers is None:
        raise RecordingError(
            f"{path}: {table.width} numbers per row are not 32 joints of an Azure Kinect or 25 of a"
            " Kinect v2 in their SDK's order; export the table with a header."
        )
    raw = RawSkeleton(path, notes=list(table.notes))
    is_azure = numbers.names is AZURE
    confidence: dict[str, FloatArray] = {}
    for at, written in enumerate(numbers.names):
        raw.add(written, numbers.position[:, at])
        if (name := joint_name(written)) is not None and name.joint and numbers.state is not None:
            confidence[name.joint] = numbers.state[:, at]
    raw.state = states_of(confidence, is_azure)
    for column in numbers.leading.T:  # time and body in front of the joints: what rises is the time
        step = np.diff(column)
        if raw.time is None and len(step) and (step >= 0).all() and (step > 0).any():
            if np.isin(step, (0, 1)).all() and (column % 1 == 0).all():
                raw.frame = column
            elif time_unit("", column, CAMERA_RATES) is not None:
                raw.time = column
        elif raw.body is None and (column % 1 == 0).all():
            raw.body = column
    inferred_throughout(raw)
    device = "32 joints of an Azure Kinect" if is_azure else "25 joints of a Kinect v2"
    raw.notes.append(f"Rows assumed to be {device}, {numbers.per_joint} numbers each, in the SDK's order.")
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
    array = array.astype(float)
    names = POINT_SETS[array.shape[1]]
    raw = RawSkeleton(path)
    for at, name in enumerate(names):
        raw.add(name, array[:, at, :3].copy(), share_states(array[:, at, 3]) if array.shape[2] == 4 else None)
    raw.notes.append(f"{array.shape[1]} points per frame, assumed in the order {names[0]} .. {names[-1]}.")
    if names is BLAZEPOSE:
        return landmarks_in_metres(raw, world=False)
    return raw.skeletons(AZURE_AXES if names is AZURE else Conventions())


JOINT_ARRAY = Format(
    "joint-array",
    "array of joints, npy (FreeMoCap)",
    "skeleton",
    "numpy's npy file of an array of frames x points x 3 (or 4)",
    begins(b"\x93NUMPY"),
    _read_joint_array,
)
