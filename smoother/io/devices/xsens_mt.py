"""Xsens MTw and MTi: text files of MT Manager."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
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

_RATES = ("update rate", "sample rate", "samplerate", "updaterate")
_OWN = ("quat_q0", "quat_w", "mat[1][1]", "roll", "velinc_x", "oriinc_q0", "oriinc_w", "acc_x", "utc_nano")
#: Ticks of SampleTimeFine, s (Xsens MT low-level protocol: 10 kHz).
_TICK_S = 1e-4


class XsensMt(ImuSheetFormat):
    """Acceleration in m/s^2 and angular velocity in rad/s, or their increments over a sample.

    Layout: MTw user manual, table of ASCII exports; `Counter` wraps at 65535.
    """

    key = "xsens-mt"
    title = "Xsens MT Manager export (MTw, MTi)"
    recognised_by = (
        "Counter or PacketCounter, and lines that begin with // or columns of MT Manager such as Mat[1][1]"
    )

    def fits(self, layout: TableLayout) -> bool:
        """Whether the columns are MT Manager's."""
        counted = layout.find("counter", "packetcounter", "sampletimefine")
        commented = any(line.lstrip().startswith("//") for line in layout.preamble)
        only_here = layout.find(*(name for name in _OWN if name not in ("quat_w", "roll", "acc_x")))
        plain = layout.find("counter") is not None and layout.find("acc_x") is not None
        own = layout.find(*_OWN) is not None
        return counted is not None and own and (commented or only_here is not None or plain)

    def tables(self, sheet: Sheet) -> list[ImuTable]:
        """One sensor."""
        layout = sheet.layout
        acc, gyro, mag = (layout.axes(stem) for stem in ("acc", "gyr", "mag"))
        rate, counter = layout.stated_number(*_RATES), layout.find("counter", "packetcounter")
        t_s = None if rate else _utc(sheet)
        table = ImuTable(
            name=layout.stated("deviceid", "device id"),
            t_s=_stamps(sheet) if t_s is None and rate is None else t_s,
            acc=specific_force(sheet, acc, "m/s^2"),
            gyro=angular_velocity(sheet, gyro, "rad/s"),
            mag=magnetic_field(sheet, mag),
            rate_hz=rate,
            counter=packet_counter(sheet, counter),
            counter_wraps=2**16,
            units=unit_summary(sheet, (acc, "m/s^2"), (gyro, "rad/s")),
        )
        if rate is None and table.t_s is None:
            raise RecordingError(
                f"{sheet.path} is an {self.title} that states neither a rate nor times; export it again with"
                " UTC time, or write rate_hz into a recording.toml (`unocclude import describe` prints one)."
            )
        if acc is None or gyro is None:
            self._increments(sheet, table)
        return [table]

    def _increments(self, sheet: Sheet, table: ImuTable) -> None:
        """Fill what is missing from VelInc and OriInc; they must be there."""
        layout = sheet.layout
        velocity = layout.axes("velinc")
        names = zip("wxyz", "0123", strict=True)
        rotation = [layout.find(f"oriinc_{axis}", f"oriinc_q{at}") for axis, at in names]
        if velocity is None or None in rotation:
            raise RecordingError(
                f"{sheet.path} is an {self.title} without raw sensors; export it again with calibrated data"
                " (acceleration and rate of turn: Acc_X .., Gyr_X ..)."
            )
        rate = table.rate_hz or rate_of(table.t_s)
        if rate is None:
            raise RecordingError(f"{sheet.path} has increments and no times that go on; export it again.")
        table.acc = acceleration_of(sheet.vectors(velocity), rate)
        table.gyro = angular_velocity_of(sheet.vectors([at for at in rotation if at is not None]), rate)
        table.units = "VelInc in m/s, OriInc"
        table.notes.append(
            f"VelInc and OriInc were multiplied by the rate of {rate:.4g} Hz to acceleration and angular"
            " velocity."
        )


def _stamps(sheet: Sheet) -> FloatArray | None:
    """Times of SampleTimeFine, else of a column Time; None where there are none."""
    column = sheet.layout.find("sampletimefine")
    if column is None or not np.isfinite(sheet.numbers(column)).any():
        return seconds(sheet, sheet.layout.find("time"))
    ticks = sheet.numbers(column)
    return ticks * _TICK_S if np.isfinite(ticks).mean() > 0.5 else None


def _utc(sheet: Sheet) -> FloatArray | None:
    """Seconds of the day by the UTC columns; None where they are empty."""
    columns = [sheet.layout.find(f"utc_{part}") for part in ("hour", "minute", "second", "nano")]
    if None in columns:
        return None
    hour, minute, second, nano = (sheet.numbers(column) for column in columns if column is not None)
    t_s = 3600 * hour + 60 * minute + second + 1e-9 * nano
    return t_s if np.isfinite(t_s).mean() > 0.5 else None
