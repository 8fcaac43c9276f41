"""Tables of skeletons that name no joint in their header.

One row per joint (time, joint, x, y, z, perhaps a state), or joints by number: rows of a Kinect's SDK without
a header, and numpy's arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...measurements.timestamps import begins_frames
from ...recording import CameraFrame
from ..tables.joints import (
    AZURE,
    BLAZEPOSE,
    KINECT_V2,
    POINT_SETS,
    column_named,
    joint_name,
    plain_words,
    time_unit_of,
)
from ..tables.skeleton_formats import (
    azure_states,
    body_numbers,
    header_of,
    inferred_throughout,
    kinect_states,
    landmarks_in_metres,
    share_states,
    state_numbers,
    states_of,
)
from ..tables.skeletons import Conventions, RawSkeleton, SkeletonTable, camera_time_scale, unit_by_arm
from ..tables.table import FileHead, Format, Table, begins, read_table, table_of

_JOINT = (
    *("joint", "jointid", "joint id", "joint name", "jointname", "joint type", "jointtype", "landmark"),
    *("landmark id", "landmark name", "landmark index", "landmark idx", "keypoint", "keypoint id", "point"),
    *("marker", "body part", "bodypart", "name", "keypoint name", "joint index", "landmark no"),
)
_TIME = ("timestamp", "time", "t", "seconds", "time stamp", "device timestamp", "relative time", "elapsed")
_FRAME = ("frame", "frame number", "frame index", "frame id", "frame idx", "frame no", "framenumber")
_BODY = (
    "body id",
    "bodyid",
    "body idx",
    "body",
    "tracking id",
    "trackingid",
    "person",
    "person id",
    "id",
    "user id",
)
_STATE = (
    "state",
    "tracking state",
    "trackingstate",
    "confidence",
    "confidence level",
    "visibility",
    "conf",
    "score",
)
_AXES = tuple(
    (axis, f"position {axis}", f"pos {axis}", f"world {axis}", f"{axis} world", f"{axis} position")
    for axis in "xyz"
)


@dataclass(frozen=True)
class _Columns:
    joint: int
    axes: tuple[int, int, int]
    time: int | None
    frame: int | None
    body: int | None
    state: int | None


def _has_joint_rows(head: FileHead) -> bool:
    """Whether the header has these columns."""
    return _columns_of(header_of(head)) is not None


def read_joint_rows(path: Path) -> list[SkeletonTable]:
    """One row per joint, joints by name or by their number in a Kinect v2, an Azure Kinect or BlazePose."""
    sheet = read_table(path, "a table with one row per joint")
    columns = _columns_of(sheet.names)
    if columns is None:
        raise RecordingError(
            f"{path} has no columns for joint, x, y, z and a time or frame; export one row per joint with"
            " these."
        )
    names, kind = _joints(sheet, columns.joint, path)
    raw = _gathered(sheet, columns, names, kind, path)
    if kind == "blazepose":
        words = [plain_words(sheet.names[at]) for at in columns.axes]
        return landmarks_in_metres(raw, world=any("world" in word for word in words))
    if kind == "azure":
        return raw.skeletons(Conventions("mm", CameraFrame.OPTICAL))
    if kind == "kinect":
        return raw.skeletons(Conventions("m", CameraFrame.KINECT))
    return raw.skeletons(Conventions())


JOINT_ROWS = Format(
    key="joint-rows",
    title="table with one row per joint",
    kind="skeleton",
    recognised_by="columns for joint (or landmark), x, y, z, and a time or frame number",
    recognises=_has_joint_rows,
    read=read_joint_rows,
)


def _columns_of(names: tuple[str, ...]) -> _Columns | None:
    joint = column_named(names, _JOINT)
    axes = [column_named(names, words) for words in _AXES]
    if joint is None or any(axis is None for axis in axes):
        return None
    time, frame = column_named(names, _TIME), column_named(names, _FRAME)
    if time is None and frame is None:
        return None
    x, y, z = (int(axis) for axis in axes if axis is not None)
    return _Columns(joint, (x, y, z), time, frame, column_named(names, _BODY), column_named(names, _STATE))


def _joints(sheet: Table, column: int, path: Path) -> tuple[list[str], str]:
    """Name of the joint of every row, and whose joints they are."""
    cells = sheet.texts(column)
    different = set(cells)
    if not all(cell.isdigit() for cell in different):
        lower = {"".join(c for c in cell.lower() if c.isalnum()) for cell in different}
        kind = (
            "azure"
            if any("navel" in cell or "clavicle" in cell for cell in lower)
            else "kinect"
            if any(cell.startswith(("spinebase", "spineshoulder", "jointtype")) for cell in lower)
            else "blazepose"
            if any("pinky" in cell or "mouth" in cell for cell in lower)
            else ""
        )
        return cells, kind
    last = max(int(cell) for cell in different)
    for order, kind in ((KINECT_V2, "kinect"), (AZURE, "azure"), (BLAZEPOSE, "blazepose")):
        if last == len(order) - 1:
            return [order[int(cell)] for cell in cells], kind
    raise RecordingError(
        f"{path}: joints are numbered 0 to {last}, which is neither a Kinect v2 (24), an Azure Kinect (31)"
        " nor BlazePose (32); export their names."
    )


def _gathered(sheet: Table, columns: _Columns, names: list[str], kind: str, path: Path) -> RawSkeleton:
    """One row per frame and body, out of rows of joints."""
    raw = RawSkeleton(path, {}, notes=sheet.notes)
    time: FloatArray | None = None
    if columns.time is not None:
        time, dates = sheet.times(columns.time)
        raw.time_scale = 1.0 if dates else time_unit_of(sheet.names[columns.time])
    frame = None if columns.frame is None else sheet.numbers(columns.frame)
    key = frame if frame is not None else time
    assert key is not None
    body = np.zeros(len(key)) if columns.body is None else body_numbers(sheet, columns.body)
    joint_of = np.unique(names, return_inverse=True)[1]
    begins = joint_of + len(joint_of) * np.unique(body, return_inverse=True)[1]
    forward = (np.diff(key[np.isfinite(key)]) >= 0).all() or begins_frames(key, begins)
    number = (
        np.cumsum(np.append(True, key[1:] != key[:-1])) if forward else np.unique(key, return_inverse=True)[1]
    )
    first_of: dict[tuple[int, float], int] = {}  # a row of the skeleton is one frame and body
    row = np.array(
        [
            first_of.setdefault(pair, len(first_of))
            for pair in zip(number.tolist(), body.tolist(), strict=True)
        ]
    )
    count, first = len(first_of), np.unique(row, return_index=True)[1]
    raw.time = None if time is None else time[first]
    raw.frame = None if frame is None else frame[first]
    raw.body = None if columns.body is None else body[first]
    codes = {name: joint_name(name) for name in set(names)}
    written = np.array(names)
    xyz = sheet.vectors(columns.axes)
    state = None
    if columns.state is not None:
        states = azure_states if kind == "azure" else kinect_states
        state = states_of({"all": state_numbers(sheet, columns.state)}, states)["all"]
    for name, meaning in sorted(codes.items()):
        if meaning is None:
            continue
        mine = np.flatnonzero(written == name)
        position = np.full((count, 3), np.nan)
        position[row[mine]] = xyz[mine]
        if not meaning.joint:
            raw.rest.append((meaning, position))
        elif meaning.kind != "skin":
            raw.position[meaning.joint] = position
            if state is not None:
                raw.state[meaning.joint] = np.zeros(count, np.int8)
                raw.state[meaning.joint][row[mine]] = state[mine]
    return raw


#: Numbers a joint: position; with a state; with a quaternion; with both.
_PER_JOINT = (3, 4, 7, 8)
#: Columns in front of the joints at most: a time and a body's number.
_LEADING = 2
#: Left and right arms are equally long within this share.
_SAME = 0.25


@dataclass(frozen=True)
class _Order:
    """How the numbers of a row follow each other."""

    joints: tuple[str, ...]
    per_joint: int
    leading: int
    state_first: bool = False

    def position(self, rows: FloatArray, number: int) -> FloatArray:
        start = self.leading + number * self.per_joint + int(self.state_first)
        return rows[:, start : start + 3]

    def state(self, rows: FloatArray, number: int) -> FloatArray | None:
        if self.per_joint not in (4, 8):
            return None
        start = self.leading + number * self.per_joint
        return rows[:, start if self.state_first else start + self.per_joint - 1]


def _are_kinect_numbers(head: FileHead) -> bool:
    """Whether rows have this many numbers, and both arms an arm's length in them."""
    if not head.text:
        return False
    try:
        sheet = table_of(head.path, "\n".join(head.lines[:40]) + "\n")
        if sheet.names or not len(sheet):
            return False
        rows = sheet.vectors(range(sheet.width))
        return any(_order_of(each) is not None for each in (rows, _filled(rows)))
    except RecordingError:
        return False


