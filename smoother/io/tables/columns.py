"""Which columns of a table are what, as recording.toml states them: an IMU, a skeleton, keypoints."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, ImuStream, JointState
from ...runtime.inputs import check_input
from ..mcap.messages import nanoseconds
from ..recording.decode import joint_code, states_of_scores
from ..recording.streams import ImuSamples, PoseSamples, SkeletonTable
from .imu import usual_size
from .joints import joint_name
from .skeletons import PIXELS, RawSkeleton, gathered
from .table import CUT, SEPARATORS, DeviceTable, plain_label, read_table, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, DATED_S, METRES, in_seconds

Column = str | int
LAYOUT_KEYS = {"separator", "skip_rows", "columns", "time_unit", "rate_hz"}


class TableKeys(BaseModel):
    """How a table is laid out; what is not given is looked for."""

    model_config = ConfigDict(extra="forbid")
    separator: str | None = None  # ",", ";", a tab or a blank (any number of them)
    skip_rows: int | None = Field(None, ge=0)  # Lines above the header, or above the rows where there is none
    # "s", "ms", "us", "ns", "ticks of 100 ns", "days", "iso" (dates), "counter" (samples, with `rate_hz`)
    time_unit: Literal["s", "ms", "us", "ns", "ticks of 100 ns", "days", "iso", "counter"] = "s"
    rate_hz: float | None = Field(None, gt=0)  # Of a table without times, or of a counter

    @property
    def is_plain(self) -> bool:
        """Whether the file is one with the product's own columns."""
        return not self.model_fields_set & (LAYOUT_KEYS | {"states"})


class ImuKeys(TableKeys):
    """Files of an IMU; units count for all of them."""

    file: str | list[str]
    columns: dict[str, Column] | list[dict[str, Column]] | None = None
    accelerometer_unit: Literal["m/s^2", "g", "mg", "cm/s^2", "mm/s^2"] = "m/s^2"
    gyroscope_unit: Literal["rad/s", "deg/s", "mdps"] = "rad/s"

    @property
    def files(self) -> list[str]:
        """The files that the section names."""
        return [self.file] if isinstance(self.file, str) else self.file

    @property
    def is_plain(self) -> bool:
        """As of any table; there is one file."""
        return isinstance(self.file, str) and super().is_plain


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
        """As of any table; it is a skeleton."""
        return self.keypoints is None and super().is_plain


def _laid_out(path: Path, keys: TableKeys, strict: bool, expected: str = "") -> DeviceTable:
    """The table of a file, laid out as said."""
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path} does not exist; add it, or correct the name.")
    if keys.separator is not None and keys.separator not in SEPARATORS:
        raise RecordingError(
            f'{path}: separator is {keys.separator!r}; it is one of ",", ";", "\\t" and " ".'
        )
    skip = 0 if keys.skip_rows is None and keys.separator is not None else keys.skip_rows
    expected = expected or "the table that recording.toml describes"
    return read_table(path, expected, False, strict, keys.separator, skip)


def _placed(
    table: DeviceTable, columns: Mapping[str, Column | list[Column]], optional: Sequence[str] = ()
) -> dict[str, list[int]]:
    """Numbers (from 0) of the columns that are there, by their names or by their numbers from 1."""
    plain, at = list(map(plain_label, table.names)), {}

    def place(column: Column) -> int | None:
        if isinstance(column, int):
            return column - 1 if 1 <= column <= table.width else None
        if column in table.names:
            return table.names.index(column)
        wanted = plain_label(column)  # as written, or without the unit in brackets
        return plain.index(wanted) if wanted in plain else table.find(wanted)

    for what, column in columns.items():
        found = [place(each) for each in (column if isinstance(column, list) else [column])]
        if None not in found:
            at[what] = [each for each in found if each is not None]
        elif what not in optional:
            raise _no_column(table, what, column)
    return at


def _no_column(table: DeviceTable, what: str, column: Column | list[Column]) -> RecordingError:
    return RecordingError(
        f"{table.path} has no column {column!r} ({what}); its columns are {_listed(table)}."
        f" `unocclude import describe {table.path}` prints a recording.toml for them."
    )


def _listed(table: DeviceTable) -> str:
    return shown(", ".join(table.names)) if table.names else f"without names, 1 to {table.width}"


def _refuse_others(path: Path, columns: Mapping[str, object], known: Sequence[str]) -> None:
    """Refuse keys of `columns` that mean nothing."""
    if other := next((name for name in columns if name not in known), None):
        raise RecordingError(f"{path}: columns.{other} is not known; it is one of {', '.join(known)}.")


