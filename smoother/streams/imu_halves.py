"""An accelerometer and a gyroscope with a stream each, as headbands and telephones send them: one IMU."""

from __future__ import annotations

import numpy as np

from .arrivals import STEP_OF_IMU_S, ImuRows, StampSteps

#: Between samples of the accelerometer farther apart than this nothing is interpolated, s.
MOST_APART_S = 0.2
#: A sample waits for the other half no longer than this, s.
LONGEST_WAIT_S = 2.0


class ImuHalves:
    """Joins samples of both halves at the gyroscope's stamps, the accelerometer interpolated to them."""

    def __init__(self, acc_name: str, gyro_name: str) -> None:
        self._steps = {
            kind: StampSteps[ImuRows](name, STEP_OF_IMU_S, STEP_OF_IMU_S)
            for kind, name in (("acc", acc_name), ("gyro", gyro_name))
        }
        self._acc, self._gyro = ImuRows(), ImuRows()

    def joined(self, acc: ImuRows, gyro: ImuRows) -> tuple[ImuRows, tuple[str, ...]]:
        """What both halves reach, and what was done to stamps."""
        acc, said_acc = self._steps["acc"].corrected(acc)
        gyro, said_gyro = self._steps["gyro"].corrected(gyro)
        self._acc = _in_order(ImuRows.joined([self._acc, acc]))
        self._gyro = _in_order(ImuRows.joined([self._gyro, gyro]))
        events = (*said_acc, *said_gyro)
        if not len(self._acc) or not len(self._gyro):
            self._forget()
            return ImuRows(), events
        t = self._acc.t_s
        stop = int(np.searchsorted(self._gyro.t_s, t[-1], "right"))
        due, self._gyro = self._gyro.select(slice(0, stop)), self._gyro.select(slice(stop, None))
        after = np.clip(np.searchsorted(t, due.t_s), 0, len(t) - 1)
        before = np.maximum(np.where(t[after] > due.t_s, after - 1, after), 0)
        held = (t[before] <= due.t_s) & (due.t_s <= t[after]) & (t[after] - t[before] <= MOST_APART_S)
        force = np.stack([np.interp(due.t_s, t, self._acc.acc[:, axis]) for axis in range(3)], axis=1)
        # the sample is complete when the later half has come
        arrival_s = np.maximum(due.arrival_s, self._acc.arrival_s[after])
        rows = ImuRows(due.t_s, force, due.gyro, arrival_s).select(np.flatnonzero(held))
        self._forget()
        return rows, events

    def _forget(self) -> None:
        """Drop what nothing can be joined with any more."""
        self._acc, self._gyro = (
            rows.select(np.flatnonzero(rows.t_s > rows.t_s.max(initial=-np.inf) - LONGEST_WAIT_S))
            for rows in (self._acc, self._gyro)
        )


def _in_order(rows: ImuRows) -> ImuRows:
    """Rows in order of their stamps, each stamp once."""
    if (np.diff(rows.t_s) > 0.0).all():
        return rows
    _, first = np.unique(rows.t_s, return_index=True)
    return rows.select(first)
