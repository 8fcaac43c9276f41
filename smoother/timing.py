"""Times: where the IMU stream pauses, and which nodes a stretch of it is solved at."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import uniform_filter1d

from .recording import BoolArray, FloatArray, ImuStream, IntArray

#: Longest interval between IMU samples that is bridged, s (or so many sample periods).
PAUSE_S = 0.1
PAUSE_SAMPLES = 5.0
#: Node spacing where the camera gives nothing, s.
GAP_NODE_S = 0.2
#: Nodes keep at least so far apart, s; closer frames are left to their neighbour.
CLOSEST_S = 0.008
#: Frames up to so far from a node are carried to it, s, except so near to a gap, s: there the camera's last
#: samples decide.
CARRIED_S = 0.07
FINE_S = 0.15
#: Stamps that scatter by more than this part of a sample are steadied, over a span of time, s.
STEADY_SCATTER = 0.08
STEADY_SPAN_S = 4.0
STEADY_FEWEST = 50


def split_at_pauses(imu: ImuStream) -> list[slice]:
    """Stretches of the IMU stream without a pause, in order."""
    dt = np.diff(imu.t_s)
    pause_s = max(PAUSE_S, PAUSE_SAMPLES * float(np.median(dt))) if len(dt) else PAUSE_S
    cuts = np.flatnonzero(dt > pause_s) + 1
    edges = [0, *cuts.tolist(), len(imu.t_s)]
    return [slice(a, b) for a, b in pairwise(edges)]


def thin(t: FloatArray) -> BoolArray:
    """Which of the increasing times to keep so that neighbours are `CLOSEST_S` apart."""
    keep = np.ones(len(t), dtype=bool)
    if len(t) < 2 or np.diff(t).min() >= CLOSEST_S:
        return keep
    last = t[0]
    for i in range(1, len(t)):  # rare: only when stamps crowd
        keep[i] = t[i] - last >= CLOSEST_S
        last = t[i] if keep[i] else last
    return keep


def gather(t: FloatArray, visible: BoolArray) -> IntArray:
    """Which frame's node each frame is told to, (n,): itself, or the middle one of an odd group.

    The IMU ties frames a few hundredths of a second apart much better than the camera sees them, so
    that far from gaps a group of them can share one node (`carry`).

    Parameters
    ----------
    t : (n,) increasing times of the frames that saw something of the forearm, s.
    visible : (n,) frames that saw enough of it.
    """
    owner = np.arange(len(t))
    if len(t) < 3:
        return owner
    dt = np.diff(t)
    step = float(np.median(dt))
    half = int(CARRIED_S / step)
    if half < 1:
        return owner
    breaks = np.flatnonzero((dt > 2.5 * step) | (visible[1:] != visible[:-1])) + 1
    size = 2 * half + 1
    for a, b in pairwise([0, *breaks.tolist(), len(t)]):
        first, last = a + np.searchsorted(t[a:b], [t[a] + FINE_S, t[b - 1] - FINE_S])
        count = (last - first) // size
        if count > 0 and visible[a]:
            rows = first + np.arange(count * size)
            owner[rows] = first + half + size * np.repeat(np.arange(count), size)
    return np.where(np.abs(t - t[owner]) <= 1.5 * CARRIED_S, owner, np.arange(len(t)))


def fill(t: FloatArray, start_s: float, end_s: float) -> FloatArray:
    """Node times: the given ones, start and end, and evenly spaced ones where they are far apart."""
    inner = t[(t > start_s + CLOSEST_S) & (t < end_s - CLOSEST_S)]
    knots = np.concatenate(([start_s], inner, [end_s]))
    count = np.maximum(np.ceil(np.diff(knots) / GAP_NODE_S - 1e-9).astype(int), 1)
    inside = np.arange(count.sum()) - np.repeat(np.concatenate(([0], np.cumsum(count)[:-1])), count)
    nodes = np.repeat(knots[:-1], count) + np.repeat(np.diff(knots) / count, count) * inside
    return np.append(nodes, knots[-1])


def steady(t: FloatArray) -> FloatArray:
    """Sample times of a sensor that ticks evenly, from stamps that a radio or a driver made uneven.

    Bluetooth sensors sample evenly, but their packets are stamped on arrival. Where the stamps scatter
    about an even tick (and no sample is missing, so that the tick can be counted), the tick wins: a
    straight line through the stamps plus their slow departure from it. Good stamps come back unchanged.

    Parameters
    ----------
    t : (N,) increasing stamps, s.
    """
    if len(t) < STEADY_FEWEST:
        return t
    dt = np.diff(t)
    tick = float(t[-1] - t[0]) / (len(t) - 1)
    scatter = 1.4826 * float(np.median(np.abs(dt - tick)))
    if scatter < STEADY_SCATTER * tick:
        return t
    count = np.arange(len(t), dtype=float)
    slope, start = np.polyfit(count, t, 1)
    departure = t - (start + slope * count)
    width = max(int(STEADY_SPAN_S / slope), 3) | 1
    slow = uniform_filter1d(departure, width, mode="nearest")
    left = departure - slow
    # a missing sample makes a step of a whole tick: then the stamps are all there is
    half = width // 2
    step = np.abs(uniform_filter1d(left, max(width // 8, 3), mode="nearest")[half:-half])
    if not len(step) or step.max() > 0.4 * slope:
        return t
    steadied = start + slope * count + slow
    return steadied if np.diff(steadied).min() > 0.2 * slope else t
