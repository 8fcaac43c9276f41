"""MbientLab MetaMotion: CSV of MetaBase and MetaHub, a file a sensor."""

from __future__ import annotations

import re

import numpy as np

from ...errors import RecordingError
from ..tables.imu_checks import holds_gravity
from ..tables.imu_columns import Columns, ImuSheetFormat, angular_velocity, specific_force, unit_summary
from ..tables.protocol import FileHead, ImuTable
from ..tables.table_layout import TableLayout, layout_of, split_line
from ..tables.text_table import Sheet
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, plain_unit

_EPOCHS = ("epoch", "epoc")
_EPOCH_CELL = re.compile(r"1\d{12}(\.\d*)?")
_TIME_CELL = re.compile(r"\d{4}-\d\d-\d\dT.*")
#: Half of an accelerometer's samples in g are within these sizes, whatever the arm does.
_ONE_G = (0.7, 1.3)


class MetaMotion(ImuSheetFormat):
    """Accelerometer in g or gyroscope in deg/s, with or without header; the epoch is the common clock."""

    key = "metamotion"
    title = "MetaMotion CSV (accelerometer or gyroscope)"
    recognised_by = (
        "epoch (ms), a time, elapsed (s) and x-axis (g) or x-axis (deg/s); without header, rows of these"
    )

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is of this layout, with a header or by its first row; never raises."""
        layout = layout_of(head.lines) if head.text else None
        if layout is None:
            return False
        if layout.names:
            return self.fits(layout)
        cells = split_line(head.lines[layout.first_row], layout.separator)
        return layout.width >= 6 and bool(_EPOCH_CELL.fullmatch(cells[0]) and _TIME_CELL.fullmatch(cells[1]))

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are MetaBase's; a table without header has six of them."""
        if not layout.names:
            return layout.width >= 6
        elapsed = layout.find("elapsed")
        return layout.find(*_EPOCHS) is not None and elapsed is not None and layout.units[elapsed] == "s"

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """The one sensor of the file: `acc` or `gyro`."""
        columns = _vector(sheet)
        unit = plain_unit(sheet.unit(columns[0]))
        notes = []
        if not unit:
            size = np.linalg.norm(sheet.vectors(columns), axis=1)
            size = size[np.isfinite(size)]
            if not len(size):
                raise RecordingError(f"{sheet.path} holds no samples; export it again.")
            inside = np.mean((size > _ONE_G[0]) & (size < _ONE_G[1]))
            unit = "g" if inside > 0.5 else "deg/s"
            what = "an accelerometer in g" if unit == "g" else "a gyroscope in deg/s"
            notes.append(f"Without a header: by the size of its values this is {what}.")
        if unit not in ACCELERATION and unit not in ANGULAR_VELOCITY:
            raise RecordingError(
                f"{sheet.path} is a {self.title} in '{unit}'; export the accelerometer (g) and the"
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
        epoch = sheet.layout.find(*_EPOCHS) or 0
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


def _vector(sheet: Sheet) -> Columns:
    if not sheet.layout.names:
        return 3, 4, 5
    for x, y, z in (("x-axis", "y-axis", "z-axis"), ("x axis", "y axis", "z axis"), ("x", "y", "z")):
        columns = [sheet.layout.find(label) for label in (x, y, z)]
        if None not in columns:
            return columns[0], columns[1], columns[2]  # type: ignore[return-value]
    raise RecordingError(
        f"{sheet.path} is a MetaMotion CSV without x-axis, y-axis and z-axis; record accelerometer and"
        " gyroscope, not sensor fusion."
    )
