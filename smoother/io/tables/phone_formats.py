"""Logs of phones, watches and wearables, one sensor a file or both: rows of `PHONE_FORMATS`."""

from __future__ import annotations

import re

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from .columns import ACCELERATION_WORDS, LINEAR_WORDS, TIME_WORDS, TURNING_WORDS, time_among
from .imu import ImuTable, holds_gravity, with_settled_unit
from .imu_columns import (
    Columns,
    ImuFormat,
    angular_velocity,
    is_numeric,
    named_columns,
    seconds,
    specific_force,
    unit_summary,
)
from .table import FileHead, Table, is_data, shown, split_line
from .units import (
    ACCELERATION,
    ANGULAR_VELOCITY,
    SECONDS,
    SENSOR_RATES,
    TIME,
    acceleration_unit,
    from_1970,
    plain_unit,
    time_unit,
    turning_unit,
    unit_by_size,
)

_EPOCHS = ("epoch", "epoc")
_EPOCH_CELL = re.compile(r"1\d{12}(\.\d*)?")
_TIME_CELL = re.compile(r"\d{4}-\d\d-\d\dT.*")
#: Half of an accelerometer's samples in g are within these sizes, whatever the arm does.
_ABOUT_ONE_G = (0.7, 1.3)


def _is_metamotion(layout: Table) -> bool:
    """Whether the columns are MetaBase's; a table without header has six of them."""
    if not layout.names:
        return layout.width >= 6
    elapsed = layout.find("elapsed")
    return layout.find(*_EPOCHS) is not None and elapsed is not None and layout.units[elapsed] == "s"


def _is_headless_metamotion(head: FileHead, layout: Table) -> bool:
    cells = split_line(head.lines[layout.first_row], layout.separator)
    return layout.width >= 6 and bool(_EPOCH_CELL.fullmatch(cells[0]) and _TIME_CELL.fullmatch(cells[1]))


def _metamotion_tables(form: ImuFormat, sheet: Table) -> list[ImuTable]:
    """The one sensor of the file: `acc` or `gyro`."""
    columns = _metamotion_columns(sheet)
    unit = plain_unit(sheet.unit(columns[0]))
    notes = []
    if not unit:
        size = np.linalg.norm(sheet.vectors(columns), axis=1)
        size = size[np.isfinite(size)]
        if not len(size):
            raise RecordingError(f"{sheet.path} has no samples; export it again.")
        inside = np.mean((size > _ABOUT_ONE_G[0]) & (size < _ABOUT_ONE_G[1]))
        unit = "g" if inside > 0.5 else "deg/s"
        what = "an accelerometer in g" if unit == "g" else "a gyroscope in deg/s"
        notes.append(f"Without a header: by the size of its values this is {what}.")
    if unit not in ACCELERATION and unit not in ANGULAR_VELOCITY:
        raise RecordingError(
            f"{sheet.path} is a {form.title} in '{unit}'; export the accelerometer (g) and the"
            " gyroscope (deg/s)."
        )
    acc = columns if unit in ACCELERATION else None
    gyro = columns if acc is None else None
    force = specific_force(sheet, acc, unit)
    if force is not None and not holds_gravity(force):
        raise RecordingError(
            f"{sheet.path} is a MetaMotion CSV of acceleration without gravity; record the"
            " accelerometer, not sensor fusion."
        )
    epoch = sheet.find(*_EPOCHS) or 0
    return [
        ImuTable(
            name="",
            t_s=sheet.numbers(epoch) * 1e-3,
            acc=force,
            gyro=angular_velocity(sheet, gyro, unit),
            units=unit_summary(sheet, (acc, unit), (gyro, unit)),
            notes=notes,
        )
    ]


def _metamotion_columns(sheet: Table) -> Columns:
    if not sheet.names:
        return 3, 4, 5
    columns = named_columns(sheet, ("{}-axis", "{} axis", "{}"))
    if columns is not None:
        return columns
    raise RecordingError(
        f"{sheet.path} is a MetaMotion CSV without x-axis, y-axis and z-axis; record accelerometer and"
        " gyroscope, not sensor fusion."
    )


