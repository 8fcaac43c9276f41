"""Samples of the IMU that cannot be right by themselves: held, too large, spikes, clipped, without gravity.

What is doubtful is replaced in the signal, and its place in the window gets the uncertainty of an arm that
may have moved meanwhile: the camera leads until sound samples come again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..linalg import middle, runs
from ..units import GRAVITY


class _Sensor(NamedTuple):
    """What a worn sensor measures, m/s^2 or rad/s."""

    name: str
    largest: float  # No sensor that is worn measures more (32 g; 4,300 deg/s)
    spike: float  # Samples farther than this from the median of five are spikes, at 100 Hz and above
    share: float  # A spike may have been a knock: this share of it may be missing from velocity or turn
    clipped: float  # An axis that repeats a value is clipped, from this value on
    small: tuple[float, float]  # It is never so small for so long, s
    large: tuple[float, float]  # .. nor so large
    density: float  # What an arm may do meanwhile: change by this much per square root of a second
    units: str = ""


_ACCELEROMETER = _Sensor(
    "accelerometer", 320.0, 15.0, 0.4, 10.5, (0.3 * GRAVITY, 0.15), (3.0 * GRAVITY, 0.3), 2.0
)
_GYROSCOPE = _Sensor(
    "gyroscope", 75.0, 10.0, 0.05, 1.5, (0.0, 0.15), (20.0, 0.15), 2.5, ": are its units rad/s?"
)
#: Of the velocity, m/s, and of the direction, rad.
DENSITIES = _ACCELEROMETER.density, _GYROSCOPE.density
#: A value is held where it repeats this often on all axes, while the other sensor, or its own value, shows
#: that the arm moves: rad/s, m/s^2.
REPEATS = 4
MOVING_RATE, MOVING_FORCE = 0.15, 0.6
#: .. or where repeats were no more than this share of the samples before, and this many come in a row.
USUAL_REPEATS, UNUSUAL = 0.02, 8
#: With every sample this much is looked at again, s, and this much before it is its context, s.
LOOKED_AGAIN_S, CONTEXT_S = 0.5, 0.5


class ImuCheck:
    """Judges samples one after the other; what it has seen decides what is usual."""

    def __init__(self) -> None:
        self._repeats = np.array([0.5, 0.5])

    def learn(self, acc: FloatArray, gyro: FloatArray) -> None:
        """Take in sound samples (n, 3) each, as what is usual."""
        if len(acc) < 2:
            return
        weight = min(len(acc) / 500.0, 1.0)
        share = [float(_same(each).mean()) for each in (acc, gyro)]
        self._repeats = (1.0 - weight) * self._repeats + weight * np.array(share)

    def doubt(
        self,
        t_s: FloatArray,  # (n,) s
        acc: FloatArray,  # (n, 3) m/s^2
        gyro: FloatArray,  # (n, 3) rad/s
    ) -> tuple[FloatArray, dict[str, BoolArray]]:  # (n, 2) (m/s)^2 and rad^2
        """What is doubtful of a second's samples: variances of velocity and turn, 0 where sound, and why."""
        found, reasons = np.zeros((len(t_s), 2)), dict[str, BoolArray]()
        if len(t_s) < 8:
            return found, reasons
        apart = t_s[1:] - t_s[:-1]
        each_s = np.clip(np.concatenate([[middle(apart)], apart]), 1e-4, 0.1)
        usual_s = middle(each_s)
        sizes = [np.sqrt((each * each).sum(axis=1)) for each in (acc, gyro)]
        held = self._held(acc, gyro, *sizes)
        for column, sensor in enumerate((_ACCELEROMETER, _GYROSCOPE)):
            values, size, variance = (acc, gyro)[column], sizes[column], found[:, column]
            spike, off = _spikes(values, sensor.spike * max(usual_s / 0.01, 1.0))
            variance[spike] = (sensor.share * np.minimum(off, sensor.largest) * each_s)[spike] ** 2
            (small, small_s), (large, large_s) = sensor.small, sensor.large
            too_large = (np.abs(values) > sensor.largest).any(axis=1)
            for why, rows in (
                ("repeats a value", held[column]),
                (f"is out of range{sensor.units}", too_large | _on_average(size > large, usual_s, large_s)),
                ("does not show gravity: are its units m/s^2?", _on_average(size < small, usual_s, small_s)),
                ("is clipped", _clipped(values, sensor.clipped)),
            ):
                if rows.any():
                    variance[rows] = (sensor.density**2 * each_s)[rows]
                    reasons[f"the {sensor.name} {why}"] = rows
        return found, reasons

    def _held(
        self, acc: FloatArray, gyro: FloatArray, force: FloatArray, rate: FloatArray
    ) -> tuple[BoolArray, BoolArray]:
        """Samples of each sensor (n,) that repeat a value while the arm moves, or unlike before."""
        held = [_held(acc), _held(gyro)]
        if not (held[0].any() or held[1].any()):
            return held[0], held[1]
        unusual = _long(held[0] & held[1], UNUSUAL) & (self._repeats < USUAL_REPEATS).all()
        is_moving = (np.abs(force - GRAVITY) > MOVING_FORCE) | (rate > MOVING_RATE)
        turned = _over_runs(held[0], rate) > MOVING_RATE
        shaken = _over_runs(held[1], np.abs(force - middle(force))) > MOVING_FORCE
        force_held = held[0] & (is_moving | turned | unusual)
        return force_held, held[1] & ((rate > MOVING_RATE) | shaken | unusual)


