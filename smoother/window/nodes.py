"""The nodes: the times that a segment is solved at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..measurements.inertial import InertialSignal, integrate_between
from ..measurements.visibility import Gap
from .problem import States

#: Node spacing where the camera gives nothing, s.
GAP_NODE_S = 0.26
#: The same in a gap with a second IMU: two segments meet in their joint at nodes alone, s.
GAP_NODE_CHAIN_S = 0.13
#: Nodes keep at least this far apart, s; of closer frames only one is used.
CLOSEST_S = 0.008
#: Frames up to this far from a node belong to it, s (`propagate`), except so near to a gap, s: there the
#: camera's last samples decide.
GROUPED_S = 0.105
FINE_S = 0.15
#: Nor where impacts that the IMU did not follow may move the arm by so much within that time, one sigma, m.
IMPACT_M = 0.001


def decimate(t: FloatArray) -> BoolArray:
    """Which of the increasing times (n,) to keep so that neighbours are `CLOSEST_S` apart, (n,)."""
    keep = np.ones(len(t), dtype=bool)
    if len(t) < 2 or np.diff(t).min() >= CLOSEST_S:
        return keep
    last = t[0]
    for i in range(1, len(t)):  # rare: only when stamps crowd
        keep[i] = t[i] - last >= CLOSEST_S
        last = t[i] if keep[i] else last
    return keep


def near_impacts(signal: InertialSignal, t: FloatArray) -> BoolArray:
    """Which frames (n,) at times (n,), s, are so near an impact that the IMU does not tie them to others."""
    first, last = (np.clip(t + apart, signal.start_s, signal.end_s) for apart in (-GROUPED_S, GROUPED_S))
    return np.asarray(GROUPED_S * signal.velocity_error_between(first, last) > IMPACT_M)


def group_frames(t: FloatArray, visible: BoolArray, near_impact: BoolArray) -> IntArray:
    """Which frame's node each frame belongs to: its own, or that of the middle one of an odd group."""
    owner = np.arange(len(t))
    if len(t) < 3:
        return owner
    dt = np.diff(t)
    step = float(np.median(dt))
    half = int(GROUPED_S / step)
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
    return _tied(t, owner, np.arange(len(t)), near_impact)


def _tied(t: FloatArray, owner: IntArray, alone: IntArray, near_impact: BoolArray) -> IntArray:
    """The owners (n,), but for frames that are far from theirs and groups with an impact: those `alone`."""
    tied = (np.abs(t - t[owner]) <= 1.5 * GROUPED_S) & ~np.isin(owner, owner[near_impact])
    return np.where(tied, owner, alone)


def insert_nodes(
    t: FloatArray,  # (k,) s
    start_s: float,
    end_s: float,
    spacing_s: float = GAP_NODE_S,
    gaps: Sequence[Gap] = (),
) -> FloatArray:  # (n,) s
    """Node times: the given ones, start and end, and evenly spaced ones where they are far apart."""
    inner = t[(t > start_s + CLOSEST_S) & (t < end_s - CLOSEST_S)]
    knots = np.concatenate(([start_s], inner, [end_s]))
    middle, spacing = 0.5 * (knots[1:] + knots[:-1]), np.full(len(knots) - 1, spacing_s)
    for gap in gaps:
        spacing[(middle > gap.start_s) & (middle < gap.end_s)] = GAP_NODE_CHAIN_S
    count = np.maximum(np.ceil(np.diff(knots) / spacing - 1e-9).astype(int), 1)
    inside = np.arange(count.sum()) - np.repeat(np.concatenate(([0], np.cumsum(count)[:-1])), count)
    nodes = np.repeat(knots[:-1], count) + np.repeat(np.diff(knots) / count, count) * inside
    return np.append(nodes, knots[-1])


def group_frames_of_cameras(
    t: FloatArray, visible: BoolArray, near_impact: BoolArray, cameras: int
) -> IntArray:  # int (n,)
    """As `decimate` and `group_frames` for the joined frames of several cameras."""
    owner = np.arange(len(t))
    kept = decimate(t)
    alone = np.flatnonzero(kept)[
        np.cumsum(kept) - 1
    ]  # frames that are too near the one before share its node
    owner = alone.copy()
    if len(t) < 3:
        return owner
    step = float(np.median(t[cameras:] - t[:-cameras] if len(t) > cameras else np.diff(t)))
    breaks = np.flatnonzero((np.diff(t) > 2.5 * step) | (visible[1:] != visible[:-1])) + 1
    length = 2.0 * GROUPED_S + step
    for a, b in pairwise([0, *breaks.tolist(), len(t)]):
        first, last = a + np.searchsorted(t[a:b], [t[a] + FINE_S, t[b - 1] - FINE_S])
        count = int((t[last - 1] - t[first]) / length) if last - first > 2 else 0
        if count < 1 or not visible[a]:
            continue
        edges = t[first] + length * np.arange(count + 1)
        rows = np.arange(first, last)
        group = np.searchsorted(edges, t[rows], side="right") - 1
        inside = group < count
        rows, group = rows[inside], group[inside]
        middle = 0.5 * (edges[1:] + edges[:-1])
        for number in np.unique(group):
            own = rows[group == number]
            owner[own] = own[int(np.argmin(np.abs(t[own] - middle[number])))]
    return _tied(t, owner, alone, near_impact)