_LOGGED_ACC = ("accelerometeracceleration",)
_LOGGED_USER, _LOGGED_GRAVITY = ("motionuseracceleration",), ("motiongravity",)
_LOGGED_GYRO, _LOGGED_RATE = ("gyrorotation",), ("motionrotationrate",)
_LOGGED_TIMES = ("loggingtime", "timestamp", "time", "locationtimestamp_since1970")


def _is_sensorlog(layout: Table) -> bool:
    """Whether some vector has SensorLog's name."""
    return any(
        layout.axes(*stems) is not None for stems in (_LOGGED_ACC, _LOGGED_USER, _LOGGED_GYRO, _LOGGED_RATE)
    )


def _sensorlog_tables(form: ImuFormat, sheet: Table) -> list[ImuTable]:
    """One sensor: raw accelerometer and gyroscope, else Core Motion's."""
    layout = sheet
    raw, user, gravity, gyro, rate = (
        _filled(sheet, layout.axes(*stems))
        for stems in (_LOGGED_ACC, _LOGGED_USER, _LOGGED_GRAVITY, _LOGGED_GYRO, _LOGGED_RATE)
    )
    summed = user is not None and gravity is not None
    if (raw is None and not summed) or (gyro is None and rate is None):
        raise RecordingError(
            f"{sheet.path} is a {form.title} without both accelerometer and gyroscope; log"
            " 'Accelerometer' and 'Gyroscope', or 'Device Motion' with user acceleration and gravity."
        )
    notes = ["iOS writes gravity, which points down; the signs were turned to specific force."]
    own_gyro = gyro is not None and (raw is not None or rate is None)
    own_acc = raw is not None and (own_gyro or not summed)
    turning = gyro if own_gyro else rate
    if own_acc:
        acc = specific_force(sheet, raw, "g", sign=-1.0)
    else:
        acc = _sum(specific_force(sheet, user, "g", -1.0), specific_force(sheet, gravity, "g", -1.0))
        notes.append("Acceleration is the sum of user acceleration and gravity of Core Motion.")
    if not own_gyro:
        notes.append("Angular velocity is Core Motion's, which removes an estimate of the bias.")
    stamp = "accelerometertimestamp_sincereboot" if own_acc else "motiontimestamp_sincereboot"
    return [
        ImuTable(
            name="",
            t_s=_sensorlog_times(sheet, stamp),
            acc=acc,
            gyro=angular_velocity(sheet, turning, "rad/s"),
            units=unit_summary(sheet, (raw if own_acc else user, "g"), (turning, "rad/s")),
            notes=notes,
        )
    ]


def _filled(sheet: Table, columns: Columns | None) -> Columns | None:
    """The columns, where there are values in them: sensors that were off leave theirs empty or null."""
    return (
        columns if columns is not None and any(_has_value(text) for text in sheet.texts(columns[0])) else None
    )


def _has_value(text: str) -> bool:
    return text.strip().lower() not in ("", "null", "nan")


def _sum(one: FloatArray | None, other: FloatArray | None) -> FloatArray | None:
    return None if one is None or other is None else one + other


def _sensorlog_times(sheet: Table, stamp: str) -> FloatArray | None:
    """The sensor's own stamps, else those of logging."""
    for label in (stamp, *_LOGGED_TIMES):
        t_s = seconds(sheet, sheet.find(label))
        if t_s is not None:
            return t_s
    raise RecordingError(f"{sheet.path} has no times; log them too (loggingTime, timestamp since reboot).")


_PHYPHOX_TIMES = (*TIME_WORDS, "t")


def _is_phyphox(layout: Table) -> bool:
    """Whether the columns are phyphox's, whose units are always in the header."""
    time = layout.find(*_PHYPHOX_TIMES)
    if time is None or plain_unit(layout.units[time]) != "s":
        return False
    vectors = [
        layout.axes(*ACCELERATION_WORDS),
        layout.axes(*TURNING_WORDS),
        layout.axes(*LINEAR_WORDS),
        layout.axes(""),
    ]
    units = {plain_unit(layout.units[c[0]]) for c in vectors if c is not None}
    return bool(units & {"m/s^2", "rad/s"}) and not units & {"g", "deg/s"}


