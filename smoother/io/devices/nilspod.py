"""NilsPod: CSV of NilsPodLib."""

from __future__ import annotations

import numpy as np

from ...errors import RecordingError
from .imu_sheet import ImuSheetFormat, angular_velocity, magnetic_field, seconds, specific_force, units_said
from .protocol import ImuTable
from .sheet import Sheet
from .table_layout import TableLayout

_TIMES = ("t", "utc", "utc_datetime", "local_datetime", "n_samples", "time", "sample_counter", "")
#: A raw sample of 16 bits reads in the hundreds or thousands.
_RAW = 150.0


class NilsPod(ImuSheetFormat):
    """Calibrated data: m/s^2 and deg/s."""

    key = "nilspod"
    title = "NilsPod CSV"
    recognised_by = "the columns acc_x and gyr_x beside t, utc, baro or analog_0"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are NilsPodLib's."""
        first = layout.labels[0] if layout.labels else "?"
        vectors = (layout.axes("gyr") is not None and "gyr_x" in layout.labels) or "acc_x" in layout.labels
        written = {"acc_x", "gyr_x"} & set(layout.names)  # lower case in the file, unlike Xsens
        own = layout.find("analog_0", "baro", "temp") is not None
        return bool(vectors and written and first in _TIMES and (first in _TIMES[:6] or own))

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor."""
        layout = sheet.layout
        acc, gyro, mag = layout.axes("acc"), layout.axes("gyr"), layout.axes("mag")
        if acc is None or gyro is None:
            raise RecordingError(
                f"{sheet.path} is a {self.title} without both acc and gyr; export both sensors (factory or"
                " Ferraris-calibrated)."
            )
        table = ImuTable(
            name="",
            t_s=None if layout.labels[0] in ("n_samples", "sample_counter", "") else seconds(sheet, 0),
            acc=specific_force(sheet, acc, "m/s^2"),
            gyro=angular_velocity(sheet, gyro, "deg/s"),
            mag=magnetic_field(sheet, mag),
            rate_hz=layout.stated_number("sampling rate", "sampling_rate_hz"),
            units=units_said(sheet, (acc, "m/s^2"), (gyro, "deg/s")),
        )
        assert table.acc is not None
        size = np.linalg.norm(table.acc, axis=1)
        if np.isfinite(size).any() and np.nanmedian(size) > _RAW:
            raise RecordingError(
                f"{sheet.path} is a {self.title} of uncalibrated values; export calibrated data"
                " (dataset.calibrate_imu() before to_csv)."
            )
        if table.t_s is None and table.rate_hz is None:
            raise RecordingError(
                f"{sheet.path} counts samples and states no rate; export it with the index 'time' or 'utc',"
                " or write"
                " rate_hz into a recording.toml (`unocclude import describe` prints one)."
            )
        return [table]
