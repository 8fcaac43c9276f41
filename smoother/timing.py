"""Times: where the IMU stream pauses, and which nodes a stretch of it is solved at."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from .recording import BoolArray, FloatArray, ImuStream

#: Longest interval between IMU samples that is bridged, s (or so many sample periods).
PAUSE_S = 0.1
PAUSE_SAMPLES = 5.0
#: Node spacing where the camera gives nothing, s.
GAP_NODE_S = 0.1
#: Nodes keep at least so far apart, s; closer frames are left to their neighbour.
CLOSEST_S = 0.008


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


def fill(t: FloatArray, start_s: float, end_s: float) -> FloatArray:
    """Node times: the given ones, start and end, and evenly spaced ones where they are far apart."""
    inner = t[(t > start_s + CLOSEST_S) & (t < end_s - CLOSEST_S)]
    knots = np.concatenate(([start_s], inner, [end_s]))
    count = np.maximum(np.ceil(np.diff(knots) / GAP_NODE_S - 1e-9).astype(int), 1)
    inside = np.arange(count.sum()) - np.repeat(np.concatenate(([0], np.cumsum(count)[:-1])), count)
    nodes = np.repeat(knots[:-1], count) + np.repeat(np.diff(knots) / count, count) * inside
    return np.append(nodes, knots[-1])
