"""Which columns of a table are what: as recording.toml says, or as their names, units and values show."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from ...array_types import BoolArray, FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, ImuStream, JointState
from ...runtime.inputs import check_input
from ..recording.decode import joint_code
from ..recording.keypoints import states_of_scores
from .imu import (
    Columns,
    ImuTable,
    find_sensors,
    gravity_unit,
    holds_gravity,
    kind_of_unit,
    unit_of,
    usual_size,
)
from .joints import JointColumns, find_joint_columns, joint_name
from .skeletons import PIXELS, RawSkeleton, SkeletonTable, gathered, unit_by_arm
from .table import (
    CUT,
    SEPARATORS,
    Table,
    plain_label,
    read_table,
    shown,
)
from .times import stated_time_unit, time_among, time_column
from .units import (
    ACCELERATION,
    ANGULAR_VELOCITY,
    DATED_S,
    METRES,
    SECONDS,
    SENSOR_RATES,
    from_1970,
    split_unit,
    time_unit,
)

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
    def files(self) -> list[str]:
        """The files that the section names."""
        return [self.file] if isinstance(self.file, str) else self.file

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
        """Whether the file is a skeleton with the product's own columns."""
        return self.keypoints is None and not self.model_fields_set & (LAYOUT_KEYS | {"states"})


# --------------------------------------------------------------------------------------- columns as stated

IMU_COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")


def read_imu_columns(folder: Path, keys: ImuKeys) -> list[ImuTable]:
    """The tables of an IMU, one per file, in SI units."""
    files = keys.files
    given = keys.columns if isinstance(keys.columns, list) else [keys.columns or {}] * len(files)
    if len(given) != len(files):
        raise RecordingError(
            f"{folder}/recording.toml: {len(files)} files have {len(given)} tables of columns; give one each."
        )
    tables = []
    for file, columns in zip(files, given, strict=True):
        _refuse_others(folder / file, columns, IMU_COLUMNS)
        table = _described(folder / file, keys, keys.is_plain)
        tables.append(imu_by_columns(table, columns, keys, len(files) > 1))
    return tables


def imu_by_columns(
    table: Table, columns: Mapping[str, Column], keys: ImuKeys, is_part: bool = False
) -> ImuTable:
    """An IMU of the columns that are stated, or of the product's own."""
    own = {"t": "t_s", **{name: name for name in IMU_COLUMNS[1:]}}
    optional = IMU_COLUMNS if is_part else () if columns else ("t", "mx", "my", "mz")
    at = _placed(table, columns or own, optional)
    vectors: dict[str, FloatArray] = {}
    for letter in ("a", "g", "m"):
        missing = [letter + axis for axis in "xyz" if letter + axis not in at]
        if letter + "x" not in missing:
            if missing:
                raise RecordingError(f"{table.path}: columns lack {', '.join(missing)}; name all three axes.")
            vectors[letter] = table.vectors([at[letter + axis][0] for axis in "xyz"])
    if not {"a", "g"} & vectors.keys():
        raise RecordingError(
            f"{table.path}: columns name neither an accelerometer (ax, ay, az) nor a gyroscope (gx, gy, gz)"
            f" that is there; its columns are {_listed(table)}."
        )
    t_s, counter = _times(table, at["t"][0] if "t" in at else None, keys)
    imu = ImuTable("", t_s, None, None, vectors.get("m"), keys.rate_hz, counter, notes=table.notes)
    if "a" in vectors:
        imu.acc = vectors["a"] * ACCELERATION[keys.accelerometer_unit]
    if "g" in vectors:
        imu.gyro = vectors["g"] * ANGULAR_VELOCITY[keys.gyroscope_unit]
    units = {"a": keys.accelerometer_unit, "g": keys.gyroscope_unit}
    imu.units = ", ".join(unit for letter, unit in units.items() if letter in vectors)
    return imu


