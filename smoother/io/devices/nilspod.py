"""NilsPod: CSV of NilsPodLib."""

from __future__ import annotations

import numpy as np

from ...errors import RecordingError
from ..tables.imu_checks import with_settled_unit
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

_TIMES = ("t", "utc", "utc_datetime", "local_datetime")
_COUNTS = ("n_samples", "sample_counter")
#: Other programs write these too; they count only beside columns that a NilsPod alone has.
_COMMON = ("time", "")
#: A raw sample of 16 bits reads in the hundreds or thousands.
_RAW = 150.0
#: An accelerometer's usual size in g.
_ONE_G = (0.85, 1.15)


class NilsPod(ImuSheetFormat):
    """Calibrated data: m/s^2 and deg/s."""

    key = "nilspod"
    title = "NilsPod CSV"
    recognised_by = "the columns acc_x and gyr_x beside t, utc, baro or analog_0"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are NilsPodLib's."""
        written = {"acc_x", "gyr_x"} & set(layout.names)  # lower case in the file, unlike Xsens
        own = layout.find("analog_0", "baro") is not None
        times = (*_TIMES, *_COUNTS, *_COMMON) if own else (*_TIMES, *_COUNTS)
        return bool(written) and layout.find(*times) is not None

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor."""
        layout = sheet.layout
        acc, gyro, mag = layout.axes("acc"), layout.axes("gyr"), layout.axes("mag")
        if acc is None or gyro is None:
            raise RecordingError(
                f"{sheet.path} is a {self.title} without both acc and gyr; export both sensors (factory or"
                " Ferraris-calibrated)."
            )
        notes: list[str] = []
        unit = _acceleration_unit(sheet, acc, notes)
        table = ImuTable(
            name="",
            t_s=seconds(sheet, layout.find(*_TIMES, "time")),
            acc=specific_force(sheet, acc, unit),
            gyro=angular_velocity(sheet, gyro, "deg/s"),
            mag=magnetic_field(sheet, mag),
            rate_hz=layout.stated_number("sampling rate", "sampling_rate_hz"),
            units=unit_summary(sheet, (acc, unit), (gyro, "deg/s")),
            notes=notes,
            gyro_unit_assumed=not sheet.unit(gyro[0]),
        )
        if table.t_s is None and table.rate_hz is None:
            raise RecordingError(
                f"{sheet.path} counts samples and states no rate; export it with the index 'time' or 'utc',"
                " or write rate_hz into a recording.toml (`unocclude import describe` prints one)."
            )
        return [with_settled_unit(table)]


def _acceleration_unit(sheet: Sheet, columns: Columns, notes: list[str]) -> str:
    """m/s^2, as NilsPodLib calibrates, or g, as some versions did."""
    size = np.linalg.norm(sheet.vectors(columns), axis=1)
    median = float(np.nanmedian(size)) if np.isfinite(size).any() else 0.0
    if median > _RAW:
        raise RecordingError(
            f"{sheet.path} is a {NilsPod.title} of uncalibrated values; export calibrated data"
            " (dataset.calibrate_imu() before to_csv)."
        )
    if not sheet.unit(columns[0]) and _ONE_G[0] < median < _ONE_G[1]:
        notes.append("The accelerometer states no unit; gravity is 1, so it is in g.")
        return "g"
    return "m/s^2"
