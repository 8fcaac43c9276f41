"""APDM Opal: CSV of Mobility Lab, Moveo and Motion Studio."""

from __future__ import annotations

import re

from ...errors import RecordingError
from ..tables.imu_columns import (
    ImuSheetFormat,
    angular_velocity,
    magnetic_field,
    seconds,
    specific_force,
    unit_summary,
)
from ..tables.protocol import ImuTable
from ..tables.table_layout import TableLayout
from ..tables.text_table import Sheet

_COLUMN = re.compile(r"(.+)/(acceleration|angular velocity|magnetic field|orientation)/(x|y|z|scalar)")


class Apdm(ImuSheetFormat):
    """Several sensors in one table, m/s^2 and rad/s."""

    key = "apdm"
    title = "APDM Opal CSV"
    recognised_by = "columns such as Wrist/Acceleration/X and Wrist/Angular Velocity/X"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are sensor/quantity/axis."""
        return any(_COLUMN.fullmatch(label) for label in layout.labels)

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One table a sensor, in the file's order."""
        layout = sheet.layout
        matches = [_COLUMN.fullmatch(label) for label in layout.labels]
        sensors = {match.group(1): at for at, match in reversed(list(enumerate(matches))) if match}
        t_s = seconds(sheet, layout.find("time", "time (s)", "timestamp"))
        tables = []
        for sensor, first in sorted(sensors.items(), key=lambda item: item[1]):
            acc, gyro, mag = (
                layout.axes(f"{sensor}/{quantity}")
                for quantity in ("acceleration", "angular velocity", "magnetic field")
            )
            if acc is None or gyro is None:
                continue
            tables.append(
                ImuTable(
                    name=layout.names[first][: len(sensor)],
                    t_s=None if t_s is None else t_s.copy(),
                    acc=specific_force(sheet, acc, "m/s^2"),
                    gyro=angular_velocity(sheet, gyro, "rad/s"),
                    mag=magnetic_field(sheet, mag),
                    rate_hz=layout.stated_number("sample rate"),
                    units=unit_summary(sheet, (acc, "m/s^2"), (gyro, "rad/s")),
                )
            )
        if not tables:
            raise RecordingError(
                f"{sheet.path} is an {self.title} without both acceleration and angular velocity of a sensor;"
                " export the raw data (CSV with Acceleration and Angular Velocity)."
            )
        return tables
