"""IMUs and skeletons in tables of any layout: which of their columns is what, as recording.toml says."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
from ...runtime.inputs import check_input
from ..devices.image_keypoints import PIXELS
from ..recording.decode import joint_code
from ..recording.keypoints import states_of_scores
from ..tables.imu import ImuTable
from ..tables.joints import joint_name
from ..tables.skeletons import BodyRows, SkeletonTable
from ..tables.table import (
    SEPARATORS,
    Table,
    check_lines,
    file_text,
    is_data,
    layout_of,
    plain_label,
    read_table,
    shown,
    split_line,
)
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, DATED_S, METRES, SECONDS, from_1970

Column = str | int
LAYOUT_KEYS = {"separator", "skip_rows", "columns", "time_unit", "rate_hz"}


class TableKeys(BaseModel):
    """How a table is laid out; what is not given is looked for."""

    model_config = ConfigDict(extra="forbid")
    separator: str | None = None  # ",", ";", a tab or a blank (any number of them)
    skip_rows: int | None = Field(None, ge=0)  # Lines above the header, or above the rows where there is none
    # "s", "ms", "us", "ns", "ticks of 100 ns", "iso" (dates), "counter" (samples, with `rate_hz`)
    time_unit: Literal["s", "ms", "us", "ns", "ticks of 100 ns", "iso", "counter"] = "s"
    rate_hz: float | None = Field(None, gt=0)  # Of a table without times, or of a counter


class ImuKeys(TableKeys):
    """Files of an IMU; units count for all of them."""

    file: str | list[str]
    columns: dict[str, Column] | list[dict[str, Column]] | None = None
    accelerometer_unit: Literal["m/s^2", "g", "mg", "cm/s^2", "mm/s^2"] = "m/s^2"
    gyroscope_unit: Literal["rad/s", "deg/s", "mdps"] = "rad/s"

    @property
    def is_plain(self) -> bool:
        """Whether the file is one with the product's own columns."""
        return isinstance(self.file, str) and not self.model_fields_set & LAYOUT_KEYS


class CameraKeys(TableKeys):
    """The skeleton's file: a row per joint (columns joint, x, y, z), or per frame (wrist_right = ..)."""

    frame: CameraFrame
    skeleton: str | None = None
    keypoints: str | None = None
    intrinsics: dict[str, float] | None = None
    gravity: list[float] | None = Field(None, min_length=3, max_length=3)
    position_unit: Literal["m", "cm", "mm"] = "m"
    columns: dict[str, Column | list[Column]] | None = None
    states: dict[str, Literal["tracked", "inferred", "not_tracked"]] | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_pixels(cls, values: Any) -> Any:
        """Keypoints are in the axes of a lens, so they need no frame."""
        if not isinstance(values, dict) or "keypoints" not in values:
            if isinstance(values, dict) and "intrinsics" in values:
                raise ValueError("intrinsics are of keypoints; give keypoints = a file instead of skeleton")
            return values
        if "skeleton" in values:
            raise ValueError("a camera has a skeleton or keypoints; give the other a section [camera.NAME]")
        if values.get("frame", "optical") != "optical":
            raise ValueError('keypoints are in the axes of the lens; leave out frame, or give "optical"')
        return {"frame": "optical", **values}

    @property
    def file(self) -> str | None:
        """The file that the section names."""
        return self.keypoints if self.skeleton is None else self.skeleton

    @property
    def is_plain(self) -> bool:
        """Whether the file is one with the product's own columns."""
        return not self.model_fields_set & (LAYOUT_KEYS | {"states"})


IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
#: A header may be followed by this many lines of units and the like.
_BELOW_HEADER = 3


def read_imu_columns(folder: Path, keys: ImuKeys) -> list[ImuTable]:
    """The tables of an IMU, one per file, in SI units."""
    files = [keys.file] if isinstance(keys.file, str) else keys.file
    given = keys.columns if isinstance(keys.columns, list) else [keys.columns] * len(files)
    if len(given) != len(files):
        raise RecordingError(
            f"{folder / 'recording.toml'}: {len(files)} files have {len(given)} tables of columns; give one"
            " for each, or one for all."
        )
    return [
        _imu_table(folder / file, keys, columns or {}, len(files) > 1)
        for file, columns in zip(files, given, strict=True)
    ]