def read_kinect_numbers(path: Path) -> list[SkeletonTable]:
    """32 or 25 joints of 3, 4, 7 or 8 numbers, with or without a time and a body's number in front."""
    sheet = read_table(path, "rows of numbers of a Kinect's joints")
    rows = _filled(sheet.vectors(range(sheet.width)))
    order = _order_of(rows)
    if order is None:
        raise RecordingError(
            f"{path}: {rows.shape[1]} numbers per row are not 32 joints of an Azure Kinect or 25 of a"
            " Kinect v2 in their SDK's order; export the table with a header."
        )
    raw = RawSkeleton(path, {}, notes=list(sheet.notes))
    is_azure = len(order.joints) == len(AZURE)
    confidence: dict[str, FloatArray] = {}
    for number, written in enumerate(order.joints):
        name = joint_name(written)
        if name is not None and name.joint:
            raw.position[name.joint] = order.position(rows, number)
            if (state := order.state(rows, number)) is not None:
                confidence[name.joint] = state
        elif name is not None:
            raw.rest.append((name, order.position(rows, number)))
    raw.state = states_of(confidence, azure_states if is_azure else kinect_states)
    _leading(raw, rows[:, : order.leading])
    inferred_throughout(raw)
    device = "32 joints of an Azure Kinect" if is_azure else "25 joints of a Kinect v2"
    raw.notes.append(f"Rows assumed to be {device}, {order.per_joint} numbers each, in the SDK's order.")
    frame = CameraFrame.OPTICAL if is_azure else CameraFrame.KINECT
    return raw.skeletons(Conventions("mm" if is_azure else "m", frame))


