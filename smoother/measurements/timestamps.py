"""Stamps: where the IMU stream pauses, jitter taken off, stamps that nobody measured."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..array_types import FloatArray, IntArray
from ..filters import moving_mean
from ..linalg import robust_sigma
from ..recording import ImuStream

#: Rates that cameras run at, Hz, and how near to one is near, as a part of it.
CAMERA_RATES_HZ = np.array(
    [5.0, 7.5, 10.0, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0]
)
RATE_TOLERANCE = 0.01

#: Longest interval between IMU samples that is bridged, s (or so many sample periods).
PAUSE_S = 0.1
PAUSE_SAMPLES = 5.0
#: Stamps that scatter by more than this part of a tick are dejittered; what departs from the tick more
#: slowly than this stays, s.
JITTER_SCATTER = 0.08
JITTER_AVERAGE_S = 4.0
JITTER_FEWEST = 50


def pauses(t_s: FloatArray) -> IntArray:
    """Numbers of the samples before which an IMU paused, at increasing stamps (N,) s."""
    dt = np.diff(t_s)
    pause_s = max(PAUSE_S, PAUSE_SAMPLES * float(np.median(dt))) if len(dt) else PAUSE_S
    return np.flatnonzero(dt > pause_s) + 1


def split_at_pauses(imu: ImuStream) -> list[slice]:
    """The segments of the IMU stream, between its pauses, in order."""
    cuts = pauses(imu.t_s)
    edges = [0, *cuts.tolist(), len(imu.t_s)]
    return [slice(a, b) for a, b in pairwise(edges)]


def dejitter(t: FloatArray) -> FloatArray:
    """Sample times of a sensor that ticks evenly, from stamps that a radio or a driver made uneven.

    Bluetooth sensors sample evenly, but their packets are stamped on arrival. Where the stamps scatter
    about an even tick (and no sample is missing, so that the tick can be counted), the tick wins: a
    straight line through the stamps plus their slow departure from it. Good stamps come back unchanged.

    Parameters
    ----------
    t : ndarray, shape (N,), s
        Increasing stamps.

    Returns
    -------
    even_t : ndarray, shape (N,), s
        The stamps themselves where they are good, or where they do not fit an even tick.
    """
    if len(t) < JITTER_FEWEST:
        return t
    dt = np.diff(t)
    tick = float(t[-1] - t[0]) / (len(t) - 1)
    if robust_sigma(dt - tick) < JITTER_SCATTER * tick:
        return t
    count = np.arange(len(t), dtype=float)
    slope, start = np.polyfit(count, t, 1)
    departure = t - (start + slope * count)
    width = max(int(JITTER_AVERAGE_S / slope), 3) | 1
    slow = moving_mean(departure, width)
    jitter = departure - slow
    # a missing sample makes a step of a whole tick: then nothing is better than the stamps
    half = width // 2
    step = np.abs(moving_mean(jitter, max(width // 8, 3))[half:-half])
    if not len(step) or step.max() > 0.4 * slope:
        return t
    even_t = start + slope * count + slow
    return even_t if np.diff(even_t).min() > 0.2 * slope else t


def synthetic_stamps(t_s: FloatArray) -> bool:
    """Whether frame times (F,) were spread evenly by somebody instead of measured.

    They are even to a tenth of a millisecond, at a rate that no camera runs at.

    Parameters
    ----------
    t_s : ndarray, shape (F,), s
        Increasing stamps.

    Returns
    -------
    synthetic : bool
    """
    dt = np.diff(t_s)
    if len(dt) < 10 or np.ptp(dt) > 1e-4:
        return False
    return bool(np.min(np.abs(1.0 / dt.mean() / CAMERA_RATES_HZ - 1.0)) > RATE_TOLERANCE)
