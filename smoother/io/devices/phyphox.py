"""phyphox: CSV of experiments on phones."""

from __future__ import annotations

from ...errors import RecordingError
from ..tables.columns import ACCELERATION_WORDS, LINEAR_WORDS, TIME_WORDS, TURNING_WORDS
from ..tables.imu_checks import holds_gravity
from ..tables.imu_columns import ImuSheetFormat, angular_velocity, seconds, specific_force, unit_summary
from ..tables.protocol import ImuTable
from ..tables.table_layout import TableLayout
from ..tables.text_table import Sheet
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, plain_unit

_TIME = (*TIME_WORDS, "t")


class Phyphox(ImuSheetFormat):
    """m/s^2 and rad/s, both in one table or in a file each; one sign on Android and iOS."""

    key = "phyphox"
    title = "phyphox CSV"
    recognised_by = "Time (s) beside Acceleration x (m/s^2), Gyroscope x (rad/s), or X (m/s^2), X (rad/s)"

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are phyphox's, whose units are always in the header."""
        time = layout.find(*_TIME)
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

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor, or the half of one."""
        layout = sheet.layout
        acc, gyro, bare = layout.axes(*ACCELERATION_WORDS), layout.axes(*TURNING_WORDS), layout.axes("")
        if bare is not None and acc is None and gyro is None:
            unit = plain_unit(sheet.unit(bare[0]))
            acc, gyro = (bare if unit in ACCELERATION else None), (bare if unit in ANGULAR_VELOCITY else None)
        force = specific_force(sheet, acc)
        if (acc is None and gyro is None) or (force is not None and not holds_gravity(force)):
            raise RecordingError(
                f"{sheet.path} is a {self.title} of acceleration without gravity; record 'Acceleration with"
                " g' together with 'Gyroscope'."
            )
        return [
            ImuTable(
                name="",
                t_s=seconds(sheet, layout.find(*_TIME)),
                acc=force,
                gyro=angular_velocity(sheet, gyro),
                units=unit_summary(sheet, (acc, ""), (gyro, "")),
            )
        ]
