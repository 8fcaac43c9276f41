"""Columns of a plain table to the vectors of inertial sensors, in SI units, as an `ImuFormat` says."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from .imu import ImuTable, size_notes, with_settled_unit
from .table import FileHead, Table, read_table, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, SECONDS, TIME, from_1970, plain_unit, time_unit

Columns = tuple[int, int, int]


@dataclass(frozen=True)
class Increments:
    """Columns of velocity and rotation over a sample, which some devices write instead of rates."""

    names: str  # Of the two, as a sentence begins
    velocity: str  # Stem of the velocity's columns, m/s
    rotation: tuple[str, ...]  # Forms of the quaternion's columns, of `axis` (w, x, y, z) and `at` (0 to 3)
    units: str  # For the line about the file
    lacks: Callable[[Table, ImuTable], str]  # Of a table without these
    no_rate: str  # Behind the file's name, where neither times nor a rate are there to multiply by
    signs: tuple[str, ...] = ("xyz",)  # Of the velocity's axes


@dataclass(frozen=True)
class ImuFormat:
    """An importer of a plain table of inertial sensors; see `Format`."""

    key: str  # As in `Format`
    title: str  # As in `Format`
    recognised_by: str  # As in `Format`
    fits: Callable[[Table], bool]  # Whether a table's columns are of this device
    # What a table without both sensors is, and what to do, behind the title
    lacks: str | Callable[[Table], str] = ""
    # Stems of the vectors' columns (see `Table.axes`), the preferred one first
    acc: tuple[str, ...] = ("acc",)
    # Stems of the vectors' columns (see `Table.axes`), the preferred one first
    gyro: tuple[str, ...] = ("gyr",)
    # Stems of the vectors' columns (see `Table.axes`), the preferred one first
    mag: tuple[str, ...] = ("mag",)
    axes: str = ""  # Text after the stem, `{}` for the axis, if it is not one of the usual ones
    # Count where the file states none; the first may be a function that finds it, and notes it
    acc_unit: str | Callable[[ImuFormat, Table, Columns | None, list[str]], str] = "m/s^2"
    gyro_unit: str = "rad/s"  # Count where the file states none
    time: tuple[str, ...] = ("time",)  # Labels of the time's column, the preferred one first
    time_unit: str = "s"
    # Finds the times (n,), s, by what names the sensor and the stated rate, where `time` does not do
    times: Callable[[Table, str, float | None], FloatArray | None] | None = None
    no_times: str = ""  # Behind the file's name, where there must be times or a rate
    name: tuple[str, ...] = ()  # Lines of the preamble that state the sensor's name and rate
    rate: tuple[str, ...] = ()  # Lines of the preamble that state the sensor's name and rate
    counter: tuple[str, ...] = ()  # Labels of a packet counter, which starts anew at `counter_wraps`
    counter_wraps: int = 0
    sensor: re.Pattern[str] | None = None  # Of a table with several sensors
    notes: Callable[[Table, str], list[str]] | None = None  # Sentences on what was chosen
    increments: Increments | None = None  # What the device writes instead
    # The gyroscope's unit, where it is not stated, is the one in which gravity turns with it
    settles_unit: bool = False
    # Whether a file without header is of this device
    headless: Callable[[FileHead, Table], bool] | None = None
    # Reads the tables in a way of its own
    sensors: Callable[[ImuFormat, Table], list[ImuTable]] | None = None
    kind: str = "imu"  # As in `Format`

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is of this layout; never raises."""
        layout = head.table
        if layout is None:
            return False
        if self.headless is not None and not layout.names:
            return self.headless(head, layout)
        return self.fits(layout)

    def read(self, path: Path) -> list[ImuTable]:
        """One table per sensor, of a file that fits: see `Format.read`."""
        sheet = read_table(path, f"a table of {self.title}")
        if not self.fits(sheet):
            names = ", ".join(sheet.names) or "none"
            raise RecordingError(
                f"{path} is not of {self.title} (recognised by {self.recognised_by}); its columns are"
                f" {shown(names, 150)}."
            )
        sheet.refuse_nameless(most=1)  # one more is a counter or a comment of some exporter
        tables = self._by_name(sheet) if self.sensors is None else self.sensors(self, sheet)
        for table in tables:
            table.notes[:0] = sheet.notes
            table.notes += size_notes(table)
        return tables

    def refused(self, sheet: Table, why: str) -> RecordingError:
        """The sentence about a table of this device that cannot be used; `why` goes on behind the title."""
        article = "an" if self.title[0] in "AXx" else "a"
        return RecordingError(f"{sheet.path} is {article} {self.title} {why}")

    def _by_name(self, sheet: Table) -> list[ImuTable]:
        """The sensors of a table, in the order of its columns."""
        prefixes = [""]
        if self.sensor is not None:
            matches = [self.sensor.fullmatch(label) for label in sheet.labels]
            prefixes = list(dict.fromkeys(match.group(1) or "" for match in matches if match))
        tables = [table for prefix in prefixes if (table := self._table(sheet, prefix)) is not None]
        if not tables:
            raise self.refused(sheet, self.lacks if isinstance(self.lacks, str) else self.lacks(sheet))
        return tables

    def _table(self, sheet: Table, prefix: str) -> ImuTable | None:
        """One sensor; None where it lacks one of the two vectors."""
        layout = sheet
        acc, gyro, mag = (self._columns(layout, stems, prefix) for stems in (self.acc, self.gyro, self.mag))
        if (acc is None or gyro is None) and self.increments is None:
            return None
        notes: list[str] = [] if self.notes is None else self.notes(layout, prefix)
        unit = self.acc_unit if isinstance(self.acc_unit, str) else self.acc_unit(self, sheet, acc, notes)
        rate = layout.stated_number(*self.rate)
        if self.times is not None:
            t_s = self.times(sheet, prefix, rate)
        else:
            t_s = seconds(sheet, layout.find(*self.time), self.time_unit)
        table = ImuTable(
            name=layout.names[acc[0]][: len(prefix) - 1] if prefix and acc else layout.stated(*self.name),
            t_s=t_s,
            acc=specific_force(sheet, acc, unit),
            gyro=angular_velocity(sheet, gyro, self.gyro_unit),
            mag=magnetic_field(sheet, mag),
            rate_hz=rate,
            counter=packet_counter(sheet, layout.find(*self.counter)),
            counter_wraps=self.counter_wraps,
            units=unit_summary(sheet, (acc, unit), (gyro, self.gyro_unit)),
            notes=notes,
            gyro_unit_assumed=self.settles_unit and gyro is not None and not sheet.unit(gyro[0]),
        )
        if self.no_times and t_s is None and rate is None:
            raise RecordingError(f"{sheet.path} {self.no_times.format(title=self.title)}")
        if acc is None or gyro is None:
            self._fill_from_increments(sheet, table)
        return with_settled_unit(table) if self.settles_unit else table

    def _columns(self, layout: Table, stems: tuple[str, ...], prefix: str) -> Columns | None:
        stems = tuple(stem.format(prefix) for stem in stems)
        return (
            named_columns(layout, tuple(stem + self.axes for stem in stems))
            if self.axes
            else layout.axes(*stems)
        )

    def _fill_from_increments(self, sheet: Table, table: ImuTable) -> None:
        """Both vectors from the increments over a sample; they must be there."""
        what = self.increments
        assert what is not None
        velocity = sheet.axes(what.velocity, signs=what.signs)
        rotation = [
            sheet.find(*(form.format(axis=axis, at=at) for form in what.rotation))
            for at, axis in enumerate("wxyz")
        ]
        if velocity is None or None in rotation:
            raise self.refused(sheet, what.lacks(sheet, table))
        rate = table.rate_hz or rate_of(table.t_s)
        if rate is None:
            raise RecordingError(f"{sheet.path} {what.no_rate}")
        table.acc = acceleration_of(sheet.vectors(velocity), rate)
        table.gyro = angular_velocity_of(sheet.vectors([at for at in rotation if at is not None]), rate)
        table.units = what.units
        table.notes.append(
            f"{what.names} were multiplied by the rate of {rate:.4g} Hz to acceleration and angular velocity."
        )