KINECT_NUMBERS = Format(
    key="kinect-numbers",
    title="Azure Kinect or Kinect v2 joints without a header",
    kind="skeleton",
    recognised_by="no header, and 32 or 25 joints of 3, 4, 7 or 8 numbers whose arms are as long as arms",
    recognises=_are_kinect_numbers,
    read=read_kinect_numbers,
)


def _filled(rows: FloatArray) -> FloatArray:
    """Rows (N, width) without the empty column that a separator at the end of the line makes."""
    return rows if np.isfinite(rows[:, -1]).any() else rows[:, :-1]


def _order_of(rows: FloatArray) -> _Order | None:
    """The order that fits the width of rows (N, width), and makes two arms of an arm's length."""
    width = rows.shape[1]
    for joints in (AZURE, KINECT_V2):
        for per_joint in _PER_JOINT:
            leading = width - per_joint * len(joints)
            if not 0 <= leading <= _LEADING:
                continue
            for state_first in (False, True) if per_joint == 4 else (False,):
                order = _Order(tuple(joints), per_joint, leading, state_first)
                if _has_states(order, rows) and _has_arms(order, rows):
                    return order
    return None


def _has_states(order: _Order, rows: FloatArray) -> bool:
    """Whether what should be states are codes from 0 to 3, or shares of one."""
    columns = [order.state(rows, number) for number in range(len(order.joints))]
    states = np.concatenate([column for column in columns if column is not None] or [np.zeros(1)])
    states = states[np.isfinite(states)]
    is_code = (states % 1 == 0) & (states <= 3)
    return bool(((states >= 0) & (is_code | (states <= 1))).all())


