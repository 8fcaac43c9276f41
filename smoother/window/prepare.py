"""A segment made ready to cut: one clock, nodes, initial values from visible data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, CameraNumbers, FloatArray, IntArray
from ..body import FOREARM, FURTHER, SEGMENTS
from ..calibration import ArmCalibration
from ..linalg import interpolate, unit
from ..measurements.alignment import (
    Alignment,
    acceleration_pairs,
    align,
    direction_pairs,
    imu_positions,
    located,
    pairs,
)
from ..measurements.clock import Clock
from ..measurements.inertial import InertialSignal, acceleration_std, is_still
from ..measurements.segment import Segment
from ..measurements.visibility import Gap, enough_joints, find_gaps, occluded_at, seen_by_any
from ..recording import JOINTS
from ..splines import PiecewiseCubic
from .nodes import (
    CLOSEST_S,
    decimate,
    group_frames,
    group_frames_of_cameras,
    insert_nodes,
    near_impacts,
)
from .problem import States

#: Frames with both joints of its segment that a run of samples needs: without them its heading is not known.
FEWEST_FRAMES = 10
#: Start values' positions and velocities are those of lines over this time on both sides, s.
LINE_HALF_S = 0.12
#: Beyond this time from the last visible frame there is no answer, s: a window has no border in a gap, and
#: what it takes grows with its length squared.
REACH_S = 180.0


@dataclass(frozen=True)
class PreparedRun:
    """An IMU between two of its pauses, at the nodes of a prepared segment."""

    segment: str  # Name of the arm's segment that it is on
    signal: InertialSignal  # The IMU as a continuous signal, on the forearm IMU's clock
    first: int  # The node that it begins at; it covers as many as `start` has
    start: States  # Initial values: orientation to {K}, position and velocity
    attitude: FloatArray  # (m, 3, 3): from the inertial filter and the alignment: the weak prior
    attitude_covariance: FloatArray  # (m, 3, 3) rad^2: of the attitude, in {K}


@dataclass(frozen=True)
class PreparedSegment:
    """A segment, or a time range of it, ready to be cut."""

    t: FloatArray  # (n,) s: nodes on the IMU's clock
    # The forearm's IMU, which covers all nodes, then others between their pauses
    bodies: tuple[PreparedRun, ...]
    frame_t_imu: FloatArray  # (f,) s: camera frames on the IMU's clock
    frame_node: IntArray  # int (f,): the node that each frame belongs to, -1 where there is none
    position: FloatArray  # (f, 5, 3) m: the camera's samples in {K}
    accepted: BoolArray  # bool (f, 5): samples that may be used
    sigma_m: FloatArray  # (f, 5) m: their standard deviation per axis
    gaps: tuple[Gap, ...]  # Inside, in order of time
    acceleration_std: FloatArray  # (n,) m/s^2: how much the sensor's acceleration varies
    still: BoolArray  # bool (n,): where the forearm's sensor lies still
    start_s: float  # What the answer is wanted for; nodes beyond only support it
    end_s: float
    camera: CameraNumbers | None = None  # int (f,): which camera each frame is of; None where all are of one
    ray_origin_m: FloatArray | None = None  # (c, 3) m: Where the rays of each camera without depth begin
    is_started: bool = False  # The start values are an earlier solution's

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
    sigma_m: FloatArray,  # (5,) or (c, 5) m
    margin_s: float,
    alignment: Alignment | None = None,
) -> tuple[PreparedSegment, Alignment] | None:
    """Nodes and initial values of a segment."""
    frame_t_imu = segment.frame_t_imu(clock)
    inside = (frame_t_imu >= segment.start_s) & (frame_t_imu <= segment.end_s)
    accepted = segment.accepted & inside[:, None] & located(calibration)
    measured = enough_joints(accepted, 1)
    if measured.sum() < 2:
        return None
    first_s, last_s = frame_t_imu[measured][[0, -1]].tolist()
    with_further = bool(segment.further) and bool(further_segments(calibration))
    start_s, end_s = max(segment.start_s, first_s - REACH_S), min(segment.end_s, last_s + REACH_S)
    core_start_s, core_end_s = max(start_s, segment.core_start_s), min(end_s, segment.core_end_s)
    if core_end_s - core_start_s < 0.1:
        return None
    visible = seen_by_any(frame_t_imu, enough_joints(accepted, segment.needed), segment.camera)
    rows = np.flatnonzero(inside)
    gaps = find_gaps(frame_t_imu[rows], visible[rows], start_s, end_s)
    # nodes of the time range within reach, and the node of each frame, -1 where there is none
    cameras = 1 if segment.camera is None else int(segment.camera.max(initial=0)) + 1
    seen = np.flatnonzero(measured)
    if cameras == 1:
        seen = seen[decimate(frame_t_imu[seen])]
    own = frame_t_imu[seen], visible[seen], near_impacts(segment.signal, frame_t_imu)[seen]
    owner = seen[group_frames(*own) if cameras == 1 else group_frames_of_cameras(*own, cameras)]
    t = insert_nodes(frame_t_imu[np.unique(owner)], start_s, end_s, gaps=gaps if with_further else ())
    first_s, last_s = reach(core_start_s, core_end_s, gaps, margin_s)
    t = t[(t >= first_s) & (t <= last_s)]
    node = np.clip(np.searchsorted(t, frame_t_imu[owner] - 1e-9), 0, len(t) - 1)
    frame_node = np.full(len(frame_t_imu), -1)
    frame_node[seen] = np.where(np.abs(t[node] - frame_t_imu[owner]) < 1e-9, node, -1)
    if alignment is None:
        vectors = pairs(segment, frame_t_imu, accepted & segment.with_depth, calibration)
        if not vectors:
            return None
        alignment = align(vectors, start_s, end_s, segment.down)
    R = (alignment.at(t) * segment.attitude.at(t)).as_matrix()
    nearest = np.clip(np.searchsorted(alignment.t, t), 0, len(alignment.t) - 1)
    R_frames = (alignment.at(frame_t_imu) * segment.attitude.at(frame_t_imu)).as_matrix()
    places, count = imu_positions(segment.position, accepted, R_frames, calibration)
    known = count > 0
    position = frame_t_imu[known], places[known]
    carriers = prepare_further(segment, frame_t_imu, accepted, calibration, t)
    if carriers:
        position = forearm_in_gaps(carriers, t, R, gaps, calibration, position)
    start = states_from_camera(t, R, *position)
    hanging = prepare_further(segment, frame_t_imu, accepted, calibration, t, start)
    forearm = PreparedRun(FOREARM.name, segment.signal, 0, start, R, alignment.covariance[nearest])
    prepared = PreparedSegment(
        t=t,
        bodies=(forearm, *carriers, *hanging),
        frame_t_imu=frame_t_imu[rows],
        frame_node=frame_node[rows],
        position=segment.position[rows],
        accepted=accepted[rows],
        sigma_m=np.broadcast_to(sigma_m, (len(rows), len(JOINTS)))
        if segment.camera is None or sigma_m.ndim == 1
        else sigma_m[np.minimum(segment.camera[rows], len(sigma_m) - 1)],
        gaps=gaps,
        acceleration_std=acceleration_std(segment.signal, segment.attitude, t),
        still=is_still(segment.signal, segment.attitude, t),
        start_s=core_start_s,
        end_s=core_end_s,
        camera=None if segment.camera is None else segment.camera[rows],
        ray_origin_m=segment.ray_origin_m,
    )
    return prepared, alignment


def reach(start_s: float, end_s: float, gaps: tuple[Gap, ...], margin_s: float) -> tuple[float, float]:
    """What has to be solved for an answer: its margins, the far side of a gap that contains an end of it."""
    first, last = start_s - margin_s, end_s + margin_s
    for gap in gaps:
        if gap.start_s <= start_s <= gap.end_s:
            first = min(first, gap.start_s - margin_s)
        if gap.start_s <= end_s <= gap.end_s:
            last = max(last, gap.end_s + margin_s)
    return first, last


def states_from_camera(t: FloatArray, R: FloatArray, frame_t_imu: FloatArray, position: FloatArray) -> States:
    """Position and velocity at nodes (n,) from the IMU's positions (k, 3) m at visible frames (k,)."""
    p, v = _local_lines(frame_t_imu, position)
    if len(frame_t_imu) == 1:
        return States(R, np.tile(p[0], (len(t), 1)), np.zeros((len(t), 3)))
    curve = PiecewiseCubic(frame_t_imu, p, v)
    inside = np.clip(t, frame_t_imu[0], frame_t_imu[-1])
    out = t != inside
    velocity = curve(inside, 1)
    velocity[out] = 0.0
    return States(R, curve(inside), velocity)


