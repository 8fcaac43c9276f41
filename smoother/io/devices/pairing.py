"""One sensor in two files: accelerometer and gyroscope, each at its own rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import RecordingError
from ...linalg import interpolate, median_rate_hz
from ...measurements.timestamps import PAUSE_S, PAUSE_SAMPLES
from .head import amount
from .imu_checks import turn_notes, with_settled_unit
from .protocol import ImuTable


def paired(tables: list[ImuTable], source: str) -> ImuTable:
    """One IMU of tables that hold a part of it each, on the gyroscope's times.

    Parameters
    ----------
    tables : list of ImuTable
        With repaired times, on one clock.
    source : str
        The files, for messages.

    Returns
    -------
    ImuTable
        Accelerometer (and magnetometer) interpolated to the gyroscope's times; without the samples at which
        the accelerometer paused.

    Raises
    ------
    RecordingError
        One of the two is missing or there twice, or they were not recorded at the same time.
    """
    if len(tables) == 1 and tables[0].acc is not None and tables[0].gyro is not None:
        return tables[0]
    acc, gyro = (_only(tables, part, name, source) for part, name in _PARTS)
    if acc is gyro:
        raise RecordingError(f"{source}: one file holds the whole sensor already; name it alone.")
    assert acc.t_s is not None and gyro.t_s is not None and acc.acc is not None
    first, last = max(acc.t_s[0], gyro.t_s[0]), min(acc.t_s[-1], gyro.t_s[-1])
    if not last > first:
        raise RecordingError(
            f"{source}: accelerometer and gyroscope do not overlap in time, they are {first - last:.1f} s"
            " apart; export both from the same recording."
        )
    at = gyro.t_s
    keep = (at >= first) & (at <= last) & ~_in_a_pause(acc.t_s, at)
    if keep.sum() < 2:
        raise RecordingError(
            f"{source}: accelerometer and gyroscope share too few samples; export both from the same"
            " recording."
        )
    mag = next((t for t in tables if t.mag is not None and t.t_s is not None), None)
    notes = [note for table in tables for note in table.notes]
    notes.append(
        f"The accelerometer ({median_rate_hz(acc.t_s):.1f} Hz) was interpolated to the gyroscope's times"
        f" ({median_rate_hz(at):.1f} Hz)."
    )
    if not keep.all():
        count = int((~keep).sum())
        samples = amount(
            count,
            "sample of the gyroscope has no accelerometer and was",
            "samples of the gyroscope have no accelerometer and were",
        )
        notes.append(f"{samples} left out.")
    table = replace(
        gyro,
        name=gyro.name or acc.name,
        t_s=at[keep],
        acc=interpolate(acc.t_s, acc.acc, at[keep]),
        gyro=None if gyro.gyro is None else gyro.gyro[keep],
        mag=None if mag is None else _at(mag.t_s, mag.mag, at[keep]),
        counter=None,
        units=", ".join(dict.fromkeys(unit for unit in (acc.units, gyro.units) if unit)),
        notes=notes,
    )
    table = with_settled_unit(table)
    table.notes.extend(note for note in turn_notes(table) if note not in table.notes)
    return table


_PARTS = (("acc", "accelerometer"), ("gyro", "gyroscope"))


def _only(tables: list[ImuTable], part: str, name: str, source: str) -> ImuTable:
    having = [table for table in tables if getattr(table, part) is not None]
    if len(having) == 1:
        return having[0]
    if not having:
        raise RecordingError(
            f"{source} holds no {name}; export it as well and name both files:"
            " --imu forearm_right=acc.csv,gyro.csv."
        )
    raise RecordingError(f"{source} holds {len(having)} {name}s; name one accelerometer and one gyroscope.")


def _in_a_pause(t_s: FloatArray, at: FloatArray) -> BoolArray:
    """Times (M,) that lie in a pause of samples at `t_s` (N,)."""
    dt = np.diff(t_s)
    pause_s = max(PAUSE_S, PAUSE_SAMPLES * float(np.median(dt))) if len(dt) else PAUSE_S
    row = np.clip(np.searchsorted(t_s, at, side="right") - 1, 0, max(len(dt) - 1, 0))
    exact = at == t_s[np.clip(np.searchsorted(t_s, at), 0, len(t_s) - 1)]
    return np.asarray((dt[row] > pause_s) & ~exact if len(dt) else np.zeros(len(at), bool))


def _at(t_s: FloatArray | None, values: FloatArray | None, at: FloatArray) -> FloatArray | None:
    return None if t_s is None or values is None else interpolate(t_s, values, at)