def _times(
    table: Table, column: int | None, keys: TableKeys
) -> tuple[FloatArray | None, NDArray[np.int64] | None]:
    """Times in s, or a counter, of a column."""
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
    if are_dates:
        return values, None
    times = from_1970(values, keys.time_unit) * SECONDS[keys.time_unit]
    if np.isfinite(times).any() and float(np.nanmedian(times)) > DATED_S[1]:
        raise RecordingError(
            f"{table.path}: {table.name(column)} is later than 2100 in {keys.time_unit}; correct time_unit."
        )
    return times, None


def _described(
    path: Path, keys: TableKeys, strict: bool, expected: str = "the table that recording.toml describes"
) -> Table:
    """The table of a file, laid out as said."""
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path} does not exist; add it, or correct the name.")
    if keys.separator is not None and keys.separator not in SEPARATORS:
        raise RecordingError(
            f'{path}: separator is {keys.separator!r}; it is one of ",", ";", "\\t" and " ".'
        )
    skip = 0 if keys.skip_rows is None and keys.separator is not None else keys.skip_rows
    return read_table(path, expected, False, strict, keys.separator, skip)


def _placed(
    table: Table, columns: Mapping[str, Column | list[Column]], optional: Sequence[str] = ()
) -> dict[str, list[int]]:
    """Numbers (from 0) of the columns that are there, by their names or by their numbers from 1."""
    plain, at = list(map(plain_label, table.names)), {}
    for what, column in columns.items():
        places: list[int | None] = []
        for each in column if isinstance(column, list) else [column]:
            if isinstance(each, int):
                places.append(each - 1 if 1 <= each <= table.width else None)
            elif each in table.names:
                places.append(table.names.index(each))
            else:  # as written, or without the unit in brackets
                wanted = plain_label(each)
                places.append(plain.index(wanted) if wanted in plain else table.find(wanted))
        found = [place for place in places if place is not None]
        if len(found) == len(places):
            at[what] = found
        elif what not in optional:
            raise _no_column(table, what, column)
    return at


def _no_column(table: Table, what: str, column: Column | list[Column]) -> RecordingError:
    return RecordingError(
        f"{table.path} has no column {column!r} ({what}); its columns are {_listed(table)}."
        f" `unocclude import describe {table.path}` prints a recording.toml for them."
    )


def _listed(table: Table) -> str:
    return shown(", ".join(table.names)) if table.names else f"without names, 1 to {table.width}"


def _refuse_others(path: Path, columns: Mapping[str, object], known: Sequence[str]) -> None:
    """Refuse keys of `columns` that mean nothing."""
    for name in columns:
        if name not in known:
            raise RecordingError(f"{path}: columns.{name} is not known; it is one of {', '.join(known)}.")


STATES = {state.name.lower(): state for state in JointState}
_LONG_COLUMNS = ("t", "joint", "x", "y", "z", "state", "body")