def _phyphox_tables(form: ImuFormat, sheet: Table) -> list[ImuTable]:
    """One sensor, or the half of one."""
    layout = sheet
    acc, gyro, bare = layout.axes(*ACCELERATION_WORDS), layout.axes(*TURNING_WORDS), layout.axes("")
    if bare is not None and acc is None and gyro is None:
        unit = plain_unit(sheet.unit(bare[0]))
        acc, gyro = (bare if unit in ACCELERATION else None), (bare if unit in ANGULAR_VELOCITY else None)
    force = specific_force(sheet, acc)
    if (acc is None and gyro is None) or (force is not None and not holds_gravity(force)):
        raise RecordingError(
            f"{sheet.path} is a {form.title} of acceleration without gravity; record 'Acceleration with"
            " g' together with 'Gyroscope'."
        )
    return [
        ImuTable(
            name="",
            t_s=seconds(sheet, layout.find(*_PHYPHOX_TIMES)),
            acc=force,
            gyro=angular_velocity(sheet, gyro),
            units=unit_summary(sheet, (acc, ""), (gyro, "")),
        )
    ]


#: Columns of time; units behind them (time_ms) are taken off already.
_TIMES = (
    *("timestamp", "time", "t", "sensor_timestamp", "sensortimestamp", "event_timestamp", "eventtimestamp"),
    *("timestamp_nano", "unix_time", "unixtime", "epoch", "seconds_elapsed", "seconds", "elapsed", "ts"),
    *("elapsedrealtime", "elapsedrealtimenanos", "elapsed_realtime_nanos", "time since start in ms"),
    *("datetime", "date", "milliseconds", "nanoseconds", "systemtime", "system_time", "phone_time"),
    *("time_in", "time in", "unix", "unix timestamp", "unix_timestamp", "kinect_time", "kinecttime"),
    *("host_time", "hosttime", "captured_at", "capturedat", "capture_time", "timespan", "tick", "ticks"),
    *("time_in_ms", "time_in_us", "time_in_ns", "time_in_s", "filetime"),
    *TIME_WORDS,
)
_ACC = (
    *("acc", "accel", "accelerometer", "acceleration", "a", "total acceleration", "totalacceleration"),
    *ACCELERATION_WORDS,
)
_GYRO = (
    *("gyr", "gyro", "gyroscope", "g", "w", "angular velocity", "angular_velocity"),
    *("rotation rate", "rotationrate", "omega"),
    *TURNING_WORDS,
)
_BARE = ("", "value", "values", "v", "axis")
_WITHOUT_G = (
    *("linear acceleration", "linear_acceleration", "linearacceleration", "linacc"),
    "user acceleration",
    *LINEAR_WORDS,
)
_SIGNS = ("xyz", "012", "123")
_KIND = ("sensor", "sensor_type", "sensortype", "sensorname", "sensor_name", "type", "name", "sensor id")
_SUFFIX = re.compile(r"(?:_|\s|\b)(ns|nano\w*|us|micro\w*|ms|milli\w*|s|sec\w*)$")

#: Of the app Sensor Logger, whose columns are time, seconds_elapsed, z, y, x on both systems.
_SENSOR_LOGGER = (
    "Assumed Android's signs, gravity up; on an iPhone, Sensor Logger writes the opposite unless"
    " 'Standardise Units & Frames' is on."
)


def _is_android(layout: Table) -> bool:
    """Whether there is a time and a vector; four columns without header are a time and a vector."""
    if not layout.names:
        return layout.width == 4
    vectors = (layout.axes(*stems, signs=_SIGNS) for stems in (_ACC, _GYRO, _WITHOUT_G, _BARE))
    there = [vector is not None for vector in vectors]
    return any(there) if _time_column(layout) is not None else all(there[:2])


def _is_headless_android(head: FileHead, layout: Table) -> bool:
    """Whether four columns are a time and a vector."""
    if not _is_android(layout):
        return False
    rows = [split_line(line, layout.separator) for line in head.lines[layout.first_row :][:200]]
    rows = [row for row in rows if len(row) == layout.width and all(map(is_data, row))]
    try:
        times = np.array([float(row[0].replace(",", ".")) for row in rows])
    except ValueError:
        return False
    return len(times) > 3 and times[0] > 1e6 and time_unit("", times) is not None


