"""Sensor logs of Android phones and Wear OS watches, and of other programs that write plain tables."""

from __future__ import annotations

import re

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ..tables.columns import ACCELERATION_WORDS, LINEAR_WORDS, TIME_WORDS, TURNING_WORDS
from ..tables.imu_checks import holds_gravity, with_settled_unit
from ..tables.imu_columns import Columns, ImuSheetFormat, angular_velocity, specific_force, unit_summary
from ..tables.protocol import FileHead, ImuTable
from ..tables.table_layout import TableLayout, is_data, layout_of, split_line
from ..tables.text_table import Sheet
from ..tables.units import (
    ACCELERATION,
    ANGULAR_VELOCITY,
    TIME,
    acceleration_unit,
    plain_unit,
    time_unit,
    turning_unit,
    unit_by_size,
)

#: Columns of time; units behind them (time_ms) are taken off already.
_TIMES = (
    *("timestamp", "time", "t", "sensor_timestamp", "sensortimestamp", "event_timestamp", "eventtimestamp"),
    *("timestamp_nano", "unix_time", "unixtime", "epoch", "seconds_elapsed", "seconds", "elapsed", "ts"),
    *("elapsedrealtime", "elapsedrealtimenanos", "elapsed_realtime_nanos", "time since start in ms"),
    *("datetime", "date", "milliseconds", "nanoseconds", "systemtime", "system_time", "phone_time"),
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
    "The signs count as Android's, gravity up; on an iPhone, Sensor Logger writes the opposite unless"
    " 'Standardise Units & Frames' is on."
)


class AndroidLog(ImuSheetFormat):
    """A time and one or two vectors; Android's units are m/s^2 and rad/s, and others are said.

    Layout: Android's `SensorEvent` (values in m/s^2 with gravity up, rad/s, timestamp in ns since boot).
    """

    key = "android"
    title = "plain sensor log (Android, Wear OS and the like)"
    recognised_by = "a time (timestamp, time, seconds_elapsed ..) beside acc x, gyro x or plain x, y, z"

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is of this layout, also of four columns without header; never raises."""
        layout = layout_of(head.lines) if head.text else None
        if layout is None or not self.fits(layout):
            return False
        if layout.names:
            return True
        rows = [split_line(line, layout.separator) for line in head.lines[layout.first_row :][:200]]
        rows = [row for row in rows if len(row) == layout.width and all(map(is_data, row))]
        try:
            times = np.array([float(row[0].replace(",", ".")) for row in rows])
        except ValueError:
            return False
        return len(times) > 3 and times[0] > 1e6 and time_unit("", times) is not None

    def fits(self, layout: TableLayout) -> bool:
        """Whether there is a time and a vector; four columns without header are a time and a vector."""
        if not layout.names:
            return layout.width == 4
        vectors = (layout.axes(*stems, signs=_SIGNS) for stems in (_ACC, _GYRO, _WITHOUT_G, _BARE))
        return _time_column(layout) is not None and any(vector is not None for vector in vectors)

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor, or the half of one; of a log with a column of sensor names, its two halves."""
        layout = sheet.layout
        t_s, notes = _times(sheet)
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
                f"{sheet.path} is a {self.title} of acceleration without gravity; log the raw accelerometer"
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


def _time_column(layout: TableLayout) -> int | None:
    exact = layout.find(*_TIMES)
    if exact is not None:
        return exact
    first = layout.labels[0]
    return 0 if first.startswith(("time", "timestamp", "elapsed", "epoch")) else None


def _times(sheet: Sheet) -> tuple[FloatArray, list[str]]:
    """Times in s, and what was decided about their unit."""
    column = _time_column(sheet.layout) if sheet.layout.names else 0
    times, dates = sheet.times(column or 0)
    if dates:
        return times, []
    label = sheet.layout.labels[column or 0] if sheet.layout.labels else ""
    stated = plain_unit(sheet.unit(column or 0))
    suffix = _SUFFIX.search(label)
    if stated in TIME:
        return times * TIME[stated], []
    said = {"n": "ns", "u": "us", "m": "ms", "s": "s"}[suffix.group(1)[0]] if suffix else ""
    said = "us" if suffix and suffix.group(1).startswith("micro") else said
    unit = time_unit(said, times)
    if unit is None:
        raise RecordingError(
            f"{sheet.path} has times in {sheet.name(column or 0)} that are no s, ms, us or ns of a sensor"
            " at 3 to 2,500 Hz; describe it in a recording.toml (`unocclude import describe` prints one)."
        )
    return times * TIME[unit], [] if said == unit else [f"Times are in {unit}, by the rate that they give."]


def _by_name(sheet: Sheet, kinds: int, columns: Columns, t_s: FloatArray, notes: list[str]) -> list[ImuTable]:
    """The halves of a log whose rows name their sensor; () where the names say nothing."""
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


def _by_size(sheet: Sheet, columns: Columns, t_s: FloatArray, notes: list[str]) -> ImuTable:
    """A vector whose columns do not say what it is, by its unit or the size of its values."""
    stated = plain_unit(sheet.unit(columns[0]))
    values = sheet.vectors(columns)
    if not np.isfinite(values).all(axis=1).any():
        raise RecordingError(f"{sheet.path} holds no samples; export it again.")
    half = ImuTable("", t_s, None, None, notes=notes)
    unit = stated or unit_by_size(values, sheet.path)
    if unit in ACCELERATION:
        half.acc = specific_force(sheet, columns, unit)
        if half.acc is not None and not holds_gravity(half.acc):
            raise RecordingError(
                f"{sheet.path} holds acceleration without gravity; log the raw accelerometer"
                " (TotalAcceleration)."
            )
        what = "an accelerometer"
    else:
        half.gyro = angular_velocity(sheet, columns, unit)
        half.gyro_unit_assumed = not stated
        what = "a gyroscope"
    half.units = unit
    if not stated:
        half.notes.append(
            f"The columns do not say what they are; by the size of its values this is {what} in {unit}."
        )
    return half