def _imu_table(path: Path, keys: ImuKeys, columns: dict[str, Column], is_part: bool) -> ImuTable:
    refuse_others(path, columns, IMU_COLUMNS)
    sheet = described_sheet(path, keys, columns)
    given = columns or {name: name if name != "t" else "t_s" for name in IMU_COLUMNS}
    at = {}
    for what, column in given.items():
        place = place_of(sheet, column)
        if place is not None:
            at[what] = place
        elif not is_part and (columns or what not in ("t", "mx", "my", "mz")):
            raise _no_column(sheet, what, column)
    acc = _vectors(sheet, at, "axyz") * ACCELERATION[keys.accelerometer_unit] if "ax" in at else None
    gyro = _vectors(sheet, at, "gxyz") * ANGULAR_VELOCITY[keys.gyroscope_unit] if "gx" in at else None
    if acc is None and gyro is None:
        raise RecordingError(
            f"{path}: columns name neither an accelerometer (ax, ay, az) nor a gyroscope (gx, gy, gz) that is"
            f" there; its columns are {_listed(sheet)}."
        )
    mag = _vectors(sheet, at, "mxyz") if "mx" in at else None
    t_s, counter = times_in(sheet, at.get("t"), keys)
    units = ", ".join(
        unit
        for unit, values in ((keys.accelerometer_unit, acc), (keys.gyroscope_unit, gyro))
        if values is not None
    )
    return ImuTable("", t_s, acc, gyro, mag, keys.rate_hz, counter, 0, units, sheet.notes)


def times_in(
    sheet: Table, column: int | None, keys: TableKeys
) -> tuple[FloatArray | None, NDArray[np.int64] | None]:
    """Times in s, or a counter, of a column."""
    if column is None or keys.time_unit == "counter":
        if keys.rate_hz is None:
            raise RecordingError(f"{sheet.path} has no times by recording.toml; give its rate as rate_hz.")
        if column is None:
            return None, None
        counter = sheet.numbers(column)
        if not np.isfinite(counter).all():
            raise RecordingError(f"{sheet.path}: {sheet.name(column)} is not a counter; it has empty cells.")
        return None, counter.astype(np.int64)
    values, are_dates = sheet.times(column)
    if are_dates != (keys.time_unit == "iso"):
        seen = shown(sheet.texts(column)[0], 40)
        raise RecordingError(
            f"{sheet.path}: {sheet.name(column)} begins with '{seen}', which is not a time in"
            f" {keys.time_unit}; correct time_unit."
        )
    if are_dates:
        return values, None
    times = from_1970(values, keys.time_unit) * SECONDS[keys.time_unit]
    if np.isfinite(times).any() and float(np.nanmedian(times)) > DATED_S[1]:
        raise RecordingError(
            f"{sheet.path}: in {keys.time_unit} the times of {sheet.name(column)} are later than 2100;"
            " correct time_unit."
        )
    return times, None


def described_sheet(path: Path, keys: TableKeys, columns: Mapping[str, Column | list[Column]]) -> Table:
    """The table of a file, laid out as said."""
    expected = "the table that recording.toml describes"
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(
            f"{path} does not exist, but recording.toml names it; add it or correct the name."
        )
    if keys.separator is None and keys.skip_rows is None:
        return read_table(path, expected, quote=False)
    lines = file_text(path).split("\n")
    check_lines(path, lines)
    return _layout(path, lines, keys, columns)


def _layout(
    path: Path, lines: list[str], keys: TableKeys, columns: Mapping[str, Column | list[Column]]
) -> Table:
    first = keys.skip_rows or 0
    rest = [line for line in lines[first:] if line.strip()]
    if not rest:
        raise RecordingError(f"{path} has no rows below the first {first}; correct skip_rows.")
    found = layout_of(rest)
    separator = keys.separator or ("," if found is None else found.separator)
    if separator not in SEPARATORS:
        raise RecordingError(f'{path}: separator is {separator!r}; it is one of ",", ";", "\\t" and " ".')
    while first < len(lines) - 1 and not lines[first].strip():
        first += 1
    cells = split_line(lines[first], separator)
    flat = [c for each in columns.values() for c in (each if isinstance(each, list) else [each])]
    has_header = any(isinstance(column, str) for column in flat) or not any(map(is_data, cells))
    row = first
    if has_header:
        row += 1
        for _ in range(_BELOW_HEADER):
            below = split_line(lines[row], separator) if row < len(lines) else []
            if row < len(lines) - 1 and not any(is_data(cell) for cell in below):
                row += 1
    names = tuple(cells) if has_header else ()
    width = max(len(cells), len(split_line(lines[min(row, len(lines) - 1)], separator)))
    names += ("",) * (width - len(names)) if names else ()
    labels = tuple(map(plain_label, names))
    header = first if has_header else -1
    return Table(
        path, separator, tuple(lines[:first]), names, ("",) * width, labels, header, row, width, lines
    )


