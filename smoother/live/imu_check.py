"""Samples of the IMU that cannot be right by themselves: held, too large, spikes, clipped, without gravity.

What is doubtful is replaced in the signal, and its place in the window gets the uncertainty of an arm that
may have moved meanwhile: the camera leads until sound samples come again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..linalg import middle, runs
from ..units import GRAVITY

#: No sensor that is worn measures more, m/s^2 (32 g) and rad/s (4,300 deg/s).
LARGEST_FORCE, LARGEST_RATE = 320.0, 75.0
#: A value is held where it repeats this often on all axes, while the other sensor, or its own value, shows
#: that the arm moves: rad/s, m/s^2.
REPEATS = 4
MOVING_RATE, MOVING_FORCE = 0.15, 0.6
#: .. or where repeats were no more than this share of the samples before, and this many come in a row.
USUAL_REPEATS, UNUSUAL = 0.02, 8
#: Samples farther than this from the median of five are spikes, m/s^2 and rad/s at 100 Hz and above.
SPIKE_FORCE, SPIKE_RATE = 15.0, 10.0
#: A spike may have been a knock: this share of it may be missing from the velocity; from the turn, this one.
KNOCK_SHARE, TURN_SHARE = 0.4, 0.05
#: The specific force is never so small for this long, nor so large, in g and s; nor the rate, rad/s.
SMALLEST_G, SMALL_S = 0.3, 0.15
LARGE_G, LARGE_S = 3.0, 0.3
LARGE_RATE, LARGE_RATE_S = 20.0, 0.15
#: An axis that repeats a value is clipped, from these values on.
CLIPPED_FORCE, CLIPPED_RATE = 10.5, 1.5
#: What an arm may do meanwhile: its velocity and direction change by this much per square root of a second.
VELOCITY_DENSITY, TURN_DENSITY = 2.0, 2.5
#: With every sample this much is looked at again, s, and this much before it is its context, s.
AGAIN_S, CONTEXT_S = 0.5, 0.5


@dataclass(frozen=True)
class Doubt:
    """What is doubtful of some samples."""

    # (n,), (m/s) ^2: Variance of the velocity for each sample whose specific force is not used; 0 where it is
    velocity: FloatArray
    turn: FloatArray  # (n,) rad^2: likewise for the angular rate
    reason: dict[str, BoolArray]  # bool (n,): why, in words


class ImuCheck:
    """Judges samples one after the other; what it has seen decides what is usual."""

    def __init__(self) -> None:
        self._largest = np.zeros(6)
        self._repeats = np.array([0.5, 0.5])

    def learn(self, acc: FloatArray, gyro: FloatArray) -> None:
        """Take in sound samples (n, 3) each, as what is usual."""
        values = np.abs(np.hstack([acc, gyro]))
        if len(values) < 2:
            return
        self._largest = np.maximum(self._largest, values.max(axis=0))
        weight = min(len(values) / 500.0, 1.0)
        share = [float(_same(each).mean()) for each in (acc, gyro)]
        self._repeats = (1.0 - weight) * self._repeats + weight * np.array(share)

    def doubt(
        self,
        t_s: FloatArray,  # (n,) s
        acc: FloatArray,  # (n, 3) m/s^2
        gyro: FloatArray,  # (n, 3) rad/s
    ) -> Doubt:
        """What is doubtful of the samples of about a second."""
        count = len(t_s)
        velocity, turn = np.zeros(count), np.zeros(count)
        reason: dict[str, BoolArray] = {}
        if count < 8:
            return Doubt(velocity, turn, reason)
        apart = t_s[1:] - t_s[:-1]
        each_s = np.clip(np.concatenate([[middle(apart)], apart]), 1e-4, 0.1)
        usual_s = middle(each_s)
        force, rate = np.sqrt((acc * acc).sum(axis=1)), np.sqrt((gyro * gyro).sum(axis=1))
        slow = max(usual_s / 0.01, 1.0)
        spike, size = _spikes(acc, SPIKE_FORCE * slow)
        if spike.any():
            velocity[spike] = (KNOCK_SHARE * np.minimum(size, LARGEST_FORCE) * each_s)[spike] ** 2
        spike, size = _spikes(gyro, SPIKE_RATE * slow)
        if spike.any():
            turn[spike] = (TURN_SHARE * np.minimum(size, LARGEST_RATE) * each_s)[spike] ** 2
        force_held, rate_held = self._held(acc, gyro, force, rate)
        clipped = [
            _clipped(values, self._largest[columns], floor)
            for values, columns, floor in (
                (acc, slice(0, 3), CLIPPED_FORCE),
                (gyro, slice(3, 6), CLIPPED_RATE),
            )
        ]
        by_force = {
            "the accelerometer repeats a value": force_held,
            "the accelerometer is out of range": (np.abs(acc) > LARGEST_FORCE).any(axis=1)
            | _on_average(force > LARGE_G * GRAVITY, usual_s, LARGE_S),
            "the accelerometer does not show gravity: are its units m/s^2?": _on_average(
                force < SMALLEST_G * GRAVITY, usual_s, SMALL_S
            ),
            "the accelerometer is clipped": clipped[0],
        }
        by_rate = {
            "the gyroscope repeats a value": rate_held,
            "the gyroscope is out of range: are its units rad/s?": (np.abs(gyro) > LARGEST_RATE).any(axis=1)
            | _on_average(rate > LARGE_RATE, usual_s, LARGE_RATE_S),
            "the gyroscope is clipped": clipped[1],
        }
        for found, variance, density in (
            (by_force, velocity, VELOCITY_DENSITY),
            (by_rate, turn, TURN_DENSITY),
        ):
            for why, rows in found.items():
                if rows.any():
                    variance[rows] = (density**2 * each_s)[rows]
                    reason[why] = rows
        return Doubt(velocity, turn, reason)

    def _held(
        self, acc: FloatArray, gyro: FloatArray, force: FloatArray, rate: FloatArray
    ) -> tuple[BoolArray, BoolArray]:
        """Samples of each sensor (n,) that repeat a value while the arm moves, or unlike before."""
        held = [_held(acc), _held(gyro)]
        if not (held[0].any() or held[1].any()):
            return held[0], held[1]
        unusual = held[0] & held[1] & _long(held[0] & held[1]) & (self._repeats < USUAL_REPEATS).all()
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
    held = np.zeros(len(values), bool)
    same = _same(values)
    if not same.any():
        return held
    for run in runs(same):
        if run.stop - run.start >= REPEATS:
            held[run.start + 1 : run.stop + 1] = True
    return held


def _long(rows: BoolArray) -> BoolArray:
    """Rows in runs of `UNUSUAL` at least."""
    long = np.zeros(len(rows), bool)
    for run in runs(rows):
        long[run] = run.stop - run.start >= UNUSUAL
    return long


def _over_runs(rows: BoolArray, values: FloatArray) -> FloatArray:
    """Mean of values (n,) over each run of rows; 0 outside."""
    mean = np.zeros(len(rows))
    for run in runs(rows):
        mean[run] = float(np.mean(values[run]))
    return mean


def _clipped(values: FloatArray, largest: FloatArray, floor: float) -> BoolArray:
    """Samples (n,) of which one axis repeats a large value, as only a limit of the sensor explains."""
    size = np.abs(values)
    again = np.zeros(values.shape, bool)
    again[1:] = (values[1:] == values[:-1]) & (size[1:] > floor)
    thrice = np.zeros(values.shape, bool)
    thrice[2:] = again[2:] & again[1:-1]
    again = thrice | (again & (size >= largest))
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