def named_columns(layout: Table, forms: tuple[str, ...]) -> Columns | None:
    """Columns of x, y and z by labels in which `{}` is the axis; the first form that fits counts."""
    for form in forms:
        columns = [layout.find(form.format(axis)) for axis in "xyz"]
        if None not in columns:
            return columns[0], columns[1], columns[2]  # type: ignore[return-value]
    return None


def specific_force(
    sheet: Table, columns: Sequence[int] | None, unit: str = "", sign: float = 1.0
) -> FloatArray | None:
    """Accelerometer of three columns, (n, 3) in m/s^2; None for no columns."""
    return None if columns is None else _in_si(sheet, columns, ACCELERATION, unit, sign, "acceleration")


def angular_velocity(sheet: Table, columns: Sequence[int] | None, unit: str = "") -> FloatArray | None:
    """Gyroscope of three columns, (n, 3) in rad/s; parameters and raises as `specific_force`."""
    return (
        None if columns is None else _in_si(sheet, columns, ANGULAR_VELOCITY, unit, 1.0, "angular velocity")
    )


def magnetic_field(sheet: Table, columns: Sequence[int] | None) -> FloatArray | None:
    """Magnetometer of three columns, (n, 3) in the file's unit; None for no columns or an empty one."""
    if columns is None:
        return None
    field = sheet.vectors(columns)
    return field if np.isfinite(field).all() else None