def place_of(sheet: Table, column: Column | list[Column]) -> int | None:
    """Number (from 0) of a column by its name, or by its number from 1; None where it is not there."""
    if isinstance(column, int):
        return column - 1 if 1 <= column <= sheet.width else None
    if not isinstance(column, str):
        return None
    if column in sheet.names:
        return sheet.names.index(column)
    wanted = plain_label(column)  # as written, or without the unit in brackets
    labels = list(map(plain_label, sheet.names))
    return labels.index(wanted) if wanted in labels else sheet.find(wanted)


def needed_place(sheet: Table, what: str, column: Column | list[Column]) -> int:
    """`place_of` a column that must be there."""
    place = place_of(sheet, column)
    if place is None:
        raise _no_column(sheet, what, column)
    return place


def _no_column(sheet: Table, what: str, column: Column | list[Column]) -> RecordingError:
    return RecordingError(
        f"{sheet.path} has no column {column!r} ({what}); its columns are {_listed(sheet)}."
    )


def _listed(sheet: Table) -> str:
    if not sheet.names:
        return f"without names, 1 to {sheet.width}"
    return shown(", ".join(sheet.names))


def refuse_others(path: Path, columns: Mapping[str, object], known: tuple[str, ...]) -> None:
    """Refuse keys of `columns` that mean nothing."""
    for name in columns:
        if name not in known:
            raise RecordingError(f"{path}: columns.{name} is not known; it is one of {', '.join(known)}.")


def _vectors(sheet: Table, at: dict[str, int], letters: str) -> FloatArray:
    kind, axes = letters[0], letters[1:]
    missing = [kind + axis for axis in axes if kind + axis not in at]
    if missing:
        raise RecordingError(f"{sheet.path}: columns lack {', '.join(missing)}; name all three axes.")
    return sheet.vectors([at[kind + axis] for axis in axes])


_STATES = {
    "tracked": JointState.TRACKED,
    "inferred": JointState.INFERRED,
    "not_tracked": JointState.NOT_TRACKED,
}
_LONG_COLUMNS = ("t", "joint", "x", "y", "z", "state", "body")


def read_skeleton_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a skeleton's table; errors as `read_imu_columns`."""
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
        raise RecordingError(f"{path} has no rows of a skeleton; export it again.")
    return tables


_POINT_COLUMNS = {"t": "t_s", "joint": "joint", "u": "u", "v": "v", "score": "score", "body": "body"}


def read_keypoint_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a table of keypoints: `position` holds u, v and the score."""
    given = keys.columns or {}
    refuse_others(path, given, tuple(_POINT_COLUMNS))
    axes = {"u": "x", "v": "y", "score": "z"}
    columns = {axes.get(name, name): column for name, column in (_POINT_COLUMNS | given).items()}
    tables = read_skeleton_columns(path, keys.model_copy(update={"columns": columns, "position_unit": "m"}))
    for table in tables:
        table.units = PIXELS
        table.state = {joint: states_of_scores(points[:, 2]) for joint, points in table.position.items()}
    return tables


def _wide_rows(sheet: Table, keys: CameraKeys, columns: dict[str, Column | list[Column]]) -> BodyRows:
    """One row per frame and body: three columns per joint."""
    names = [name for name in columns if name not in ("t", "body")]
    joints = [name for name in names if not name.endswith("_state")]
    for name in names:
        if joint_code(name.removesuffix("_state")) is None:
            raise RecordingError(
                f"{sheet.path}: columns.{name} is not a joint; joints are shoulder, elbow, wrist, hand or"
                " strap with _left or _right, and t, body, JOINT_state."
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


def _long_rows(sheet: Table, keys: CameraKeys, columns: dict[str, Column | list[Column]]) -> BodyRows:
    """One row per joint: the rows of one time and body become one."""
    refuse_others(sheet.path, columns, _LONG_COLUMNS)
    t_s = _frame_times(sheet, keys, columns)
    if t_s is None:
        raise RecordingError(f"{sheet.path}: columns.t is missing; it defines which rows are one frame.")
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


def _states(sheet: Table, column: int, keys: CameraKeys) -> NDArray[np.int64]:
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
                f"{sheet.path}: {sheet.name(column)} contains '{shown(cell, 40)}'; state its values' meaning,"
                ' as in states = { "0" = "not_tracked", "1" = "inferred", "2" = "tracked" }.'
            )
        codes[cell] = int(words[plain])
    return np.array([codes[cell] for cell in cells], np.int64)


def _frame_times(
    sheet: Table, keys: CameraKeys, columns: dict[str, Column | list[Column]]
) -> FloatArray | None:
    """Times (n,) of rows in s; None where there are none."""
    place = needed_place(sheet, "t", columns["t"]) if "t" in columns else None
    t_s, counter = times_in(sheet, place, keys)
    return t_s if counter is None else counter / (keys.rate_hz or 1.0)