def read_skeleton_columns(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a skeleton's table."""
    columns = keys.columns or dict(zip(_LONG_COLUMNS, ("t_s", *_LONG_COLUMNS[1:]), strict=True))
    table = _described(path, keys, keys.is_plain)
    if is_long := "joint" in columns:
        _refuse_others(path, columns, _LONG_COLUMNS)
        columns = {"x": "x", "y": "y", "z": "z", **columns}
    at = _placed(table, columns, ("state", "body") if is_long else ())
    t_s, counter = _times(table, at["t"][0] if "t" in at else None, keys)
    t_s = t_s if counter is None else counter / (keys.rate_hz or 1.0)
    raw = _long_rows(table, keys, at, t_s) if is_long else _wide_rows(table, keys, at, t_s)
    raw.notes = table.notes
    raw.position = {joint: values * METRES[keys.position_unit] for joint, values in raw.position.items()}
    hint = None if keys.gravity is None else np.array(keys.gravity)
    pattern = SkeletonTable(0, None, {}, {}, keys.frame, hint, keys.rate_hz, units=keys.position_unit)
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


def _lost(values: FloatArray) -> BoolArray:
    return np.asarray((values == 0).all(axis=1) | ~np.isfinite(values).all(axis=1))


def _wide_rows(
    table: Table, keys: CameraKeys, at: dict[str, list[int]], t_s: FloatArray | None
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
        values = table.vectors(at[joint])
        lost = _lost(values)
        values[lost] = np.nan
        said = _states(table, at[f"{joint}_state"][0], keys) if f"{joint}_state" in at else JointState.TRACKED
        raw.position[joint] = values
        raw.state[joint] = np.where(lost, JointState.NOT_TRACKED, said).astype(np.int8)
    return raw


def _long_rows(
    table: Table, keys: CameraKeys, at: dict[str, list[int]], t_s: FloatArray | None
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
    said = _states(table, at["state"][0], keys) if "state" in at else np.full(len(table), JointState.TRACKED)
    lost = _lost(values)
    if (bare := (said != JointState.NOT_TRACKED) & lost).any():
        table.notes.append(
            f"Rows that are tracked or inferred and have no position: {int(bare.sum())}, the first at"
            f" {t_s[bare][0]:.3f} s."
        )
    said = np.where(lost, JointState.NOT_TRACKED, said)
    first, position, state = gathered(t_s, bodies, [meaning[name] for name in names], values, said)
    for each in (position, state):
        each.pop("", None)
    if len(table) > len(first) * len(meaning):
        table.notes.append("Rows repeat a joint and time; the last of each was taken.")
    return RawSkeleton(table.path, position, state, t_s[first], body=bodies[first])


def _joint_of(name: str) -> str:
    """A joint as the product names it, from its own names or a camera program's; "" for others."""
    if joint_code(name) is not None:
        return name.strip().lower()
    meaning = joint_name(name)
    return "" if meaning is None else meaning.joint


def _states(table: Table, column: int, keys: CameraKeys) -> NDArray[np.int64]:
    """States (n,) of a joint by the words or numbers of a column."""
    own = {cell.strip().lower(): STATES[state] for cell, state in (keys.states or {}).items()}
    words = {**STATES, **own}
    cells = [cell.lower() for cell in table.texts(column)]
    cells = [cell if cell in words else cell.removesuffix(".0") for cell in cells]
    if unknown := set(cells) - words.keys():
        raise RecordingError(
            f"{table.path}: {table.name(column)} contains '{shown(min(unknown), 40)}'; state its values'"
            ' meaning, as in states = { "0" = "not_tracked", "1" = "inferred", "2" = "tracked" }.'
        )
    return np.array([words[cell] for cell in cells], np.int64)


# ----------------------------------------------------------------------------------- columns as they appear

#: How a reason begins that is made up.
UNKNOWN = "NOT KNOWN"
_NO_SENSOR = (
    "No three columns look like an accelerometer's or a gyroscope's (linear acceleration is without gravity,"
    " and is not read)."
)
_NO_UNIT_NOTE = "The gyroscope's unit is guessed by its size alone: check it in the device's manual."


@dataclass
class Guess:
    """What a table seems to contain, with the keys of recording.toml."""

    kind: str = ""  # "imu", "skeleton" or "" where nothing fits
    columns: dict[str, Any] = field(default_factory=dict)  # As in recording.toml
    keys: dict[str, Any] = field(default_factory=dict)  # Further ones (time_unit, accelerometer_unit ..)
    reasons: dict[str, str] = field(default_factory=dict)  # Why, by column or key
    unsure: list[str] = field(default_factory=list)  # What to check, a sentence each

    @property
    def settled(self) -> bool:
        """Whether times and units of an IMU are known."""
        made_up = any(reason.startswith(UNKNOWN) for reason in self.reasons.values())
        return bool({"ax", "gx"} & self.columns.keys()) and "t" in self.columns and not made_up

    def set(self, key: str, value: object, reason: str, unsure: str = "") -> None:
        """Set a key, with its reason."""
        self.keys[key], self.reasons[key] = value, reason
        self.unsure += [unsure] if unsure else []


def toml_of(path: Path, guess: Guess, name: str) -> str:
    """A recording.toml of a guess, with its reasons as comments."""
    import tomlkit

    def line(key: str, value: Any) -> str:
        item: Any = tomlkit.item(value) if not isinstance(value, dict) else tomlkit.inline_table()
        if isinstance(value, dict):
            item.update(value)
        reason = guess.reasons.get(key, "")
        return f"{key} = {item.as_string()}" + (f"  # {reason}" if reason else "")

    is_camera = guess.kind == "skeleton"
    section = "camera" if is_camera else f"imu.{name}"
    keys = {"skeleton" if is_camera else "file": path.name, **guess.keys}
    lines = [f"[{section}]", *(line(*each) for each in keys.items())]
    lines += ["", f"[{section}.columns]", *(line(*each) for each in guess.columns.items())]
    return "\n".join(lines) + "\n"


def guess_of(table: Table) -> Guess:
    """Guess what a table contains."""
    joints = find_joint_columns(table.names) if table.names else None
    return guess_skeleton(table, joints) if joints is not None and joints.has_arm() else guess_sensor(table)


def named(table: Table, column: int) -> str | int:
    """A column as recording.toml names it: by its name where it has one of its own, else by its number."""
    name = table.names[column] if table.names else ""
    return name if name and table.names.count(name) == 1 else column + 1


def guess_sensor(table: Table, usual_gyro: str = "") -> Guess:
    """Guess at an inertial sensor's table; `usual_gyro` counts where the gyroscope states no unit."""
    guess = Guess("imu")
    axes = _sensor_axes(table, guess)
    if not axes:
        return Guess(unsure=[_NO_SENSOR])
    for kind, columns in axes.items():
        guess.columns |= {kind[0] + axis: named(table, at) for axis, at in zip("xyz", columns, strict=True)}
    t_s, rate = _guess_times(table, guess, {at for columns in axes.values() for at in columns})
    force = None
    if "acc" in axes:
        values = table.vectors(axes["acc"])
        unit, why = unit_of("acc", values, table.unit(axes["acc"][0]))
        if unit and holds_gravity(values * ACCELERATION[unit]):
            guess.set("accelerometer_unit", unit, why)
            force = values * ACCELERATION[unit]
        else:
            size = f"{usual_size(values):.3g}"
            said = (
                "The acceleration is without gravity, or its unit is not known: record the raw accelerometer,"
            )
            said += f" which reads 9.81 m/s^2 or 1 g at rest, and not {size}."
            guess.set("accelerometer_unit", unit or "m/s^2", f"{UNKNOWN}: it reads {size} as a rule", said)
    if "gyro" in axes:
        values = table.vectors(axes["gyro"])
        unit, why = unit_of("gyro", values, table.unit(axes["gyro"][0]), usual_gyro, force, t_s, rate)
        size = why or f"it reads up to {np.nanpercentile(np.abs(values), 99):.3g}"
        guess.set("gyroscope_unit", unit, size, "" if why else _NO_UNIT_NOTE)
    for kind, missing in (("acc", "accelerometer"), ("gyro", "gyroscope")):
        if kind not in axes:
            guess.unsure.append(
                f"There is no {missing} here; name its file too: file = [.., ..], columns = [{{..}}, {{..}}]."
            )
    return guess


#: Stems of a sensor's columns whose names do not tell, and the signs of its axes.
_BARE, _SIGNS = ("", "value", "values", "v", "axis"), ("xyz", "012", "123")


def bare_vector(table: Table) -> Columns | None:
    """The one vector of a table whose names do not say of what; without names behind the times."""
    return table.axes(*_BARE, signs=_SIGNS) if table.labels else (1, 2, 3) if table.width == 4 else None


def sensors_named(table: Table) -> dict[str, Columns]:
    """Columns of accelerometer, gyroscope and magnetometer by names and units; those of one sensor first."""
    names = [split_unit(name)[0] for name in table.names] or list(table.labels)
    names = ["" if name.lower().endswith("raw") else name for name in names]  # counts of a converter
    sensors = find_sensors(names, units=table.units)
    sensors.sort(key=lambda sensor: not {"acc", "gyro"} <= sensor.axes.keys())
    axes: dict[str, Columns] = {}
    for sensor in sensors:
        axes = {**sensor.axes, **axes}
    return {kind: axes[kind] for kind in ("acc", "gyro", "mag") if kind in axes}


def _sensor_axes(table: Table, guess: Guess) -> dict[str, Columns]:
    axes = sensors_named(table)
    for kind, columns in axes.items():
        unit = table.unit(columns[0])
        by_unit = bool(unit) and kind_of_unit(unit) == kind
        guess.reasons[kind[0] + "x"] = f"unit {unit}" if by_unit else f"name {table.name(columns[0])}"
    bare = None if axes else bare_vector(table)
    if bare is None or (table.labels and not _is_of_numbers(table)):
        return axes if table.names else _by_magnitude(table, guess)
    kind = _kind_by_size(table, bare)
    near = "its size is gravity's" if kind == "acc" else "it shows no gravity"
    guess.reasons[kind[0] + "x"] = f"the only vector, and {near}"
    if kind == "gyro":
        guess.unsure.append(f"{table.path.name} names no columns: without gravity assumed a gyroscope.")
    return {kind: bare}


def _is_of_numbers(table: Table) -> bool:
    """Whether a table has neither words nor a quaternion: its x, y, z may be a sensor's."""
    time = time_column(table)
    numeric = (
        at == time or _time_unit(table, at, 0.0)[0] or table.is_numeric(at) for at in range(table.width)
    )
    return time is not None and all(numeric) and table.axes("q") is None


#: A field of 15 to 120 uT whose middle half lies within a quarter is the earth's.
_FIELD, _FIELD_SPREAD = (15.0, 120.0), 0.25
#: Half of an accelerometer's samples in g are within these sizes, whatever the arm does.
_ABOUT_1_G = (0.7, 1.3)
#: A size that varies by less is the system's estimate of gravity, not a sensor.
_EXACT = 1e-4


def _kind_by_size(table: Table, columns: Columns) -> str:
    """Which sensor a vector that is named after none is, by the size of its values."""
    size = np.linalg.norm(table.vectors(columns), axis=1)
    size = size[np.isfinite(size)]
    if not len(size):
        raise RecordingError(f"{table.path} has no samples; export it again.")
    low, median, high = np.percentile(size, (25, 50, 75))
    spread, in_si = high - low, gravity_unit(float(median), 0.82, 1.22) == "m/s^2"
    if in_si and spread < _EXACT * median:
        raise RecordingError(
            f"{table.path} contains gravity as the system estimates it; log the raw accelerometer."
        )
    about_1_g = (size > _ABOUT_1_G[0]) & (size < _ABOUT_1_G[1])
    if (in_si and spread < median) or about_1_g.mean() > 0.5:
        return "acc"
    if _FIELD[0] < median < _FIELD[1] and spread < _FIELD_SPREAD * median:
        raise RecordingError(
            f"{table.path} looks like a magnetometer (its size is {median:.0f} throughout); name the files of"
            " the accelerometer and the gyroscope."
        )
    return "gyro"


def _by_magnitude(table: Table, guess: Guess) -> dict[str, Columns]:
    """Accelerometer and gyroscope of a table without names: three columns whose length stays near one g."""
    columns = [column for column in range(table.width) if table.is_numeric(column)]
    best, share, least = None, 0.0, np.inf
    for three in zip(columns, columns[1:], columns[2:], strict=False):
        length = np.linalg.norm(table.vectors(three), axis=1)
        near = max(float(np.mean(np.abs(length / one - 1) < 0.2)) for one in (1.0, 9.80665, 1000.0))
        spread = float(np.nanstd(length) / np.nanmedian(length))
        # a part of a quaternion stays near 1 as well, and far more evenly than any force
        if near > 0.5 and 1e-3 < spread < least:
            best, share, least = three, near, spread
    if best is None:
        return {}
    guess.reasons["ax"] = f"the length of these three stays near one g in {100 * share:.0f} % of the rows"
    guess.unsure.append("The file names no columns; check which is which.")
    for first in (best[2] + 1, best[0] - 3):
        three = (first, first + 1, first + 2)
        if set(three) <= set(columns) and first > 0:
            guess.reasons["gx"] = "the three columns beside the accelerometer"
            return {"acc": best, "gyro": three}
    return {"acc": best}


#: Words in names of columns of times, and of counters.
_TIME_WORD = re.compile(
    r"time|zeit|temps|tiempo|tempo|stamp|epoc|elapsed"
    r"|(?:^|[^a-z])(?:t|seconds?|sec|clock|millis|micros)(?=$|[^a-z])"
)
_COUNTER = re.compile(
    r"(?:^|[^a-z])(?:counter|count|packet\w*|sample\w*|index|frame\w*|no|n|seq\w*|row)(?=$|[^a-z])"
)


def _guess_times(table: Table, guess: Guess, used: set[int]) -> tuple[FloatArray | None, float | None]:
    """Set the column of times or counts and its unit; the times in s, or the rate."""
    plain = [label.replace("_", " ") for label in table.labels] or [""] * table.width
    free = [column for column in range(table.width) if column not in used]
    best = time_column(table)
    by_word = (at for at in free if _TIME_WORD.search(plain[at]))
    timed = [at for at in dict.fromkeys((best, *by_word)) if at is not None and at in free]
    counted = [at for at in free if _COUNTER.search(plain[at])]
    for at in timed:
        unit, why = _time_unit(table, at, 0.3 if table.labels else 0.95)
        if unit:
            return _set_time(table, guess, at, unit, why), None
    others = [at for at in free if at not in (*timed, *counted)]
    try:
        found, unit = time_among(table, others, SENSOR_RATES, table.notes)
        if found is not None:
            why = "dates" if unit == "iso" else "it alone rises evenly"
            return _set_time(table, guess, found, unit, why), None
    except RecordingError as error:
        guess.unsure.append(str(error))
    numeric = (at for at in counted if table.is_numeric(at))
    if (
        count := next((at for at in numeric if np.median(np.diff(table.numbers(at))) >= 1), None)
    ) is not None:
        guess.columns["t"] = named(table, count)
        guess.set("time_unit", "counter", "a counter, and no column of times")
    lines = (line for line in table.preamble if re.search(r"rate|freq|hz", line, re.IGNORECASE))
    rates = (float(number[1]) for line in lines if (number := re.search(r"(\d+(?:\.\d+)?)", line)))
    if rate := next((each for each in rates if SENSOR_RATES[0] <= each <= SENSOR_RATES[1]), None):
        guess.set("rate_hz", rate, "stated above the table")
        return None, rate
    if best is not None:
        guess.unsure.append(
            f"The times in {table.name(best)} are not for certain s, ms, us, ns or ticks of 100 ns of a"
            " sensor at 3 to 2,500 Hz; call the column time_s, time_ms, time_us, time_ns or time_ticks."
        )
    guess.set(
        "rate_hz",
        100.0,
        f"{UNKNOWN}: the file has no times and states no rate",
        f"There is no column of times among {shown(', '.join(table.names), 150)}, and no stated rate: rate_hz"
        " is a guess, write the rate that the sensor was set to.",
    )
    return None, None


def _set_time(table: Table, guess: Guess, at: int, unit: str, why: str) -> FloatArray:
    guess.columns["t"] = named(table, at)
    guess.set("time_unit", unit, why)
    values, dates = table.times(at)
    return values if dates else from_1970(values, unit) * SECONDS[unit]


def _time_unit(table: Table, column: int, least: float) -> tuple[str, str]:
    """Unit of a column of times, and why; "" where it is none, or fewer than `least` of its steps rise."""
    try:
        values, dates = table.times(column)
    except RecordingError:
        return "", ""
    if dates:
        return "iso", "dates"
    step = np.diff(values[np.isfinite(values)])
    step = step[step > 0]
    if not len(step) or len(step) < least * (len(values) - 1):
        return "", ""
    stated = stated_time_unit(table, column)
    unit = time_unit(stated, values) or ""
    if (unit and unit == stated) or (not unit and stated and table.unit(column)):
        return unit or stated, f"stated ({table.unit(column) or stated})"
    typical = float(np.median(step))
    return unit, unit and f"steps of {typical:g} make {1 / (typical * SECONDS[unit]):.1f} samples per second"


def guess_skeleton(table: Table, joints: JointColumns) -> Guess:
    """Guess at a table with one row per frame, whose joints are known by their names."""
    guess = Guess("skeleton")
    for joint, columns in joints.axes.items():
        guess.columns[joint] = [named(table, column) for column in columns]
        if joint in joints.confidence:
            guess.columns[f"{joint}_state"] = named(table, joints.confidence[joint])
    if joints.confidence:
        cells = {cell for column in joints.confidence.values() for cell in table.texts(column)}
        meanings = ("not_tracked", "inferred", "tracked", "tracked")
        guess.set(
            "states",
            dict(zip(sorted(cells)[:4], meanings, strict=False)),
            f"{UNKNOWN}: the order of the values that occur",
            "states: what the values of the confidence mean is in the program's manual.",
        )
    position = {joint: table.vectors(columns) for joint, columns in joints.axes.items()}
    unit = unit_by_arm(position)
    why = "gives plausible arm lengths" if unit else f"{UNKNOWN}: no unit fits"
    guess.set("position_unit", unit[0] if unit else "m", why)
    scale, why = ("", "") if joints.time is None else _time_unit(table, joints.time, 0.3)
    if joints.time is not None and scale:
        guess.columns["t"] = named(table, joints.time)
        guess.set("time_unit", scale, why)
    else:
        said = "rate_hz is a guess: write the camera's frames per second."
        guess.set("rate_hz", 30.0, f"{UNKNOWN}: the file has no times", said)
    upper_arms = [
        np.nansum(position[f"elbow_{side}"] - position[f"shoulder_{side}"], axis=0)
        for side in ("left", "right")
        if {f"shoulder_{side}", f"elbow_{side}"} <= position.keys()
    ]
    down = np.sum(upper_arms, axis=0) if upper_arms else np.zeros(3)
    score = {"kinect": -down[1], "optical": down[1], "zup": -down[2]}
    best = max(score, key=lambda name: score[name])
    said = "frame: the camera's axes; `smooth` reports if gravity contradicts them."
    guess.set("frame", best, "upper arms hang down so" if score[best] > 0 else UNKNOWN, said)
    return guess


# ------------------------------------------------------------------------------ tables with exactly our names


def read_exact(
    path: str | os.PathLike[str],
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    words: Sequence[str] = (),
    empty: Sequence[str] = (),
) -> tuple[dict[str, FloatArray], dict[str, list[str]]]:  # numbers dict of (n,), texts
    """The named columns of a table whose first line is a header; a cell that is no number is refused."""
    path = Path(path)
    table = _described(
        path, TableKeys(separator=",", skip_rows=0, rate_hz=None), True, f"a table of {', '.join(required)}"
    )
    missing = [name for name in required if name not in table.names]
    if len(missing) == len(required):  # another kind of file, whose first line may be private
        raise RecordingError(f"{path} has none of the columns {', '.join(required)} in its first line.")
    if missing:
        raise _no_column(table, "needed here", ", ".join(missing))
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


def stacked(columns: dict[str, FloatArray], *names: str) -> FloatArray:
    """Columns side by side, (n, number of names)."""
    return np.stack([columns[name] for name in names], axis=1)


def read_imu_table(path: str | os.PathLike[str], name: str) -> ImuStream:
    """Read `t_s, ax, ay, az, gx, gy, gz [, mx, my, mz]`: s, m/s^2, rad/s, any unit for the field."""
    path = Path(path)
    (table,) = read_imu_columns(path.parent, ImuKeys.model_validate({"file": path.name}))
    assert table.t_s is not None and table.acc is not None and table.gyro is not None
    if len(table) < 2 or not (np.diff(table.t_s) > 0).all():
        raise RecordingError(f"{path}: t_s must increase from row to row and have at least two rows.")
    if usual_size(table.acc) < 3:
        raise RecordingError(f"{path}: the specific force is near 1, not near 9.81; give it in m/s^2.")
    mag = table.mag if table.mag is not None and np.isfinite(table.mag).all() else None
    return ImuStream(name, table.t_s, table.acc, table.gyro, mag)
