"""IMUs of a recording's topics: in the units that gravity shows, and put together of two halves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import RecordingError
from ...measurements.timestamps import increasing
from ...runtime.store import by_rows, sampled
from ..mcap.messages import nanoseconds, seconds
from ..tables.imu import ImuTable, in_shown_units, with_halves_joined
from .streams import ImuSamples, RecordingFile, without_outlying

#: How a note on a half ends.
LEFT_OUT = "; it was left out."
#: A half whose stamps run back for a larger share of its samples is not joined.
_MOST_BACK = 0.05
#: Fewer samples do not show a unit.
_FEWEST = 100


def settle_imus(file: RecordingFile) -> None:
    """Join the IMUs whose accelerometer and gyroscope are topics of their own, and settle all units."""
    kinds = {id(imu): _only_sensor(imu) for imu in file.imus}
    halves = [imu for imu in file.imus if kinds[id(imu)]]
    if halves:
        file.imus = [imu for imu in file.imus if not kinds[id(imu)]]
        origin = min(int(imu.stamp_ns.min()) for imu in halves)
        tables = [_half(imu, kinds[id(imu)], origin, file) for imu in halves]
        joined, alone, why = with_halves_joined(tables, str(file.path))
        file.halves = [replace(half, t_s=half.t_s + origin / 1e9) for half in alone if half.t_s is not None]
        file.notes += [f"{each}: its other sensor reads zero throughout{LEFT_OUT}" for each in why]
        for table in joined:
            assert table.t_s is not None and table.acc is not None and table.gyro is not None
            file.notes += table.notes
            gyro = next(imu for imu in halves if imu.topic == table.name)
            stamp = nanoseconds(table.t_s, origin)
            gyro = replace(gyro, stamp_ns=stamp, acc=table.acc, gyro=table.gyro, mag=table.mag)
            file.imus.append(replace(gyro, made_of=table.made_of))
    for imu in file.imus:
        t_s = seconds(imu.stamp_ns, int(imu.stamp_ns[0]))
        table = in_shown_units(ImuTable(imu.topic, t_s, imu.acc, imu.gyro, units=imu.units))
        assert table.acc is not None and table.gyro is not None
        imu.acc, imu.gyro, imu.units = table.acc, table.gyro, table.units
        file.notes += table.notes


def _only_sensor(imu: ImuSamples) -> str:
    """The one sensor that was measured where the other reads zero (or nothing) throughout; "" for both."""
    silent = {
        name: not by_rows(lambda part: np.nan_to_num(part).any(axis=1), values).any()
        for name, values in (("gyroscope", imu.acc), ("accelerometer", imu.gyro))
    }
    if silent["gyroscope"] == silent["accelerometer"]:
        return ""
    name, values = ("gyroscope", imu.gyro) if silent["gyroscope"] else ("accelerometer", imu.acc)
    # what does not vary either is made up, and no sensor's
    return name if len(values) >= _FEWEST and (np.ptp(sampled(values), axis=0) != 0).any() else ""


def _half(imu: ImuSamples, kind: str, origin: int, file: RecordingFile) -> ImuTable:
    """One sensor of an IMU as a table, with increasing times."""
    stream = without_outlying(imu, file.notes)
    keep = increasing(stream.stamp_ns)
    if (~keep).mean() > _MOST_BACK:
        raise RecordingError(
            f"{file.path}: the stamps of {imu.topic} run back, so its {kind} cannot be joined with the other"
            " sensor's topic; cut the recording there, or record both in one topic."
        )
    values = (stream.acc if kind == "accelerometer" else stream.gyro)[keep]
    return ImuTable(
        imu.topic,
        seconds(stream.stamp_ns[keep], origin),
        values if kind == "accelerometer" else None,
        values if kind == "gyroscope" else None,
        None if stream.mag is None else stream.mag[keep],
    )
