"""Xsens (Movella) DOT: CSV of the app and of the exporter."""

from __future__ import annotations

from ...errors import RecordingError
from ..tables.imu_columns import (
    ImuSheetFormat,
    acceleration_of,
    angular_velocity,
    angular_velocity_of,
    magnetic_field,
    packet_counter,
    rate_of,
    seconds,
    specific_force,
    unit_summary,
)
from ..tables.protocol import ImuTable
from ..tables.table_layout import TableLayout
from ..tables.text_table import Sheet

_FUSED = ("quat_w", "euler_x", "freeacc_x")


class XsensDot(ImuSheetFormat):
    """Acceleration in m/s^2 and angular velocity in deg/s, or their increments over a sample.

    Layout: Xsens DOT user manual, sections 4.2 (outputs, `SampleTimeFine` in us).
    """

    key = "xsens-dot"
    title = "Xsens DOT export"
    recognised_by = (
        "the columns SampleTimeFine or PacketCounter beside Acc_X, dv[1], Quat_W, Euler_X or FreeAcc_X"
    )

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are a DOT's, and not those of MT Manager."""
        if layout.find("sampletimefine", "packetcounter") is None or _of_mt_manager(layout):
            return False
        return layout.find("acc_x", "gyr_x", "dv[1]", "dv_x", "iv_x", *_FUSED) is not None

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor."""
        layout = sheet.layout
        acc, gyro, mag = (layout.axes(stem) for stem in ("acc", "gyr", "mag"))
        rate = layout.stated_number("outputrate", "output rate")
        t_s = seconds(sheet, layout.find("sampletimefine"), "us")
        table = ImuTable(
            name=layout.stated("devicetag", "device tag"),
            t_s=t_s,
            acc=specific_force(sheet, acc, "m/s^2"),
            gyro=angular_velocity(sheet, gyro, "deg/s"),
            mag=magnetic_field(sheet, mag),
            rate_hz=rate,
            counter=packet_counter(sheet, layout.find("packetcounter")),
            counter_wraps=2**32,
            units=unit_summary(sheet, (acc, "m/s^2"), (gyro, "deg/s")),
        )
        if acc is None or gyro is None:
            self._increments(sheet, table)
        return [table]

    def _increments(self, sheet: Sheet, table: ImuTable) -> None:
        """Fill what is missing from the columns of the delta modes; there must be some."""
        layout = sheet.layout
        velocity = layout.axes("dv", signs=("123", "xyz"))
        rotation = [layout.find(f"dq_{axis}", f"dq[{at}]") for at, axis in enumerate("wxyz")]
        if velocity is None or None in rotation:
            has = _fused_only(layout, table)
            raise RecordingError(
                f"{sheet.path} is an {self.title} that holds {has}; record 'Custom mode 5' or 'Rate"
                " quantities', which hold acceleration and angular velocity."
            )
        rate = table.rate_hz or rate_of(table.t_s)
        if rate is None:
            raise RecordingError(
                f"{sheet.path} holds increments but neither SampleTimeFine nor OutputRate; export it again"
                " with SampleTimeFine."
            )
        table.acc = acceleration_of(sheet.vectors(velocity), rate)
        table.gyro = angular_velocity_of(sheet.vectors([at for at in rotation if at is not None]), rate)
        table.units = "dv in m/s, dq"
        table.notes.append(
            f"The increments dv and dq were multiplied by the rate of {rate:.4g} Hz to acceleration and"
            " angular velocity."
        )


def _of_mt_manager(layout: TableLayout) -> bool:
    """Whether a table with DOT's column names is MT Manager's: `//` above it, or columns of its own."""
    others = ("quat_q0", "mat[1][1]", "utc_nano", "utc_year", "velinc_x", "oriinc_q0", "oriinc_w", "counter")
    return any(line.lstrip().startswith("//") for line in layout.preamble) or layout.find(*others) is not None


def _fused_only(layout: TableLayout, table: ImuTable) -> str:
    """What a file without both raw sensors holds, in words."""
    if table.acc is not None:
        return "acceleration but no angular velocity"
    if table.gyro is not None:
        return "angular velocity but no acceleration (free acceleration is without gravity)"
    return "quaternions and free acceleration only" if layout.find(*_FUSED) is not None else "no raw sensors"
