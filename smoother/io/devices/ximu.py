"""x-io: x-IMU3, NGIMU and x-IMU."""

from __future__ import annotations

from ...errors import RecordingError
from ..tables.imu_columns import (
    ImuSheetFormat,
    angular_velocity,
    magnetic_field,
    packet_counter,
    seconds,
    specific_force,
    unit_summary,
)
from ..tables.protocol import ImuTable
from ..tables.table_layout import TableLayout
from ..tables.text_table import Sheet
from ..tables.units import plain_unit


class Ximu(ImuSheetFormat):
    """Units stand in the header: deg/s and g."""

    key = "x-imu"
    title = "x-IMU3 or NGIMU CSV"
    recognised_by = "columns such as Timestamp (us) or Time (s), Gyroscope X (deg/s), Accelerometer X (g)"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are x-io's: the words in full, in deg/s or g."""
        columns = [layout.axes("gyroscope"), layout.axes("accelerometer")]
        units = {plain_unit(layout.units[c[0]]) for c in columns if c is not None}
        return bool(units & {"deg/s", "g"}) and layout.find("timestamp", "time", "packet number") is not None

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor."""
        layout = sheet.layout
        acc, gyro, mag = (layout.axes(name) for name in ("accelerometer", "gyroscope", "magnetometer"))
        if acc is None or gyro is None:
            raise RecordingError(
                f"{sheet.path} is an {self.title} without both gyroscope and accelerometer; export the"
                " inertial messages (Inertial.csv, sensors.csv)."
            )
        t_s = seconds(sheet, layout.find("timestamp", "time"), "us")
        if t_s is None:
            raise RecordingError(
                f"{sheet.path} has a packet number and no times; write rate_hz into a recording.toml"
                " (`unocclude import describe` prints one)."
            )
        return [
            ImuTable(
                name="",
                t_s=t_s,
                acc=specific_force(sheet, acc, "g"),
                gyro=angular_velocity(sheet, gyro, "deg/s"),
                mag=magnetic_field(sheet, mag),
                counter=packet_counter(sheet, layout.find("packet number")),
                units=unit_summary(sheet, (acc, "g"), (gyro, "deg/s")),
            )
        ]