def _times(
    table: DeviceTable, at: Mapping[str, Sequence[int]], keys: TableKeys
) -> tuple[FloatArray | None, NDArray[np.int64] | None]:
    """Times in s, or a counter."""
    column = at["t"][0] if "t" in at else None
    if column is None or keys.time_unit == "counter":
        if keys.rate_hz is None:
            raise RecordingError(f"{table.path} has no times by recording.toml; give its rate as rate_hz.")
        if column is None:
            return None, None
        counter = table.numbers(column)
        if not np.isfinite(counter).all():
            raise RecordingError(f"{table.path}: {table.name(column)} is not a counter; it has empty cells.")
        return None, counter.astype(np.int64)
    values, are_dates = table.times(column)
    if are_dates != (keys.time_unit == "iso"):
        seen = shown(table.texts(column)[0], 40)
        raise RecordingError(
            f"{table.path}: {table.name(column)} begins with '{seen}', which is not a time in"
            f" {keys.time_unit}; correct time_unit."
        )
    times = in_seconds(values, keys.time_unit)
    if not are_dates and np.isfinite(times).any() and float(np.nanmedian(times)) > DATED_S[1]:
        raise RecordingError(
            f"{table.path}: {table.name(column)} is later than 2100 in {keys.time_unit}; correct time_unit."
        )
    return times, None


# ---------------------------------------------------------------------------------------------------- an IMU

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")


def read_imu_columns(path: Path, keys: ImuKeys, number: int = 0) -> ImuSamples:
    """The table of an IMU's file, in SI units; of several files of a section the one of that number."""
    files, given = keys.files, keys.columns
    if isinstance(given, list) and len(given) != len(files):
        raise RecordingError(
            f"{path.parent}/recording.toml: {len(files)} files have {len(given)} tables of columns; give one"
            " each."
        )
    columns = given[number] if isinstance(given, list) else given or {}
    _refuse_others(path, columns, IMU_COLUMNS)
    return imu_by_columns(_laid_out(path, keys, keys.is_plain), columns, keys, len(files) > 1)


def imu_by_columns(
    table: DeviceTable, columns: Mapping[str, Column], keys: ImuKeys, is_part: bool = False
) -> ImuSamples:
    """An IMU of the columns that are stated, or of the product's own."""
    own = {"t": "t_s", **{name: name for name in IMU_COLUMNS[1:]}}
    optional = IMU_COLUMNS if is_part else () if columns else ("t", "mx", "my", "mz")
    at = _placed(table, columns or own, optional)
    vectors: dict[str, FloatArray] = {}
    for letter in "agm":
        lacking = [letter + axis for axis in "xyz" if letter + axis not in at]
        if not lacking:
            vectors[letter] = table.vectors([at[letter + axis][0] for axis in "xyz"])
        elif len(lacking) < 3:
            raise RecordingError(f"{table.path}: columns lack {', '.join(lacking)}; name all three axes.")
    if not {"a", "g"} & vectors.keys():
        raise RecordingError(
            f"{table.path}: columns name neither an accelerometer (ax, ay, az) nor a gyroscope (gx, gy, gz)"
            f" that is there; its columns are {_listed(table)}."
        )
    t_s, counter = _times(table, at, keys)
    imu = ImuSamples(
        "", t_s=t_s, mag=vectors.get("m"), rate_hz=keys.rate_hz, counter=counter, notes=table.notes
    )
    if "a" in vectors:
        imu.acc = vectors["a"] * ACCELERATION[keys.accelerometer_unit]
    if "g" in vectors:
        imu.gyro = vectors["g"] * ANGULAR_VELOCITY[keys.gyroscope_unit]
    units = {"a": keys.accelerometer_unit, "g": keys.gyroscope_unit}
    imu.units = ", ".join(unit for letter, unit in units.items() if letter in vectors)
    return imu


def read_imu_table(path: str | os.PathLike[str], name: str) -> ImuStream:
    """Read `t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]`: s, m/s^2, rad/s, any unit for the field."""
    path = Path(path)
    table = read_imu_columns(path, ImuKeys.model_validate({"file": path.name}))
    assert table.t_s is not None and table.acc is not None and table.gyro is not None
    if len(table) < 2 or not (np.diff(table.t_s) > 0).all():
        raise RecordingError(f"{path}: t_s must increase from row to row and have at least two rows.")
    if usual_size(table.acc) < 3:
        raise RecordingError(f"{path}: the specific force is near 1, not near 9.81; give it in m/s^2.")
    mag = table.mag if table.mag is not None and np.isfinite(table.mag).all() else None
    return ImuStream(name, table.t_s, table.acc, table.gyro, mag)


# ------------------------------------------------------------------------------------ a skeleton or keypoints

