"""Tables with one row a joint: time, joint, x, y, z, and a state where there is one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...measurements.timestamps import begins_frames
from ...recording import CameraFrame
from ..tables.joint_columns import (
    AZURE,
    BLAZEPOSE,
    KINECT_V2,
    column_named,
    joint_name,
    plain_words,
    time_unit_of,
)
from ..tables.protocol import FileHead, SkeletonTable
from ..tables.raw_skeleton import Conventions, RawSkeleton
from ..tables.skeleton_formats import (
    azure_states,
    body_numbers,
    header_of,
    kinect_states,
    landmarks_in_metres,
    state_numbers,
    states_of,
)
from ..tables.text_table import Sheet, read_sheet

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


@dataclass(frozen=True)
class LongSkeleton:
    """A row a joint, joints by name or by their number in a Kinect v2, an Azure Kinect or BlazePose.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "joint-rows"
    title: str = "table with a row a joint"
    kind: str = "skeleton"
    recognised_by: str = "columns for joint (or landmark), x, y, z, and a time or frame number"

    def recognises(self, head: FileHead) -> bool:
        """Whether the header has these columns."""
        return _columns_of(header_of(head)) is not None

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies.

        Raises
        ------
        RecordingError
            The file is no such table, or no arm is in it.
        """
        sheet = read_sheet(path, "a table with a row a joint")
        columns = _columns_of(sheet.layout.names)
        if columns is None:
            raise RecordingError(
                f"{path} has no columns for joint, x, y, z and a time or frame; export a row a joint with"
                " these."
            )
        names, kind = _joints(sheet, columns.joint, path)
        raw = _gathered(sheet, columns, names, kind, path)
        if kind == "blazepose":
            words = [plain_words(sheet.layout.names[at]) for at in columns.axes]
            return landmarks_in_metres(raw, world=any("world" in word for word in words))
        if kind == "azure":
            return raw.skeletons(Conventions("mm", CameraFrame.OPTICAL))
        if kind == "kinect":
            return raw.skeletons(Conventions("m", CameraFrame.KINECT))
        return raw.skeletons(Conventions())


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


def _joints(sheet: Sheet, column: int, path: Path) -> tuple[list[str], str]:
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


def _gathered(sheet: Sheet, columns: _Columns, names: list[str], kind: str, path: Path) -> RawSkeleton:
    """A row a frame and body, out of rows of joints."""
    raw = RawSkeleton(path, {}, notes=sheet.notes)
    time: FloatArray | None = None
    if columns.time is not None:
        time, dates = sheet.times(columns.time)
        raw.time_scale = 1.0 if dates else time_unit_of(sheet.layout.names[columns.time])
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
