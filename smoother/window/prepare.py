"""A segment made ready to cut: one clock, nodes, initial values from visible data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import FOREARM, UPPER_ARM
from ..calibration import ArmCalibration
from ..linalg import interpolate, unit
from ..measurements.alignment import (
    Alignment,
    VectorPairs,
    acceleration_pairs,
    align,
    direction_pairs,
    lever_of,
    located,
    pairs,
)
from ..measurements.clock import Clock
from ..measurements.inertial import InertialSignal, UpperRunSamples, acceleration_std
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, enough_joints, find_gaps, occluded_at
from ..recording import FOREARM_JOINTS, JOINTS
from ..splines import PiecewiseCubic
from ..units import GRAVITY
from .nodes import CLOSEST_S, GAP_NODE_S, GAP_NODE_UPPER_S, decimate, group_frames, insert_nodes
from .problem import States

#: Frames with shoulder and elbow that a run of samples needs: without them its heading is not known.
FEWEST_FRAMES = 10
_ELBOW, _SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")


#: Beyond so much time from the last visible frame there is no answer, s: a window has no border in a gap, and
#: what it takes grows with its length squared.
REACH_S = 180.0


@dataclass(frozen=True)
class PreparedRun:
    """An IMU between two of its pauses, at the nodes of a prepared segment.

    Attributes
    ----------
    segment : str
        Name of the arm's segment that it is on.
    signal : InertialSignal
        The IMU as a continuous signal, on the forearm IMU's clock.
    first : int
        The node that it begins at; it covers as many as `start` has.
    start : States
        Initial values: orientation to {K}, position and velocity.
    attitude : ndarray, shape (m, 3, 3)
        From the inertial filter and the alignment: the weak prior.
    attitude_covariance : ndarray, shape (m, 3, 3), rad^2
        Of the attitude, in {K}.
    """

    segment: str
    signal: InertialSignal
    first: int
    start: States
    attitude: FloatArray
    attitude_covariance: FloatArray


@dataclass(frozen=True)
class PreparedSegment:
    """A segment, or a time range of it, ready to be cut.

    Attributes
    ----------
    t : ndarray, shape (n,), s
        Nodes on the IMU's clock.
    bodies : tuple of PreparedRun
        The forearm's IMU, which covers all nodes, then others between their pauses.
    frame_t_imu : ndarray, shape (f,), s
        Camera frames on the IMU's clock.
    frame_node : ndarray of int, shape (f,)
        The node that each frame belongs to, -1 where there is none.
    position : ndarray, shape (f, 5, 3), m
        The camera's samples in {K}.
    accepted : ndarray of bool, shape (f, 5)
        Samples that may take part.
    sigma_m : ndarray, shape (f, 5), m
        Their standard deviation an axis.
    gaps : tuple of Gap
        Inside, in order of time.
    acceleration_std : ndarray, shape (n,), m/s^2
        How much the sensor's acceleration varies.
    start_s, end_s : float, s
        What the answer is wanted for; nodes beyond only support it.
    """

    t: FloatArray
    bodies: tuple[PreparedRun, ...]
    frame_t_imu: FloatArray
    frame_node: IntArray
    position: FloatArray
    accepted: BoolArray
    sigma_m: FloatArray
    gaps: tuple[Gap, ...]
    acceleration_std: FloatArray
    start_s: float
    end_s: float

    @property
    def forearm(self) -> PreparedRun:
        """The forearm's IMU."""
        return self.bodies[0]

    def runs(self, segment: str) -> tuple[PreparedRun, ...]:
        """What there is of the IMU on a segment of the arm."""
        return tuple(run for run in self.bodies if run.segment == segment)

    def with_start(self, start: States) -> PreparedSegment:
        """The same with other initial values of the forearm."""
        return replace(self, bodies=(replace(self.forearm, start=start), *self.bodies[1:]))


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
    with_upper = bool(segment.upper) and bool(further_segments(calibration))
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
    start = states_from_camera(t, R, *position)
    forearm = PreparedRun(FOREARM.name, segment.signal, 0, start, R, alignment.covariance[nearest])
    prepared = PreparedSegment(
        t=t,
        bodies=(forearm, *runs),
        frame_t_imu=frame_t_imu[rows],
        frame_node=frame_node[rows],
        position=segment.position[rows],
        accepted=accepted[rows],
        sigma_m=np.tile(sigma_m, (len(rows), 1)),
        gaps=gaps,
        acceleration_std=acceleration_std(segment.signal, segment.attitude, t),
        start_s=core_start_s,
        end_s=core_end_s,
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


def further_segments(calibration: ArmCalibration) -> tuple[str, ...]:
    """Names of the segments beyond the forearm whose IMU is known enough to take part."""
    known = bool(calibration.upper_imu) and UPPER_ARM.shared_joint in calibration.lever_arms
    return (UPPER_ARM.name,) if known else ()


def prepare_upper(
    segment: Segment, frame_t_imu: FloatArray, accepted: BoolArray, calibration: ArmCalibration, t: FloatArray
) -> tuple[PreparedRun, ...]:
    """The runs of an upper-arm IMU at a segment's nodes.

    Orientation comes from its inertial filter and the camera's view of the upper arm (as the forearm's does),
    position from the shoulder, or from the elbow where that alone is visible: neither drifts.

    Parameters
    ----------
    segment : Segment
    frame_t_imu : ndarray, shape (f,), s
        Its frames on the forearm IMU's clock.
    accepted : ndarray of bool, shape (f, 5)
        Samples that may take part.
    calibration : ArmCalibration
        Its `upper_imu` holds elbow and shoulder in {B}.
    t : ndarray, shape (n,), s
        Nodes.

    Returns
    -------
    runs : tuple of PreparedRun
        Those that hold two nodes, and frames with shoulder and elbow.
    """
    prepared = []
    for run in segment.upper:
        rows = np.flatnonzero((t >= run.signal.start_s) & (t <= run.signal.end_s))
        inside = (frame_t_imu >= run.signal.start_s) & (frame_t_imu <= run.signal.end_s)
        used = accepted & inside[:, None]
        if len(rows) >= 2 and (used[:, _ELBOW] & used[:, _SHOULDER]).sum() >= FEWEST_FRAMES:
            prepared.append(
                _prepared_upper(segment, run, frame_t_imu, used, calibration, t[rows], int(rows[0]))
            )
    return tuple(prepared)


def _prepared_upper(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    calibration: ArmCalibration,
    t: FloatArray,
    first: int,
) -> PreparedRun:
    shoulder_B, elbow_B = (calibration.upper_imu[joint].position_m for joint in ("shoulder", "elbow"))
    start_s, end_s = max(run.signal.start_s, segment.start_s), min(run.signal.end_s, segment.end_s)
    pairs = _upper_pairs(segment, run, frame_t_imu, accepted, shoulder_B, elbow_B)
    alignment = align(pairs, start_s, end_s, segment.down)
    shoulder = _shoulder(segment, run, frame_t_imu, accepted, alignment, shoulder_B - elbow_B)
    R = (alignment.at(t) * run.attitude.at(t)).as_matrix()
    p = interpolate(*shoulder, t) - R @ shoulder_B
    v = np.gradient(p, t, axis=0) if len(t) > 2 else np.zeros_like(p)
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    return PreparedRun(UPPER_ARM.name, run.signal, first, States(R, p, v), R, alignment.covariance[nearest])


def _upper_pairs(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    shoulder_B: FloatArray,
    elbow_B: FloatArray,
) -> list[VectorPairs]:
    """What camera and IMU both measure: the upper arm's direction, and the elbow's acceleration."""
    both = accepted[:, _ELBOW] & accepted[:, _SHOULDER]
    position = segment.position[both]
    pairs = [
        direction_pairs(
            frame_t_imu[both],
            position[:, _SHOULDER],
            position[:, _ELBOW],
            run.attitude,
            unit(elbow_B - shoulder_B),
        )
    ]
    rows = accepted[:, _ELBOW]
    accelerations = acceleration_pairs(
        frame_t_imu[rows], segment.position[rows, _ELBOW], run.attitude, run.signal, GRAVITY
    )
    return [*pairs, accelerations.with_lever(elbow_B)]


def _shoulder(
    segment: Segment,
    run: UpperRunSamples,
    frame_t_imu: FloatArray,
    accepted: BoolArray,
    alignment: Alignment,
    elbow_to_shoulder_B: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Times (k,) and the shoulder there (k, 3) m: as seen, or from the elbow and the upper arm."""
    rows = np.flatnonzero(accepted[:, _SHOULDER] | accepted[:, _ELBOW])
    frame_t = frame_t_imu[rows]
    position = segment.position[rows]
    R = (alignment.at(frame_t) * run.attitude.at(frame_t)).as_matrix()
    by_elbow = position[:, _ELBOW] + R @ elbow_to_shoulder_B
    seen = accepted[rows, _SHOULDER]
    return frame_t, np.where(seen[:, None], position[:, _SHOULDER], by_elbow)


def forearm_in_gaps(
    runs: Sequence[PreparedRun],
    t: FloatArray,
    R: FloatArray,
    gaps: tuple[Gap, ...],
    calibration: ArmCalibration,
    visible: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Forearm IMU positions from the camera, and in gaps by way of the upper arm's elbow.

    Parameters
    ----------
    runs : sequence of PreparedRun
    t : ndarray, shape (n,), s
        Nodes.
    R : ndarray, shape (n, 3, 3)
        Initial `R_K_A` at the nodes.
    gaps : tuple of Gap
    calibration : ArmCalibration
        With the elbow's lever arm.
    visible : ndarray, shape (k,), s, and ndarray, shape (k, 3), m
        Positions at visible frames.

    Returns
    -------
    times : ndarray, shape (m,), s
        Increasing.
    position : ndarray, shape (m, 3), m
        The forearm IMU in {K}.
    """
    times, position = [visible[0]], [visible[1]]
    lever, elbow_B = (
        levers["elbow"].position_m for levers in (calibration.lever_arms, calibration.upper_imu)
    )
    for run in runs:
        nodes = np.arange(run.first, run.first + len(run.start.p))
        elbow = run.start.p + run.start.R @ elbow_B
        hidden = occluded_at(t[nodes], gaps)
        after = np.clip(np.searchsorted(visible[0], t[nodes]), 1, len(visible[0]) - 1)
        apart = np.minimum(np.abs(visible[0][after] - t[nodes]), np.abs(visible[0][after - 1] - t[nodes]))
        hidden &= apart > CLOSEST_S
        times.append(t[nodes[hidden]])
        position.append(elbow[hidden] - R[nodes[hidden]] @ lever)
    order = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(times)[order], np.concatenate(position)[order]