STATES = {state.name.lower(): state for state in JointState}
_LONG_COLUMNS = ("t", "joint", "x", "y", "z", "state", "body")


def read_skeleton_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a skeleton's table."""
    columns = keys.columns or dict(zip(_LONG_COLUMNS, ("t_s", *_LONG_COLUMNS[1:]), strict=True))
    table = _laid_out(path, keys, keys.is_plain)
    if is_long := "joint" in columns:
        _refuse_others(path, columns, _LONG_COLUMNS)
        columns = {"x": "x", "y": "y", "z": "z", **columns}
    at = _placed(table, columns, ("state", "body") if is_long else ())
    t_s, counter = _times(table, at, keys)
    t_s = t_s if counter is None else counter / (keys.rate_hz or 1.0)
    raw = (_long_rows if is_long else _wide_rows)(table, keys, at, t_s)
    raw.notes = table.notes
    position, state = {}, {}
    for joint, points in raw.points.items():
        lost = _lost(points[:, :3])
        position[joint] = np.where(lost[:, None], np.nan, points[:, :3] * METRES[keys.position_unit])
        state[joint] = np.where(lost, JointState.NOT_TRACKED, points[:, 3]).astype(np.int8)
    hint, unit = None if keys.gravity is None else np.array(keys.gravity), keys.position_unit
    pattern = SkeletonTable(0, None, position, state, keys.frame, hint, keys.rate_hz, units=unit)
    assert raw.time is not None
    tables = raw.bodies(pattern, raw.time, 1.0 if "t" in columns else None)
    for one in tables if len(tables) > 1 else ():  # not every body has all joints
        seen = [joint for joint, states in one.state.items() if states.any()] or list(one.state)
        one.position = {joint: one.position[joint] for joint in seen}
    return tables


_POINT_COLUMNS = {"t": "t_s", "joint": "joint", "u": "u", "v": "v", "score": "score", "body": "body"}


def read_keypoint_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a table of keypoints: `position` holds u, v and the score."""
    given = keys.columns or {}
    _refuse_others(path, given, tuple(_POINT_COLUMNS))
    axes = {"u": "x", "v": "y", "score": "z"}
    columns = {axes.get(name, name): column for name, column in (_POINT_COLUMNS | given).items()}
    tables = read_skeleton_columns(path, keys.model_copy(update={"columns": columns, "position_unit": "m"}))
    for table in tables:
        table.units = PIXELS
        table.state = {joint: states_of_scores(points[:, 2]) for joint, points in table.position.items()}
    return tables


def _wide_rows(
    table: DeviceTable, keys: CameraKeys, at: dict[str, list[int]], t_s: FloatArray | None
) -> RawSkeleton:
    """One row per frame and body: three columns per joint."""
    raw = RawSkeleton(table.path, time=np.arange(len(table), dtype=float) if t_s is None else t_s)
    if "body" in at:
        raw.body = table.numbers(at["body"][0])
    for joint in (name for name in at if name not in ("t", "body")):
        if joint_code(joint.removesuffix("_state")) is None:
            raise RecordingError(
                f"{table.path}: columns.{joint} is not a joint; joints are shoulder, elbow, wrist, hand or"
                " strap with _left or _right, and t, body, JOINT_state."
            )
        if joint.endswith("_state"):
            continue
        if len(at[joint]) != 3:
            raise RecordingError(
                f"{table.path}: columns.{joint}: give its three columns x, y, z in brackets."
            )
        stated = at.get(f"{joint}_state")
        raw.points[joint] = np.column_stack([table.vectors(at[joint]), _states(table, stated, keys)])
    return raw


def _long_rows(
    table: DeviceTable, keys: CameraKeys, at: dict[str, list[int]], t_s: FloatArray | None
) -> RawSkeleton:
    """One row per joint: the rows of one time and body become one."""
    if t_s is None:
        raise RecordingError(f"{table.path}: columns.t is missing; it defines which rows are one frame.")
    values = table.vectors([at[axis][0] for axis in "xyz"])
    bodies = table.numbers(at["body"][0]) if "body" in at else np.zeros(len(table))
    names = table.texts(at["joint"][0])
    meaning = {name: _joint_of(name) for name in set(names)}
    unknown = sorted(name for name, joint in meaning.items() if not joint)
    if unknown and (table.strict or len(unknown) == len(meaning)):
        raise RecordingError(
            f"{table.path}, line {table.line(names.index(unknown[0]))}: joint"
            f" '{shown(', '.join(unknown), 120)}' is not known; it is shoulder, elbow, wrist, hand or strap"
            " with _left or _right."
        )
    said = _states(table, at.get("state"), keys)
    if (bare := (said != JointState.NOT_TRACKED) & _lost(values)).any():
        table.notes.append(
            f"Rows that are tracked or inferred and have no position: {int(bare.sum())}, the first at"
            f" {t_s[bare][0]:.3f} s."
        )
    points = np.column_stack([values, said])
    first, by_joint = gathered(t_s, bodies, [meaning[name] for name in names], points)
    by_joint.pop("", None)
    if len(table) > len(first) * len(meaning):
        table.notes.append("Rows repeat a joint and time; the last of each was taken.")
    return RawSkeleton(table.path, by_joint, time=t_s[first], body=bodies[first])


def _lost(values: FloatArray) -> NDArray[np.bool_]:
    return np.asarray((values == 0).all(axis=1) | ~np.isfinite(values).all(axis=1))


def _joint_of(name: str) -> str:
    """A joint as the product names it, from its own names or a camera program's; "" for others."""
    if joint_code(name) is not None:
        return name.strip().lower()
    meaning = joint_name(name)
    return "" if meaning is None else meaning.joint


