"""Samples of an IMU that no sensor measured: zeros, frozen values, ends of the range, lone spikes."""

from __future__ import annotations

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...linalg import runs
from ...runtime.store import batches
from ...units import STANDARD_GRAVITY

#: Names of two causes.
ZERO, FROZEN = "all zero", "frozen"
#: No gyroscope of a body-worn sensor reads beyond this, rad/s an axis (2000 deg/s), no accelerometer beyond
#: that, m/s^2 an axis.
GYRO_LIMIT, ACC_LIMIT = 35.0, 500.0
#: A value that stands still to the last bit for so long, s and samples, is frozen, if the sensor turns ..
_FROZEN_S, _FROZEN_SAMPLES = 0.25, 8
#: .. so fast, rad/s, or is moved so much, m/s^2.
_TURNS, _MOVES = 0.2, 2.0
#: Of a sensor at rest it is, if the sensor is noisy elsewhere: by so much from sample to sample, rad/s.
_FROZEN_AT_REST_S, _NOISE = 1.0, 1e-3
#: An extreme value in so many samples in a row is the end of the range; the smallest ranges, rad/s and m/s^2.
_PLATEAU, _SMALLEST_GYRO, _SMALLEST_ACC = 3, 4.0, 19.0
#: A sample off both its neighbours, which agree: by so much, and so well, rad/s and m/s^2.
_SPIKE_GYRO, _SPIKE_ACC = (5.0, 1.0), (100.0, 10.0)
#: At lower rates a peak may last one sample, Hz.
_SPIKE_RATE_HZ = 50.0


def unusable_samples(stamp_ns: IntArray, acc: FloatArray, gyro: FloatArray) -> dict[str, BoolArray]:
    """Which samples cannot have been measured, by why; each sample under one cause at most.

    Parameters
    ----------
    stamp_ns : ndarray of int, shape (N,), ns
    acc, gyro : ndarray, shape (N, 3), m/s^2 and rad/s
        In any order of time; values that are not finite are left to others.

    Returns
    -------
    causes : dict of str to ndarray of bool, shape (N,)
        Only causes that occur.
    """
    count = len(stamp_ns)
    zero, beyond, same, spike = (np.zeros(count, bool) for _ in range(4))
    step = np.diff(stamp_ns[: min(count, 100_000)])
    rate = 1e9 / float(np.median(step)) if len(step) and np.median(step) > 0 else np.nan
    highest = np.zeros((2, 3))
    with np.errstate(invalid="ignore", over="ignore"):
        for part in batches(count):
            rows = slice(max(part.start - 1, 0), min(part.stop + 1, count))
            a, g = np.asarray(acc[rows]), np.asarray(gyro[rows])
            mine = slice(part.start - rows.start, part.stop - rows.start)
            zero[part] = np.all((a[mine] == 0) & (g[mine] == 0), axis=1)
            beyond[part] = np.any((abs(a[mine]) > ACC_LIMIT) | (abs(g[mine]) > GYRO_LIMIT), axis=1)
            for sensor, values in enumerate((a, g)):
                inside = np.where(abs(values) <= (ACC_LIMIT, GYRO_LIMIT)[sensor], abs(values), 0.0)
                highest[sensor] = np.maximum(highest[sensor], inside.max(axis=0, initial=0.0))
            if len(a) > 1:
                equal = (a[1:] == a[:-1]).all(axis=1) & (g[1:] == g[:-1]).all(axis=1)
                same[rows.start + 1 : rows.stop] = equal
            if len(a) > 2 and rate >= _SPIKE_RATE_HZ:
                lone = _spikes(a, *_SPIKE_ACC) | _spikes(g, *_SPIKE_GYRO)
                spike[rows.start + 1 : rows.stop - 1] |= lone
    causes = {
        ZERO: zero,
        "beyond any sensor's range": beyond,
        FROZEN: _frozen(same, acc, gyro, rate) if same.any() else same,
        "at the end of the range": _plateaus(acc, gyro, highest),
        "lone spikes": spike,
    }
    taken = np.zeros(count, bool)
    for mask in causes.values():
        mask &= ~taken
        taken |= mask
    return {cause: mask for cause, mask in causes.items() if mask.any()}


def _spikes(values: FloatArray, off: float, agree: float) -> BoolArray:
    """Inner samples (n - 2,) off both neighbours, which agree."""
    middle = 0.5 * (values[2:] + values[:-2])
    apart = abs(values[2:] - values[:-2]).max(axis=1)
    lone: BoolArray = (abs(values[1:-1] - middle).max(axis=1) > off) & (apart < agree)
    return lone


def _frozen(same: BoolArray, acc: FloatArray, gyro: FloatArray, rate: float) -> BoolArray:
    """Runs of equal samples in motion; at rest too where the sensor is noisy otherwise."""
    frozen = np.zeros(len(same), bool)
    if not rate > 0:
        return frozen
    is_noisy: bool | None = None
    for rows in runs(same):
        length = rows.stop - rows.start
        if length < max(_FROZEN_SAMPLES, _FROZEN_S * rate):
            continue
        force = abs(float(np.linalg.norm(acc[rows.start])) - STANDARD_GRAVITY)
        moves = float(abs(gyro[rows.start]).max()) > _TURNS or force > _MOVES
        if not moves and length >= _FROZEN_AT_REST_S * rate and is_noisy is None:
            is_noisy = _is_noisy(same, gyro)
        if moves or (is_noisy and length >= _FROZEN_AT_REST_S * rate):
            frozen[rows] = True
    return frozen


def _is_noisy(same: BoolArray, gyro: FloatArray) -> bool:
    """Whether a sensor's values vary from sample to sample also where it is quiet."""
    for part in batches(len(same)):
        g = np.asarray(gyro[part])
        varied = ~same[part][2:] & ~same[part][1:-1]
        change = abs(g[2:] - 2 * g[1:-1] + g[:-2]).max(axis=1, initial=0.0)[varied]
        if len(change) > 100:
            return bool(np.percentile(change[np.isfinite(change)], 10) > _NOISE)
    return False


def _plateaus(acc: FloatArray, gyro: FloatArray, highest: FloatArray) -> BoolArray:
    """Samples in runs of an axis's largest value, where that may be the end of a range."""
    clipped = np.zeros(len(acc), bool)
    for sensor, (values, least) in enumerate(((acc, _SMALLEST_ACC), (gyro, _SMALLEST_GYRO))):
        for axis in np.flatnonzero(highest[sensor] > least).tolist():
            at_end = np.zeros(len(values), bool)
            for part in batches(len(values)):
                at_end[part] = abs(values[part, axis]) == highest[sensor, axis]
            for rows in runs(at_end):
                if rows.stop - rows.start >= _PLATEAU:
                    clipped[rows] = True
    return clipped