def _android_tables(form: ImuFormat, sheet: Table) -> list[ImuTable]:
    """One sensor, or the half of one; of a log with a column of sensor names, its two halves."""
    layout = sheet
    t_s, notes = _android_times(sheet)
    if {"time", "seconds_elapsed"} <= set(layout.labels):
        notes.append(_SENSOR_LOGGER)
    acc, gyro = (layout.axes(*stems, signs=_SIGNS) for stems in (_ACC, _GYRO))
    bare = (1, 2, 3) if not layout.names else layout.axes(*_BARE, signs=_SIGNS)
    if acc is None and gyro is None and bare is not None:
        kinds = layout.find(*_KIND)
        named = _by_name(sheet, kinds, bare, t_s, notes) if kinds is not None else []
        return named or [_by_size(sheet, bare, t_s, notes)]
    if acc is None and gyro is None:
        raise RecordingError(
            f"{sheet.path} is a {form.title} of acceleration without gravity; log the raw accelerometer"
            " and the gyroscope."
        )
    table = ImuTable(name="", t_s=t_s, acc=None, gyro=None, notes=notes)
    units = []
    if acc is not None:
        unit = plain_unit(sheet.unit(acc[0])) or acceleration_unit(sheet.vectors(acc), notes, sheet.path)
        table.acc = specific_force(sheet, acc, unit)
        units.append((acc, unit))
    if gyro is not None:
        unit = plain_unit(sheet.unit(gyro[0])) or turning_unit(sheet.vectors(gyro), notes)
        table.gyro = angular_velocity(sheet, gyro, unit)
        table.gyro_unit_assumed = not sheet.unit(gyro[0])
        units.append((gyro, unit))
    table.units = unit_summary(sheet, *units)
    return [with_settled_unit(table)]


def _time_column(layout: Table) -> int | None:
    exact = layout.find(*_TIMES)
    if exact is not None:
        return exact
    first = layout.labels[0]
    return 0 if first.startswith(("time", "timestamp", "elapsed", "epoch")) else None


def _android_times(sheet: Table) -> tuple[FloatArray, list[str]]:
    """Times in s, and what was decided about their unit."""
    column, notes = _time_column(sheet) if sheet.names else 0, list[str]()
    if column is None:
        names = enumerate(sheet.names)
        free = {name: sheet.numbers(at) for at, name in names if is_numeric(sheet, at)}
        name, unit = time_among(free, SENSOR_RATES, sheet.path, notes)
        if not name:
            raise RecordingError(
                f"{sheet.path} has no column of times: none of {shown(', '.join(sheet.names), 150)} is"
                " known as one or rises like one; export times as well, or give rate_hz in a recording.toml"
                f" (`unocclude import describe {sheet.path}` prints one)."
            )
        return from_1970(free[name], unit) * SECONDS[unit], notes
    times, dates = sheet.times(column)
    if dates:
        return times, []
    label = sheet.labels[column] if sheet.labels else ""
    stated = TIME.get(plain_unit(sheet.unit(column)))
    suffix = _SUFFIX.search(label)
    said = {"n": "ns", "u": "us", "m": "ms", "s": "s"}[suffix.group(1)[0]] if suffix else ""
    said = "us" if suffix and suffix.group(1).startswith("micro") else said
    said = next((unit for unit, seconds in SECONDS.items() if seconds == stated), said)
    found = time_unit(said, times)
    if found is None and stated is not None:
        return times * stated, []  # what was stated is believed where no other unit does better
    if found is None:
        raise RecordingError(
            f"{sheet.path} has times in {sheet.name(column)} that are not for certain s, ms, us, ns or ticks"
            " of 100 ns of a sensor at 3 to 2,500 Hz; call the column time_s, time_ms, time_us, time_ns or"
            " time_ticks, or describe it in a recording.toml (`unocclude import describe` prints one)."
        )
    notes = [] if said == found else [f"Times are in {found}, by the rate that they give."]
    return from_1970(times, found) * SECONDS[found], notes