def _states(table: DeviceTable, columns: Sequence[int] | None, keys: CameraKeys) -> NDArray[np.int64]:
    """States (n,) of a joint by the words or numbers of a column; tracked without one."""
    if columns is None:
        return np.full(len(table), JointState.TRACKED, np.int64)
    (column,) = columns
    words = STATES | {cell.strip().lower(): STATES[state] for cell, state in (keys.states or {}).items()}
    cells = [cell.lower() for cell in table.texts(column)]
    cells = [cell if cell in words else cell.removesuffix(".0") for cell in cells]
    if unknown := set(cells) - words.keys():
        raise RecordingError(
            f"{table.path}: {table.name(column)} contains '{shown(min(unknown), 40)}'; state its values'"
            ' meaning, as in states = { "0" = "not_tracked", "1" = "inferred", "2" = "tracked" }.'
        )
    return np.array([words[cell] for cell in cells], np.int64)


# ------------------------------------------------------------------------------ tables with exactly our names


def read_exact(
    path: str | os.PathLike[str],
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    words: Sequence[str] = (),
    empty: Sequence[str] = (),
    separator: str | None = ",",  # None looks for it
) -> tuple[dict[str, FloatArray], dict[str, list[str]]]:  # numbers dict of (n,), texts
    """The named columns of a table whose first line is a header; a cell that is no number is refused."""
    path, keys = Path(path), TableKeys(separator=separator, skip_rows=0, rate_hz=None)
    table = _laid_out(path, keys, True, f"a table of {', '.join(required)}")
    missing = [name for name in required if name not in table.names]
    if len(missing) == len(required):  # another kind of file, whose first line may be private
        raise RecordingError(f"{path} has none of the columns {', '.join(required)} in its first line.")
    if missing:
        raise RecordingError(
            f"{path} has no column {', '.join(missing)}; a table of {', '.join(required)} is needed, and its"
            f" columns are {_listed(table)}."
        )
    if len(table) and CUT in table.notes:
        raise RecordingError(f"{path} ends within a number of its last line; copy it again, or delete it.")
    numbers, texts = {}, {}
    for name in (name for name in (*required, *optional) if name in table.names):
        at = table.names.index(name)
        if name in words:
            texts[name] = table.texts(at)
            continue
        numbers[name] = table.numbers(at)
        if name not in empty and (missing_at := np.isnan(numbers[name])).any():
            line = table.line(int(np.argmax(missing_at)))
            raise RecordingError(f"{path}, line {line}: {table.name(at)} is empty; correct the cell.")
    return numbers, texts


#: Beyond it nanoseconds do not fit into 64 bits, s.
_LAST_S = 9.2e9


def read_pose_table(path: Path) -> PoseSamples:
    """Read poses from `t_s, x, y, z [, qw, qx, qy, qz]`; errors as in `read_exact`."""
    turn = ("qw", "qx", "qy", "qz")
    columns, _ = read_exact(path, ("t_s", "x", "y", "z"), turn, empty=("x", "y", "z", *turn))
    position, t_s = np.stack([columns[axis] for axis in "xyz"], axis=1), columns["t_s"]
    whole = set(turn) <= columns.keys()
    parts = [columns[part] if whole else np.full(len(position), np.nan) for part in turn]
    quaternion = np.stack(parts, axis=1)
    if len(row := np.flatnonzero(~(np.abs(t_s) < _LAST_S))):
        raise RecordingError(
            f"{path}: t_s is {t_s[row[0]]} in row {row[0] + 1}, which is not a time in seconds; correct it."
        )
    return PoseSamples("/truth", "camera", nanoseconds(t_s, 0), position, quaternion)