def _has_arms(order: _Order, rows: FloatArray) -> bool:
    position = {}
    for number, written in enumerate(order.joints):
        name = joint_name(written)
        if name is not None and name.joint:
            position[name.joint] = order.position(rows, number)
    lengths = []
    for side in ("left", "right"):
        arm = {joint: values for joint, values in position.items() if joint.endswith(side)}
        unit = unit_by_arm(arm)
        if unit is None:
            return False
        length = np.linalg.norm(arm[f"shoulder_{side}"] - arm[f"elbow_{side}"], axis=1)
        lengths.append(float(np.nanmedian(length)) * unit[1])
    return min(lengths) > 0 and abs(lengths[0] - lengths[1]) < _SAME * max(lengths)


def _leading(raw: RawSkeleton, columns: FloatArray) -> None:
    """Time and body in front of the joints: what rises is the time."""
    for column in columns.T:
        step = np.diff(column)
        if raw.time is None and len(step) and (step >= 0).all() and (step > 0).any():
            if np.isin(step, (0, 1)).all() and (column % 1 == 0).all():
                raw.frame = column
            elif camera_time_scale(column, None) is not None:
                raw.time = column
        elif raw.body is None and (column % 1 == 0).all():
            raw.body = column


def read_joint_array(path: Path) -> list[SkeletonTable]:
    """An array of frames, points and x, y, z (and a score); points are identified by their number."""
    array = _loaded(path)
    names = POINT_SETS[array.shape[1]]
    raw = RawSkeleton(path, {})
    for at, name in enumerate(names):
        meaning = joint_name(name)
        if meaning is None:
            continue
        position = array[:, at, :3].copy()
        if not meaning.joint:
            raw.rest.append((meaning, position))
            continue
        raw.position[meaning.joint] = position
        if array.shape[2] == 4:
            raw.state[meaning.joint] = share_states(array[:, at, 3])
    first, last = names[0], names[-1]
    raw.notes.append(f"{array.shape[1]} points per frame, assumed in the order {first} .. {last}.")
    if names is BLAZEPOSE:
        return landmarks_in_metres(raw, world=False)
    return raw.skeletons(Conventions("mm", CameraFrame.OPTICAL) if names is AZURE else Conventions())


JOINT_ARRAY = Format(
    key="joint-array",
    title="array of joints, npy (FreeMoCap)",
    kind="skeleton",
    recognised_by="numpy's npy file of an array of frames x points x 3 (or 4)",
    recognises=begins(b"\x93NUMPY"),
    read=read_joint_array,
)


def _loaded(path: Path) -> NDArray[np.float64]:
    """The array, (frames, points, 3 or 4)."""
    try:
        array = np.load(path, allow_pickle=False)
    except Exception as error:  # whatever a damaged header leads numpy into
        raise RecordingError(
            f"{path} is not an array of numbers that numpy can read ({str(error)[:80]}); save it again with"
            " numpy.save."
        ) from error
    if array.dtype.kind not in "fiu":
        raise RecordingError(
            f"{path} contains {array.dtype} and not numbers; save an array of frames x points x 3."
        )
    if array.ndim == 2:
        for width in (3, 4):
            if array.shape[1] % width == 0 and array.shape[1] // width in POINT_SETS:
                array = array.reshape(len(array), -1, width)
                break
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.shape[1] not in POINT_SETS or not len(array):
        shape = " x ".join(map(str, array.shape))
        known = ", ".join(map(str, sorted(POINT_SETS)))
        raise RecordingError(
            f"{path} is an array of {shape}; joints are frames x points x 3, of {known} points."
        )
    return array.astype(float)
