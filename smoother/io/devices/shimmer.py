"""Shimmer3: CSV of Consensys."""

from __future__ import annotations

import re

from ...array_types import FloatArray
from ...errors import RecordingError
from ..tables.imu_columns import (
    Columns,
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

_COLUMN = re.compile(r"(?:(.*?)_)?(accel(?:_ln|_wr)?|gyro|mag|timestamp\w*?)(?:_([xyz]))?_(cal|raw|uncal)")
#: Preferred first; the synchronised ones are on one clock for all sensors of a session.
_TIMES = ("timestampsync_unix", "timestamp_unix", "timestampsync_formattedunix", "timestamp_formattedunix")
_OTHER_TIMES = ("timestampsync", "timestamp")


class Shimmer(ImuSheetFormat):
    """Calibrated columns; of the two accelerometers the wide-range one, which fast arms do not clip."""

    key = "shimmer"
    title = "Shimmer Consensys export"
    recognised_by = "columns such as Shimmer_952D_Accel_WR_X_CAL and Shimmer_952D_Gyro_X_CAL"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are Consensys'."""
        sensors = [_COLUMN.fullmatch(label) for label in layout.labels]
        vectors = {(match.group(2).split("_")[0]) for match in sensors if match and match.group(3)}
        return bool(vectors & {"accel", "gyro"})

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor a Shimmer, in the file's order."""
        matches = [_COLUMN.fullmatch(label) for label in sheet.layout.labels]
        prefixes = dict.fromkeys(match.group(1) or "" for match in matches if match and match.group(3))
        tables = [self._table(sheet, prefix) for prefix in prefixes]
        usable = [table for table in tables if table is not None]
        if usable:
            return usable
        raw = any(match and match.group(4) != "cal" and match.group(3) for match in matches)
        what = "uncalibrated values only" if raw else "no gyroscope or no accelerometer"
        raise RecordingError(
            f"{sheet.path} is a {self.title} that holds {what}; record both sensors and export calibrated"
            " data (the columns end in _CAL)."
        )

    def _table(self, sheet: Sheet, prefix: str) -> ImuTable | None:
        before = f"{prefix}_" if prefix else ""
        wide, low, plain, gyro, mag = (
            _vector(sheet.layout, before + name) for name in ("accel_wr", "accel_ln", "accel", "gyro", "mag")
        )
        acc = wide or low or plain
        if acc is None or gyro is None:
            return None
        notes = []
        if wide and low:
            notes.append(
                "Of its two accelerometers the wide-range one was taken (the low-noise one clips at 2 g)."
            )
        elif low:
            notes.append(
                "Its accelerometer is the low-noise one, which clips at 2 g; record the wide-range one."
            )
        written = sheet.name(acc[0]).removeprefix("column ")
        return ImuTable(
            name=written[: len(prefix)],
            t_s=_times(sheet, before),
            acc=specific_force(sheet, acc, "m/s^2"),
            gyro=angular_velocity(sheet, gyro, "deg/s"),
            mag=magnetic_field(sheet, mag),
            rate_hz=None,
            units=unit_summary(sheet, (acc, "m/s^2"), (gyro, "deg/s")),
            notes=notes,
        )


def _vector(layout: TableLayout, stem: str) -> Columns | None:
    columns = [layout.find(f"{stem}_{axis}_cal") for axis in "xyz"]
    if None in columns:
        return None
    return columns[0], columns[1], columns[2]  # type: ignore[return-value]


def _times(sheet: Sheet, before: str) -> FloatArray | None:
    for names in (_TIMES, _OTHER_TIMES):
        for name in names:
            t_s = seconds(sheet, sheet.layout.find(f"{before}{name}_cal"), "ms")
            if t_s is not None:
                return t_s
    column = sheet.layout.find(f"{before}timestamp_raw")
    return None if column is None else sheet.numbers(column) / 32768  # ticks of the device's clock
