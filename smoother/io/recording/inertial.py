"""IMUs of a recording's topics: in the units that gravity shows, and put together of two halves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...measurements.timestamps import increasing
from ...runtime.store import batches, by_rows, sampled
from ..mcap.messages import nanoseconds, seconds
from ..tables.imu import WRONG_SCALE, ImuTable, turn_scale, with_halves_joined
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, unit_of_rest
from .clean import GYRO_LIMIT, rest_size
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
        acc_unit, gyro_unit = shown_units(t_s, imu.acc, imu.gyro)
        file.notes += scale_to_si(imu.topic, imu.acc, imu.gyro, acc_unit, gyro_unit)
        imu.units = f"{acc_unit}, {gyro_unit}"


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


def shown_units(t_s: FloatArray, acc: FloatArray, gyro: FloatArray) -> tuple[str, str]:
    """Units in which an IMU reads gravity at rest and turns as gravity does; SI where nothing else is
    shown.
    """
    some_acc, some_gyro = sampled(acc), sampled(gyro)
    finite = np.isfinite(some_acc).all(axis=1) & np.isfinite(some_gyro).all(axis=1)
    if finite.sum() < _FEWEST:
        return "m/s^2", "rad/s"
    rest, fast = rest_size(some_acc[finite], some_gyro[finite])
    tables = (ImuTable("", t_s[rows], acc[rows], gyro[rows]) for rows in batches(len(t_s)))
    scale = next((scale for table in tables if (scale := turn_scale(table)) is not None), None)
    in_degrees = fast > GYRO_LIMIT if scale is None else scale < 1 / WRONG_SCALE
    return unit_of_rest(rest) or "m/s^2", "deg/s" if in_degrees else "rad/s"


def scale_to_si(name: str, acc: FloatArray, gyro: FloatArray, acc_unit: str, gyro_unit: str) -> list[str]:
    """Scale samples of these units in place, with a sentence each."""
    said = []
    for sensor, values, unit, factor, why in (
        ("accelerometer", acc, acc_unit, ACCELERATION[acc_unit], "as gravity shows, not in m/s^2"),
        ("gyroscope", gyro, gyro_unit, ANGULAR_VELOCITY[gyro_unit], "as the motion shows, not in rad/s"),
    ):
        if factor == 1.0:
            continue
        for rows in batches(len(values)):
            values[rows] = values[rows] * factor
        said.append(f"{name}: the {sensor} is in {unit}, {why} as stated; it was converted.")
    return said
