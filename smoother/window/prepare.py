"""A piece of the recording made ready to cut: clocks joined, nodes, start values from visible data."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ..calibration import ArmCalibration
from ..measurements.alignment import (
    Alignment,
    align,
    lever_of,
    pairs,
)
from ..measurements.attitude import acceleration_std
from ..measurements.clock import Clock
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, enough_joints, find_gaps
from ..recording import FOREARM_JOINTS, JOINTS, BoolArray, FloatArray
from .cut import PreparedSegment
from .nodes import decimate, group_frames, insert_nodes
from .problem import States

#: Beyond so much time from the last visible frame there is no answer, s.
REACH_S = 10.0


def prepare(
    segment: Segment,
    calibration: ArmCalibration,
    clock: Clock,
    sigma_m: FloatArray,
    margin_s: float,
    alignment: Alignment | None = None,
) -> tuple[PreparedSegment, Alignment] | None:
    """Nodes and start values of a piece.

    Parameters
    ----------
    clock : takes the camera's times to the IMU's.
    sigma_m : (5,) noise of the camera's joints, m an axis.
    margin_s : nodes reach so far beyond the part that is answered for.
    alignment : of the inertial frame to the camera where it is known; found from the samples where None.

    Returns
    -------
    The stretch and the alignment of its inertial frame to the camera; None where the camera saw
    nothing of the forearm near enough.
    """
    frame_t = segment.frame_t + clock.at(segment.frame_t)
    inside = (frame_t >= segment.start_s) & (frame_t <= segment.end_s)
    accepted = segment.accepted & inside[:, None]
    measured = enough_joints(accepted, 1)
    if measured.sum() < 2:
        return None
    seen = frame_t[measured]
    start_s, end_s = max(segment.start_s, seen[0] - REACH_S), min(segment.end_s, seen[-1] + REACH_S)
    core_start_s, core_end_s = max(start_s, segment.core_start_s), min(end_s, segment.core_end_s)
    if core_end_s - core_start_s < 0.1:
        return None
    visible = enough_joints(accepted, segment.needed)
    rows = np.flatnonzero(inside)
    gaps = find_gaps(frame_t[rows], visible[rows], start_s, end_s)
    kept = np.flatnonzero(measured)[decimate(seen)]
    owner = kept[group_frames(frame_t[kept], visible[kept])]
    t = insert_nodes(frame_t[np.unique(owner)], start_s, end_s)
    first, last = reach(core_start_s, core_end_s, gaps, margin_s)
    t = t[(t >= first) & (t <= last)]
    if alignment is None:
        alignment = align(pairs(segment, frame_t, accepted, calibration), start_s, end_s, segment.down)
    R = (alignment.at(t) * segment.attitude.at(t)).as_matrix()
    frame_node = np.full(len(frame_t), -1)
    node = np.clip(np.searchsorted(t, frame_t[owner] - 1e-9), 0, len(t) - 1)
    frame_node[kept] = np.where(np.abs(t[node] - frame_t[owner]) < 1e-9, node, -1)
    imu_t, imu_position = _imu_positions(segment, frame_t, accepted, alignment, calibration)
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    prepared = PreparedSegment(
        signal=segment.signal,
        t=t,
        start=states_from_camera(t, R, imu_t, imu_position),
        frame_t=frame_t[rows],
        frame_node=frame_node[rows],
        position=segment.position[rows],
        accepted=accepted[rows],
        sigma_m=np.tile(sigma_m, (len(rows), 1)),
        gaps=gaps,
        acceleration_std=acceleration_std(segment.signal, segment.attitude, t),
        attitude=R,
        attitude_covariance=alignment.covariance[nearest],
        start_s=core_start_s,
        end_s=core_end_s,
    )
    return prepared, alignment


def reach(start_s: float, end_s: float, gaps: tuple[Gap, ...], margin_s: float) -> tuple[float, float]:
    """What has to be solved for a part's sake: its margins, and beyond a gap that an end of it lies in."""
    first, last = start_s - margin_s, end_s + margin_s
    for gap in gaps:
        if gap.start_s <= start_s <= gap.end_s:
            first = min(first, gap.start_s - margin_s)
        if gap.start_s <= end_s <= gap.end_s:
            last = max(last, gap.end_s + margin_s)
    return first, last


def _imu_positions(
    segment: Segment,
    frame_t: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    calibration: ArmCalibration,
) -> tuple[FloatArray, FloatArray]:
    """The IMU's position at frames where a joint with a known lever arm is seen: mean over joints."""
    R = (alignment.at(frame_t) * segment.attitude.at(frame_t)).as_matrix()
    total, count = np.zeros((len(frame_t), 3)), np.zeros(len(frame_t))
    for joint in FOREARM_JOINTS:
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        if lever is None:
            continue
        rows = accepted[:, column]
        total[rows] += segment.position[rows, column] - R[rows] @ lever
        count[rows] += 1.0
    seen = count > 0
    return frame_t[seen], total[seen] / count[seen, None]


def states_from_camera(t: FloatArray, R: FloatArray, frame_t: FloatArray, position: FloatArray) -> States:
    """Position and velocity at the nodes from the IMU's positions at visible frames.

    Parameters
    ----------
    t, R : (n,) node times and (n, 3, 3) orientations.
    frame_t, position : (k,) and (k, 3) m in {K}, increasing times.
    """
    p, v = _local_lines(frame_t, position)
    if len(frame_t) == 1:
        return States(R, np.tile(p[0], (len(t), 1)), np.zeros((len(t), 3)))
    curve = CubicHermiteSpline(frame_t, p, v)
    inside = np.clip(t, frame_t[0], frame_t[-1])
    out = t != inside
    velocity = curve(inside, 1)
    velocity[out] = 0.0
    return States(R, curve(inside), velocity)


def _local_lines(t: FloatArray, x: FloatArray, half_s: float = 0.12) -> tuple[FloatArray, FloatArray]:
    """Value and slope at each time of the least-squares line over +- half_s (prefix sums)."""
    lo, hi = np.searchsorted(t, [t - half_s, t + half_s + 1e-9])
    ones = np.ones_like(t)

    def window_sum(y: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, *y.shape[1:])), np.cumsum(y, axis=0)])
        return total[hi] - total[lo]

    origin = t[len(t) // 2]
    u, mean = t - origin, x.mean(axis=0)
    n, su, suu = window_sum(ones), window_sum(u), window_sum(u * u)
    sx, sux = window_sum(x - mean), window_sum(u[:, None] * (x - mean))
    determinant = n * suu - su**2
    good = (n >= 3) & (determinant > 1e-9 * n)
    safe = np.where(good, determinant, 1.0)[:, None]
    slope = np.where(good[:, None], (n[:, None] * sux - su[:, None] * sx) / safe, 0.0)
    value = np.where(good[:, None], (sx + slope * (n * u - su)[:, None]) / n[:, None] + mean, x)
    return value, np.clip(slope, -6.0, 6.0)