def _local_lines(t: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and slope at each time of the least-squares line over +- `LINE_HALF_S` (prefix sums)."""
    lo, hi = np.searchsorted(t, [t - LINE_HALF_S, t + LINE_HALF_S + 1e-9])

    def window_sum(y: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, *y.shape[1:])), np.cumsum(y, axis=0)])
        return total[hi] - total[lo]

    origin = t[len(t) // 2]
    u, mean = t - origin, x.mean(axis=0)
    n, su, suu = window_sum(np.ones_like(t)), window_sum(u), window_sum(u * u)
    sx, sux = window_sum(x - mean), window_sum(u[:, None] * (x - mean))
    determinant = n * suu - su**2
    good = (n >= 3) & (determinant > 1e-9 * n)
    safe = np.where(good, determinant, 1.0)[:, None]
    slope = np.where(good[:, None], (n[:, None] * sux - su[:, None] * sx) / safe, 0.0)
    value = np.where(good[:, None], (sx + slope * (n * u - su)[:, None]) / n[:, None] + mean, x)
    return value, np.clip(slope, -6.0, 6.0)


def further_segments(calibration: ArmCalibration) -> tuple[str, ...]:
    """Names of the segments beyond the forearm whose IMU is known enough to be used."""
    known = (body for body in FURTHER if body.name in calibration.mountings)
    return tuple(body.name for body in known if body.shared_joint in calibration.lever_arms)


def prepare_further(
    segment: Segment,
    frame_t_imu: FloatArray,  # (f,) s
    accepted: BoolArray,  # bool (f, 5)
    calibration: ArmCalibration,
    t: FloatArray,  # (n,) s
    parent: States | None = None,
) -> tuple[PreparedRun, ...]:
    """The runs of IMUs on further segments at a segment's nodes."""
    prepared = []
    for run in segment.further:
        body = SEGMENTS[run.segment]
        if run.segment not in further_segments(calibration) or body.carries_parent != (parent is None):
            continue
        near, far = (JOINTS.index(body.as_forearm[end]) for end in ("elbow", "wrist"))
        rows = np.flatnonzero((t >= run.signal.start_s) & (t <= run.signal.end_s))
        inside = (frame_t_imu >= run.signal.start_s) & (frame_t_imu <= run.signal.end_s)
        used = accepted & inside[:, None]
        if len(rows) < 2 or (used[:, near] & used[:, far]).sum() < FEWEST_FRAMES:
            continue
        levers = calibration.mountings[run.segment].lever_arms
        near_B, far_B = (levers[body.as_forearm[end]].position_m for end in ("elbow", "wrist"))
        start_s, end_s = max(run.signal.start_s, segment.start_s), min(run.signal.end_s, segment.end_s)
        # what camera and IMU both measure: the segment's direction, and its far joint's acceleration
        both, seen_far = used[:, near] & used[:, far], used[:, far]
        ends = segment.position[both, near], segment.position[both, far]
        along_B = unit(far_B - near_B)
        directions = direction_pairs(frame_t_imu[both], *ends, run.attitude, along_B)
        accelerations = acceleration_pairs(
            frame_t_imu[seen_far], segment.position[seen_far, far], run.attitude, run.signal
        )
        pairs = [directions, accelerations.with_lever(far_B)]
        alignment = align(pairs, start_s, end_s, segment.down)
        own_t = t[rows]
        R = (alignment.at(own_t) * run.attitude.at(own_t)).as_matrix()
        if parent is None:  # its near joint: as seen, or from the far joint and the segment
            frames = np.flatnonzero(used[:, near] | used[:, far])
            seen_t, position = frame_t_imu[frames], segment.position[frames]
            R_frames = (alignment.at(seen_t) * run.attitude.at(seen_t)).as_matrix()
            by_far = position[:, far] + R_frames @ (near_B - far_B)
            place = np.where(used[frames, near, None], position[:, near], by_far)
            p = interpolate(seen_t, place, own_t) - R @ near_B
        else:
            lever = calibration.lever_arms[body.shared_joint].position_m
            p = parent.p[rows] + parent.R[rows] @ lever - R @ levers[body.shared_joint].position_m
        v = np.gradient(p, own_t, axis=0) if len(own_t) > 2 else np.zeros_like(p)
        nearest = np.clip(np.searchsorted(alignment.t, own_t), 0, len(alignment.t) - 1)
        start, covariance = States(R, p, v), alignment.covariance[nearest]
        prepared.append(PreparedRun(run.segment, run.signal, int(rows[0]), start, R, covariance))
    return tuple(prepared)


def forearm_in_gaps(
    runs: Sequence[PreparedRun],
    t: FloatArray,  # (n,) s
    R: FloatArray,  # (n, 3, 3)
    gaps: tuple[Gap, ...],
    calibration: ArmCalibration,
    visible: tuple[FloatArray, FloatArray],  # (k,) s, and ndarray, shape (k, 3), m
) -> tuple[FloatArray, FloatArray]:  # times (m,) s, position (m, 3) m
    """Forearm IMU positions from the camera, and in gaps by way of the segment that carries it."""
    seen_t = visible[0]
    times, position = [seen_t], [visible[1]]
    for run in runs:
        joint = SEGMENTS[run.segment].shared_joint
        lever = calibration.lever_arms[joint].position_m
        joint_B = calibration.mountings[run.segment].lever_arms[joint].position_m
        nodes = np.arange(run.first, run.first + len(run.start.p))
        place = run.start.p + run.start.R @ joint_B
        hidden = occluded_at(t[nodes], gaps)
        after = np.clip(np.searchsorted(seen_t, t[nodes]), 1, len(seen_t) - 1)
        apart = np.minimum(np.abs(seen_t[after] - t[nodes]), np.abs(seen_t[after - 1] - t[nodes]))
        hidden &= apart > CLOSEST_S
        times.append(t[nodes[hidden]])
        position.append(place[hidden] - R[nodes[hidden]] @ lever)
    order = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(times)[order], np.concatenate(position)[order]