def unit_summary(sheet: Table, *vectors: tuple[Sequence[int] | None, str]) -> str:
    """The units of vectors for the line about a file; each with the unit that counts where none is stated."""
    said = [sheet.unit(columns[0]) or unit for columns, unit in vectors if columns is not None]
    return ", ".join(plain_unit(unit) for unit in said)


def is_numeric(sheet: Table, column: int) -> bool:
    """Whether most cells of a column are numbers."""
    try:
        return bool(np.isfinite(sheet.numbers(column)).mean() > 0.5)
    except RecordingError:
        return False


def seconds(sheet: Table, column: int | None, unit: str = "s") -> FloatArray | None:
    """Times of a column, (n,) in s, dates since 1970; None for no column or one without times."""
    if column is None or not any(sheet.texts(column)[:2000]):
        return None
    times, dates = sheet.times(column)
    if not np.isfinite(times).any():
        return None
    if dates:
        return times
    stated = next((u for u, s in SECONDS.items() if s == TIME.get(plain_unit(sheet.unit(column)))), unit)
    fits = time_unit(stated, times) or stated
    note = f"Times are in {fits}, by the rate or the date that they give, not in {stated}."
    if fits != stated and note not in sheet.notes:
        sheet.notes.append(note)
    return from_1970(times, fits) * SECONDS[fits]


def packet_counter(sheet: Table, column: int | None) -> IntArray | None:
    """Packet counter of a column, (n,); None where there is none, or some packet has none."""
    if column is None:
        return None
    values = sheet.numbers(column)
    usable = len(values) and np.isfinite(values).all() and np.abs(values).max() < 2**53
    return np.round(values).astype(np.int64) if usable and (values == np.round(values)).all() else None


def _in_si(
    sheet: Table, columns: Sequence[int], units: dict[str, float], unit: str, sign: float, what: str
) -> FloatArray:
    stated = plain_unit(sheet.unit(columns[0]))
    if (stated or unit) not in units:
        raise RecordingError(
            f"{sheet.path} states the unit '{shown(stated, 40)}' of {shown(sheet.name(columns[0]), 60)},"
            f" which is not a unit of {what}; export calibrated values in {', '.join(list(units)[:1])}."
        )
    return sheet.vectors(columns) * (sign * units[stated or unit])


def acceleration_of(velocity_increment: FloatArray, rate_hz: float) -> FloatArray:
    """Mean specific force over each sample, (n, 3) in m/s^2, of velocity increments (n, 3) in m/s."""
    return velocity_increment * rate_hz


def angular_velocity_of(
    rotation_increment: FloatArray,  # (n, 4)
    rate_hz: float,
) -> FloatArray:  # (n, 3) rad/s
    """Mean angular velocity over each sample."""
    w, xyz = rotation_increment[:, :1], rotation_increment[:, 1:]
    xyz = np.where(w < 0, -xyz, xyz)
    sine = np.linalg.norm(xyz, axis=1, keepdims=True)
    angle = 2 * np.arctan2(sine, np.abs(w))
    # At small angles the rotation vector is twice the vector part.
    factor = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 2.0)
    return xyz * factor * rate_hz


def rate_of(t_s: FloatArray | None) -> float | None:
    """Samples per second by the usual step of stamps (n,) in any order; None where there is no step."""
    if t_s is None:
        return None
    steps = np.diff(np.unique(t_s[np.isfinite(t_s)]))
    return float(1 / np.median(steps)) if len(steps) else None
