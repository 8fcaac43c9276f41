"""What readers of tables of one inertial sensor share: columns to vectors in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from .file_head import shown
from .imu_checks import size_notes
from .protocol import FileHead, ImuTable
from .table_layout import TableLayout, layout_of
from .text_table import Sheet, read_sheet
from .units import ACCELERATION, ANGULAR_VELOCITY, TIME, plain_unit

Columns = tuple[int, int, int]


class ImuSheetFormat:
    """An importer of a table of inertial sensors; see `DeviceFormat`.

    A subclass says which layouts are its own (`fits`) and reads them (`tables`).

    Attributes
    ----------
    key, title, kind, recognised_by : str
        As in `DeviceFormat`.
    """

    key = ""
    title = ""
    kind = "imu"
    recognised_by = ""

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is of this layout; never raises."""
        layout = layout_of(head.lines) if head.text else None
        return layout is not None and self.fits(layout)

    def read(self, path: Path) -> list[ImuTable]:
        """A table a sensor, of a file that fits: see `DeviceFormat.read`."""
        sheet = read_sheet(path, f"a table of {self.title}")
        if not self.fits(sheet.layout):
            names = ", ".join(sheet.layout.names) or "none"
            raise RecordingError(
                f"{path} is not of {self.title} (recognised by {self.recognised_by}); its columns are"
                f" {shown(names, 150)}."
            )
        sheet.refuse_nameless(most=1)  # one more is a counter or a comment of some exporter
        tables = self.tables(sheet)
        for table in tables:
            table.notes[:0] = sheet.notes
            table.notes += size_notes(table)
        return tables

    def fits(self, layout: TableLayout) -> bool:
        """Whether a table's columns are of this device."""
        raise NotImplementedError

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """The sensors of a table."""
        raise NotImplementedError


def specific_force(
    sheet: Sheet, columns: Sequence[int] | None, unit: str = "", sign: float = 1.0
) -> FloatArray | None:
    """Accelerometer of three columns, (n, 3) in m/s^2; None for no columns.

    Parameters
    ----------
    sheet : Sheet
        The table.
    columns : sequence of int, optional
        Of x, y and z.
    unit : str
        Counts where the file states none.
    sign : float
        -1 where the device writes gravity, which points down, instead of specific force.

    Raises
    ------
    RecordingError
        The file states a unit that is none of acceleration.
    """
    return None if columns is None else _in_si(sheet, columns, ACCELERATION, unit, sign, "acceleration")


def angular_velocity(sheet: Sheet, columns: Sequence[int] | None, unit: str = "") -> FloatArray | None:
    """Gyroscope of three columns, (n, 3) in rad/s; parameters and raises as `specific_force`."""
    return (
        None if columns is None else _in_si(sheet, columns, ANGULAR_VELOCITY, unit, 1.0, "angular velocity")
    )


def magnetic_field(sheet: Sheet, columns: Sequence[int] | None) -> FloatArray | None:
    """Magnetometer of three columns, (n, 3) in the file's unit; None for no columns or an empty one."""
    if columns is None:
        return None
    field = sheet.vectors(columns)
    return field if np.isfinite(field).all() else None


def unit_summary(sheet: Sheet, *vectors: tuple[Sequence[int] | None, str]) -> str:
    """The units of vectors for the line about a file; each with the unit that counts where none is stated."""
    said = [sheet.unit(columns[0]) or unit for columns, unit in vectors if columns is not None]
    return ", ".join(plain_unit(unit) for unit in said)


def seconds(sheet: Sheet, column: int | None, unit: str = "s") -> FloatArray | None:
    """Times of a column, (n,) in s, dates since 1970; None for no column or one without times.

    Parameters
    ----------
    sheet : Sheet
        The table.
    column : int, optional
        Its number.
    unit : str
        Of numbers, where the file states none.
    """
    if column is None or not any(sheet.texts(column)[:2000]):
        return None
    times, dates = sheet.times(column)
    if not np.isfinite(times).any():
        return None
    return times if dates else times * TIME.get(plain_unit(sheet.unit(column)), TIME[unit])


def packet_counter(sheet: Sheet, column: int | None) -> IntArray | None:
    """Packet counter of a column, (n,); None where there is none, or some packet has none."""
    if column is None:
        return None
    values = sheet.numbers(column)
    usable = len(values) and np.isfinite(values).all() and np.abs(values).max() < 2**53
    return np.round(values).astype(np.int64) if usable and (values == np.round(values)).all() else None


def _in_si(
    sheet: Sheet, columns: Sequence[int], units: dict[str, float], unit: str, sign: float, what: str
) -> FloatArray:
    stated = plain_unit(sheet.unit(columns[0]))
    if (stated or unit) not in units:
        raise RecordingError(
            f"{sheet.path} states the unit '{shown(stated, 40)}' of {shown(sheet.name(columns[0]), 60)},"
            f" which is no unit of {what}; export calibrated values in {', '.join(list(units)[:1])}."
        )
    return sheet.vectors(columns) * (sign * units[stated or unit])


def acceleration_of(velocity_increment: FloatArray, rate_hz: float) -> FloatArray:
    """Mean specific force over each sample, (n, 3) in m/s^2, of velocity increments (n, 3) in m/s."""
    return velocity_increment * rate_hz


def angular_velocity_of(rotation_increment: FloatArray, rate_hz: float) -> FloatArray:
    """Mean angular velocity over each sample.

    Parameters
    ----------
    rotation_increment : ndarray, shape (n, 4)
        Unit quaternions w, x, y, z that turn by one sample.
    rate_hz : float, Hz
        Samples a second.

    Returns
    -------
    ndarray, shape (n, 3), rad/s
        The rotation vector of the increment, times the rate.
    """
    w, xyz = rotation_increment[:, :1], rotation_increment[:, 1:]
    xyz = np.where(w < 0, -xyz, xyz)
    sine = np.linalg.norm(xyz, axis=1, keepdims=True)
    angle = 2 * np.arctan2(sine, np.abs(w))
    # At small angles the rotation vector is twice the vector part.
    factor = np.where(sine > 1e-9, angle / np.maximum(sine, 1e-12), 2.0)
    return xyz * factor * rate_hz


def rate_of(t_s: FloatArray | None) -> float | None:
    """Samples a second by the usual step of stamps (n,) in any order; None where there is no step."""
    if t_s is None:
        return None
    steps = np.diff(np.unique(t_s[np.isfinite(t_s)]))
    return float(1 / np.median(steps)) if len(steps) else None