@dataclass(frozen=True)
class RelativeMotion:
    """The IMU's motion from each frame's node to the frame, in {K}."""

    R_node: FloatArray  # (k, 3, 3): `R_K_A` at the node
    R_frame: FloatArray  # (k, 3, 3): `R_K_A` at the frame
    position_change: FloatArray  # (k, 3) m: of the IMU
    velocity_change: FloatArray  # (k, 3) m/s: of the IMU
    rate: FloatArray  # (k, 3) rad/s: angular rate at the frame in {A}

    def shift(self, lever_A: FloatArray) -> FloatArray:
        """Change of position (k, 3), m, of a point at the lever arm (3,) m in {A}."""
        return self.position_change + (self.R_frame - self.R_node) @ lever_A

    def velocity(self, lever_A: FloatArray) -> FloatArray:
        """Velocity (k, 3), m/s, of that point at the frame less the IMU's at the node."""
        around = np.cross(self.rate, lever_A)
        return self.velocity_change + np.einsum("kij,kj->ki", self.R_frame, around)


#: The angular rate at a frame is the mean over this long, s.
RATE_S = 0.02


def propagate(
    signal: InertialSignal,
    t: FloatArray,  # (n,) s
    states: States,
    frame_t_imu: FloatArray,  # (k,) s
    node: IntArray,  # int (k,)
    gravity: FloatArray,  # (3,) m/s^2
    bias: FloatArray,  # (6,) m/s^2 and rad/s
) -> RelativeMotion:
    """Follow the IMU from nodes to frames, forwards or backwards (Forster et al., TRO 2017, eq 32)."""
    R = states.R[node]
    away = np.flatnonzero(np.abs(frame_t_imu - t[node]) > 1e-6)
    frame, at = frame_t_imu[away], t[node][away]
    back = (frame < at)[:, None]
    # the intervals overlap: each piece of them is integrated once, and the pieces are joined
    start_s, end_s = np.minimum(frame, at), np.maximum(frame, at)
    ends = np.unique(np.concatenate([start_s, end_s]))
    first, stop = np.searchsorted(ends, start_s), np.searchsorted(ends, end_s)
    begun = np.bincount(first, minlength=len(ends)) - np.bincount(stop, minlength=len(ends))
    used = np.flatnonzero(np.cumsum(begun) > 0)
    pieces = integrate_between(signal, ends[used], ends[used + 1], bias)
    piece = np.searchsorted(used, first)
    delta = pieces.rows(piece)
    for k in range(1, int((stop - first).max(initial=0))):
        longer = np.flatnonzero(stop - first > k)
        delta.lengthen(longer, pieces.rows(piece[longer] + k))
    dt = delta.dt[:, None]
    R_frame, velocity_change, position_change = R.copy(), np.zeros((len(R), 3)), np.zeros((len(R), 3))
    # backwards the increments are in the frame's axes, and begin with the frame's velocity
    R_frame[away] = R[away] @ np.where(back[:, :, None], np.swapaxes(delta.delta_R, 1, 2), delta.delta_R)
    R_start = np.where(back[:, :, None], R_frame[away], R[away])
    dv = np.einsum("kij,kj->ki", R_start, delta.delta_v) + gravity * dt
    v_start = states.v[node[away]] - np.where(back, dv, 0.0)
    dp = v_start * dt + 0.5 * gravity * dt**2 + np.einsum("kij,kj->ki", R_start, delta.delta_p)
    velocity_change[away], position_change[away] = np.where(back, -dv, dv), np.where(back, -dp, dp)
    inside = np.clip(frame_t_imu, signal.start_s + 0.5 * RATE_S, signal.end_s - 0.5 * RATE_S)
    rate = signal.mean(inside - 0.5 * RATE_S, inside + 0.5 * RATE_S)[:, 3:] - bias[3:]
    return RelativeMotion(R, R_frame, position_change, velocity_change, rate)