def _by_name(sheet: Table, kinds: int, columns: Columns, t_s: FloatArray, notes: list[str]) -> list[ImuTable]:
    """The halves of a log whose rows name their sensor; () where the names are of no use."""
    names = np.array([text.lower() for text in sheet.texts(kinds)])
    values, tables = sheet.vectors(columns), []
    for part, units in (("acc", ACCELERATION), ("gyr", ANGULAR_VELOCITY)):
        rows = np.array(
            [part in name and "lin" not in name and "uncal" not in name for name in names], dtype=bool
        )
        if not rows.any():
            continue
        written = names[rows][0]
        stated = next(
            (unit for unit in ("deg/s", "dps", "rad/s", "m/s^2", "g") if written.endswith(f"_{unit}")), ""
        )
        own: list[str] = list(notes)
        if part == "acc":
            unit = stated or acceleration_unit(values[rows], own, sheet.path)
        else:
            unit = stated or turning_unit(values[rows], own)
        half = ImuTable(
            "", t_s[rows], None, None, units=unit, notes=[*own, f"Rows of '{written[:40]}' were read."]
        )
        if part == "acc":
            half.acc = values[rows] * units[unit]
        else:
            half.gyro = values[rows] * units[unit]
        tables.append(half)
    return tables


def _by_size(sheet: Table, columns: Columns, t_s: FloatArray, notes: list[str]) -> ImuTable:
    """A vector whose columns have no telling names, by its unit or the size of its values."""
    stated = plain_unit(sheet.unit(columns[0]))
    values = sheet.vectors(columns)
    if not np.isfinite(values).all(axis=1).any():
        raise RecordingError(f"{sheet.path} has no samples; export it again.")
    half = ImuTable("", t_s, None, None, notes=notes)
    unit = stated or unit_by_size(values, sheet.path)
    if unit in ACCELERATION:
        half.acc = specific_force(sheet, columns, unit)
        if half.acc is not None and not holds_gravity(half.acc):
            raise RecordingError(
                f"{sheet.path} contains acceleration without gravity; log the raw accelerometer"
                " (TotalAcceleration)."
            )
        what = "an accelerometer"
    else:
        half.gyro = angular_velocity(sheet, columns, unit)
        half.gyro_unit_assumed = not stated
        what = "a gyroscope"
    half.units = unit
    if not stated:
        half.notes.append(f"The columns are unnamed; by the size of its values this is {what} in {unit}.")
    return half


#: Accelerometer in g or gyroscope in deg/s, with or without header; the epoch is the common clock.
_METAMOTION = ImuFormat(
    key="metamotion",
    title="MetaMotion CSV (accelerometer or gyroscope)",
    recognised_by=(
        "epoch (ms), a time, elapsed (s) and x-axis (g) or x-axis (deg/s); without header, rows of these"
    ),
    fits=_is_metamotion,
    sensors=_metamotion_tables,
    headless=_is_headless_metamotion,
)

#: Core Motion's values: g with the sign of gravity (-1 on z, lying face up), rad/s.
#:
#: Source of the sign: Apple, "Getting raw accelerometer events" and `CMDeviceMotion.gravity`; specific force
#: is the opposite, 1 g upwards.
_SENSORLOG = ImuFormat(
    key="sensorlog",
    title="SensorLog CSV (iPhone, Apple Watch)",
    recognised_by=(
        "columns such as accelerometerAccelerationX(G), gyroRotationX(rad/s), motionRotationRateX(rad/s)"
    ),
    fits=_is_sensorlog,
    sensors=_sensorlog_tables,
)

#: m/s^2 and rad/s, both in one table or in a file each; one sign on Android and iOS.
_PHYPHOX = ImuFormat(
    key="phyphox",
    title="phyphox CSV",
    recognised_by="Time (s) beside Acceleration x (m/s^2), Gyroscope x (rad/s), or X (m/s^2), X (rad/s)",
    fits=_is_phyphox,
    sensors=_phyphox_tables,
)

#: A time and one or two vectors; Android's units are m/s^2 and rad/s, and others are said.
#:
#: Layout: Android's `SensorEvent` (values in m/s^2 with gravity up, rad/s, timestamp in ns since boot).
_ANDROID = ImuFormat(
    key="android",
    title="plain sensor log (Android, Wear OS and the like)",
    recognised_by="a time (timestamp, time, seconds_elapsed ..) beside acc x, gyro x or plain x, y, z",
    fits=_is_android,
    sensors=_android_tables,
    headless=_is_headless_android,
)

#: Behind all others, the last one at the very end: its columns are the least particular.
PHONE_FORMATS = (_METAMOTION, _SENSORLOG, _PHYPHOX, _ANDROID)
