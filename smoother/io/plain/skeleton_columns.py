"""Skeletons in tables of any layout: a row a frame, or a row a joint, as recording.toml says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import JointState
from ..devices.body_rows import BodyRows
from ..devices.head import shown
from ..devices.joint_names import joint_name
from ..devices.protocol import SkeletonTable
from ..devices.sheet import Sheet
from ..recording.skeletons import joint_code
from .columns import described_sheet, needed_place, place_of, refuse_others, times_in
from .layout_keys import METRES, CameraKeys, Column

_STATES = {
    "tracked": JointState.TRACKED,
    "inferred": JointState.INFERRED,
    "not_tracked": JointState.NOT_TRACKED,
}
_LONG_COLUMNS = ("t", "joint", "x", "y", "z", "state", "body")


def read_skeleton_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a skeleton's table; errors as `read_imu_columns`.

    Parameters
    ----------
    path : Path
        The file.
    keys : CameraKeys
        What recording.toml says of it.

    Returns
    -------
    list of SkeletonTable
        Times not yet repaired.
    """
    columns = keys.columns or {name: name if name != "t" else "t_s" for name in _LONG_COLUMNS}
    sheet = described_sheet(path, keys, columns)
    rows = _long_rows(sheet, keys, columns) if "joint" in columns else _wide_rows(sheet, keys, columns)
    metres = METRES[keys.position_unit]
    rows.position = {joint: values * metres for joint, values in rows.position.items()}
    hint = None if keys.gravity is None else np.array(keys.gravity)
    pattern = SkeletonTable(
        0, None, {}, {}, keys.frame, hint, keys.rate_hz, False, keys.position_unit, sheet.notes
    )
    has_times = "t" in columns
    tables = rows.skeletons(pattern, 1.0 if has_times else None)
    if not tables:
        raise RecordingError(f"{path} holds no rows of a skeleton; export it again.")
    return tables


def _wide_rows(sheet: Sheet, keys: CameraKeys, columns: dict[str, Column | list[Column]]) -> BodyRows:
    """A row a frame and body: three columns a joint."""
    names = [name for name in columns if name not in ("t", "body")]
    joints = [name for name in names if not name.endswith("_state")]
    for name in names:
        if joint_code(name.removesuffix("_state")) is None:
            raise RecordingError(
                f"{sheet.path}: columns.{name} is no joint; joints are shoulder, elbow, wrist, hand or strap"
                " with _left or _right, and t, body, JOINT_state."
            )
    position, state = {}, {}
    for joint in joints:
        three = columns[joint]
        if not isinstance(three, list) or len(three) != 3:
            raise RecordingError(
                f"{sheet.path}: columns.{joint} names {three!r}; give its three columns x, y, z in brackets."
            )
        position[joint] = sheet.vectors([needed_place(sheet, joint, column) for column in three])
        lost = (position[joint] == 0).all(axis=1) | ~np.isfinite(position[joint]).all(axis=1)
        position[joint][lost] = np.nan
        state[joint] = np.where(lost, JointState.NOT_TRACKED, JointState.TRACKED).astype(np.int8)
        if (column := columns.get(f"{joint}_state")) is not None:
            said = _states(sheet, needed_place(sheet, f"{joint}_state", column), keys)
            state[joint] = np.where(lost, JointState.NOT_TRACKED, said).astype(np.int8)
    body = columns.get("body")
    bodies = None if body is None else sheet.numbers(needed_place(sheet, "body", body))
    t_s = _frame_times(sheet, keys, columns)
    return BodyRows(np.arange(len(sheet), dtype=float) if t_s is None else t_s, bodies, position, state)


def _long_rows(sheet: Sheet, keys: CameraKeys, columns: dict[str, Column | list[Column]]) -> BodyRows:
    """A row a joint: the rows of one time and body become one."""
    refuse_others(sheet.path, columns, _LONG_COLUMNS)
    t_s = _frame_times(sheet, keys, columns)
    if t_s is None:
        raise RecordingError(f"{sheet.path}: columns.t is missing; it says which rows are one frame.")
    values = sheet.vectors([needed_place(sheet, axis, columns.get(axis, axis)) for axis in "xyz"])
    body = place_of(sheet, columns["body"]) if "body" in columns else None
    bodies = np.zeros(len(sheet)) if body is None else sheet.numbers(body)
    names = sheet.texts(needed_place(sheet, "joint", columns["joint"]))
    meaning = {name: _joint_of(name) for name in set(names)}
    joints = sorted({joint for joint in meaning.values() if joint})
    if not joints:
        raise RecordingError(
            f"{sheet.path}: none of the joints ({shown(', '.join(sorted(meaning)), 120)}) is of an arm; they"
            " are shoulder, elbow, wrist, hand or strap with _left or _right."
        )
    place = place_of(sheet, columns["state"]) if "state" in columns else None
    lost = (values == 0).all(axis=1) | ~np.isfinite(values).all(axis=1)
    said = np.full(len(sheet), JointState.TRACKED) if place is None else _states(sheet, place, keys)
    said = np.where(lost, JointState.NOT_TRACKED, said)
    key, first, row = np.unique(np.stack([t_s, bodies]), axis=1, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))  # frames in the order of the file
    row = rank[np.reshape(row, -1)]
    key = key[:, np.argsort(first)]
    code = np.array([joints.index(meaning[name]) if meaning[name] else -1 for name in names])
    position, state = {}, {}
    for number, joint in enumerate(joints):
        mine = code == number
        position[joint] = np.full((key.shape[1], 3), np.nan)
        position[joint][row[mine]] = values[mine]
        state[joint] = np.zeros(key.shape[1], np.int8)
        state[joint][row[mine]] = said[mine]
    return BodyRows(key[0], key[1], position, state)


def _joint_of(name: str) -> str:
    """A joint as the product names it, from its own names or a camera program's; "" for others."""
    if joint_code(name) is not None:
        return name.strip().lower()
    meaning = joint_name(name)
    return "" if meaning is None else meaning.joint


def _states(sheet: Sheet, column: int, keys: CameraKeys) -> NDArray[np.int64]:
    """States (n,) of a joint by the words or numbers of a column."""
    cells = sheet.texts(column)
    words = {
        **_STATES,
        **{cell.strip().lower(): _STATES[state] for cell, state in (keys.states or {}).items()},
    }
    codes = {}
    for cell in set(cells):
        plain = cell.strip().lower()
        plain = plain if plain in words else plain.removesuffix(".0")
        if plain not in words:
            raise RecordingError(
                f"{sheet.path}: {sheet.name(column)} holds '{shown(cell, 40)}'; say what its values mean, as"
                ' in states = { "0" = "not_tracked", "1" = "inferred", "2" = "tracked" }.'
            )
        codes[cell] = int(words[plain])
    return np.array([codes[cell] for cell in cells], np.int64)


def _frame_times(
    sheet: Sheet, keys: CameraKeys, columns: dict[str, Column | list[Column]]
) -> FloatArray | None:
    """Times (n,) of rows in s; None where there are none."""
    place = needed_place(sheet, "t", columns["t"]) if "t" in columns else None
    t_s, counter = times_in(sheet, place, keys)
    return t_s if counter is None else counter / (keys.rate_hz or 1.0)
