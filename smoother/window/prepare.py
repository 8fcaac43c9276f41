"""A segment made ready to cut: one clock, nodes, initial values from visible data."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..calibration import ArmCalibration
from ..measurements.alignment import Alignment, align, lever_of, located, pairs
from ..measurements.clock import Clock
from ..measurements.inertial import acceleration_std
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, enough_joints, find_gaps
from ..recording import FOREARM_JOINTS, JOINTS
from ..splines import PiecewiseCubic
from .cut import PreparedSegment
from .nodes import GAP_NODE_S, GAP_NODE_UPPER_S, decimate, group_frames, insert_nodes
from .problem import States
from .upper_runs import forearm_in_gaps, prepare_upper, takes_part

#: Beyond so much time from the last visible frame there is no answer, s: a window has no border in a gap, and
#: what it takes grows with its length squared.
REACH_S = 180.0


def prepare(
    segment: Segment,
    calibration: ArmCalibration,
    clock: Clock,
    sigma_m: FloatArray,
    margin_s: float,
    alignment: Alignment | None = None,
) -> tuple[PreparedSegment, Alignment] | None:
    """Nodes and initial values of a segment.

    Parameters
    ----------
    segment : Segment
    calibration : ArmCalibration
        Its lever arms tie the joints to the IMU.
    clock : Clock
        Takes the camera's times to the IMU's.
    sigma_m : ndarray, shape (5,), m
        Noise of the camera's joints, an axis.
    margin_s : float, s
        Nodes reach so far beyond what the answer is wanted for.
    alignment : Alignment, optional
        Of the inertial frame to the camera; estimated from the samples where None.

    Returns
    -------
    prepared : PreparedSegment
    alignment : Alignment
        The one given, or the one that was estimated. Instead of both None where the camera saw nothing of
        the forearm near enough.
    """
    frame_t_imu = segment.frame_t_imu(clock)
    inside = (frame_t_imu >= segment.start_s) & (frame_t_imu <= segment.end_s)
    accepted = segment.accepted & inside[:, None] & located(calibration)
    measured = enough_joints(accepted, 1)
    if measured.sum() < 2:
        return None
    first_s, last_s = frame_t_imu[measured][[0, -1]].tolist()
    with_upper = takes_part(segment, calibration)
    start_s, end_s = max(segment.start_s, first_s - REACH_S), min(segment.end_s, last_s + REACH_S)
    core_start_s, core_end_s = max(start_s, segment.core_start_s), min(end_s, segment.core_end_s)
    if core_end_s - core_start_s < 0.1:
        return None
    visible = enough_joints(accepted, segment.needed)
    rows = np.flatnonzero(inside)
    gaps = find_gaps(frame_t_imu[rows], visible[rows], start_s, end_s)
    t, frame_node = _nodes(
        frame_t_imu,
        measured,
        visible,
        (start_s, end_s),
        reach(core_start_s, core_end_s, gaps, margin_s),
        GAP_NODE_UPPER_S if with_upper else GAP_NODE_S,
    )
    if alignment is None:
        vectors = pairs(segment, frame_t_imu, accepted, calibration)
        if not vectors:
            return None
        alignment = align(vectors, start_s, end_s, segment.down)
    R = (alignment.at(t) * segment.attitude.at(t)).as_matrix()
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    position = _imu_positions(segment, frame_t_imu, accepted, alignment, calibration)
    runs = prepare_upper(segment, frame_t_imu, accepted, calibration, t) if with_upper else ()
    if runs:
        position = forearm_in_gaps(runs, t, R, gaps, calibration, position)
    prepared = PreparedSegment(
        signal=segment.signal,
        t=t,
        start=states_from_camera(t, R, *position),
        frame_t_imu=frame_t_imu[rows],
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
        upper=runs,
    )
    return prepared, alignment


def _nodes(
    frame_t_imu: FloatArray,
    measured: BoolArray,
    visible: BoolArray,
    range_s: tuple[float, float],
    reach_s: tuple[float, float],
    spacing_s: float,
) -> tuple[FloatArray, IntArray]:
    """Nodes (n,) of the time range within reach, and the node of each frame (f,), -1 where there is none."""
    rows = np.flatnonzero(measured)
    rows = rows[decimate(frame_t_imu[rows])]
    owner = rows[group_frames(frame_t_imu[rows], visible[rows])]
    t = insert_nodes(frame_t_imu[np.unique(owner)], *range_s, spacing_s)
    t = t[(t >= reach_s[0]) & (t <= reach_s[1])]
    node = np.clip(np.searchsorted(t, frame_t_imu[owner] - 1e-9), 0, len(t) - 1)
    frame_node = np.full(len(frame_t_imu), -1)
    frame_node[rows] = np.where(np.abs(t[node] - frame_t_imu[owner]) < 1e-9, node, -1)
    return t, frame_node


def reach(start_s: float, end_s: float, gaps: tuple[Gap, ...], margin_s: float) -> tuple[float, float]:
    """What has to be solved for an answer: its margins, and the far side of a gap that an end of it lies in.

    Parameters
    ----------
    start_s, end_s : float, s
        What the answer is wanted for.
    gaps : tuple of Gap
    margin_s : float, s
        Beyond the answer, or beyond the gap.

    Returns
    -------
    first_s, last_s : float, s
    """
    first, last = start_s - margin_s, end_s + margin_s
    for gap in gaps:
        if gap.start_s <= start_s <= gap.end_s:
            first = min(first, gap.start_s - margin_s)
        if gap.start_s <= end_s <= gap.end_s:
            last = max(last, gap.end_s + margin_s)
    return first, last


def _imu_positions(
    segment: Segment,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    calibration: ArmCalibration,
) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and IMU positions (k, 3) at frames with a joint of known lever arm (mean over joints)."""
    R = (alignment.at(frame_t_imu) * segment.attitude.at(frame_t_imu)).as_matrix()
    total, count = np.zeros((len(frame_t_imu), 3)), np.zeros(len(frame_t_imu))
    for joint in FOREARM_JOINTS:
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        if lever is None:
            continue
        rows = accepted[:, column]
        total[rows] += segment.position[rows, column] - R[rows] @ lever
        count[rows] += 1.0
    known = count > 0
    return frame_t_imu[known], total[known] / count[known, None]


def states_from_camera(t: FloatArray, R: FloatArray, frame_t_imu: FloatArray, position: FloatArray) -> States:
    """Position and velocity at the nodes from the IMU's positions at visible frames.

    Local lines through the positions give value and slope at each frame, cubic Hermite polynomials what
    lies between; beyond the first and the last frame the IMU rests.

    Parameters
    ----------
    t : ndarray, shape (n,), s
        Nodes.
    R : ndarray, shape (n, 3, 3)
        Orientations at the nodes.
    frame_t_imu : ndarray, shape (k,), s
        Increasing times on the IMU's clock.
    position : ndarray, shape (k, 3), m
        The IMU's in {K}.

    Returns
    -------
    states : States
        At the nodes.
    """
    p, v = _local_lines(frame_t_imu, position)
    if len(frame_t_imu) == 1:
        return States(R, np.tile(p[0], (len(t), 1)), np.zeros((len(t), 3)))
    curve = PiecewiseCubic(frame_t_imu, p, v)
    inside = np.clip(t, frame_t_imu[0], frame_t_imu[-1])
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