def _same(values: FloatArray) -> BoolArray:
    """Samples (n, 3) that repeat the one before on all axes, (n - 1,)."""
    return np.asarray((values[1:] == values[:-1]).all(axis=1))


def _held(values: FloatArray) -> BoolArray:
    """Samples of a long run of repeats, without its first."""
    return np.append(False, _long(_same(values), REPEATS))


def _long(rows: BoolArray, least: int) -> BoolArray:
    """The rows whose run is at least this long."""
    long = np.zeros(len(rows), bool)
    for run in runs(rows) if rows.any() else ():
        long[run] = run.stop - run.start >= least
    return long


def _over_runs(rows: BoolArray, values: FloatArray) -> FloatArray:
    """Mean of values (n,) over each run of rows; 0 outside."""
    mean = np.zeros(len(rows))
    for run in runs(rows):
        mean[run] = float(np.mean(values[run]))
    return mean


def _clipped(values: FloatArray, floor: float) -> BoolArray:
    """Samples (n,) of which one axis repeats a large value twice, as only a limit of the sensor explains."""
    again = np.zeros(values.shape, bool)
    again[1:] = (values[1:] == values[:-1]) & (np.abs(values[1:]) > floor)
    again[1:] &= again[:-1]
    again[:-1] |= again[1:]
    return np.asarray(again.any(axis=1))


def _spikes(values: FloatArray, limit: float) -> tuple[BoolArray, FloatArray]:
    """Samples far from the median of five around them, and how far (n,); twice as far for the newest two."""
    padded = np.concatenate([values[1::-1], values, values[-3:-2], values[-3:-2]])
    around = np.stack([padded[k : len(padded) - 4 + k] for k in range(5)])
    around.sort(axis=0)
    off = values - around[2]
    size = np.sqrt((off * off).sum(axis=1))
    limits = np.full(len(values), limit)
    limits[-2:] = 2.0 * limit
    return np.asarray(size > limits), size


def _on_average(rows: BoolArray, usual_s: float, seconds: float) -> BoolArray:
    """Rows of stretches of this length in which nearly all are true, without a pause for single ones."""
    width = max(round(seconds / usual_s), 3)
    if len(rows) < width or rows.sum() < 0.8 * width:
        return np.zeros(len(rows), bool)
    share = sliding_window_view(rows, width).mean(axis=1)
    stretch = np.zeros(len(rows), bool)
    for first in np.flatnonzero(share >= 0.8):
        stretch[first : first + width] = True
    return stretch
