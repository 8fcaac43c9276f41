"""A window of a prepared segment: nodes, initial values, camera samples by node."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import interpolate
from ..measurements.inertial import InertialSignal, equivalent_samples, integrate, split_steps
from ..measurements.rays import LONE_SHOULDER_ALONG_M, SHOULDER_ALONG_M, is_alone, origins_of
from ..measurements.visibility import occluded_at
from ..recording import FOREARM_JOINTS, JOINTS
from ..units import GRAVITY
from .nodes import propagate
from .prepare import PreparedRun, PreparedSegment
from .problem import (
    ImuIncrements,
    JointMeasurements,
    KnotSamples,
    NoiseModel,
    Priors,
    SegmentRun,
    ShoulderMeasurements,
    States,
    Window,
)

#: Shoulder knots keep at least this far apart, s.
KNOT_S = 0.09
#: A still arm's acceleration, m/s^2, and how long an acceleration lasts, s (`_velocity_change`).
STILL_ACCELERATION = 0.1
CHANGE_TIME_S = 0.2
#: An orientation about which nothing is known, rad: wider, and a window at rest is singular to the solver.
FREE_RAD = 1.0


def window_between(
    prepared: PreparedSegment,
    priors: Priors,
    noise: NoiseModel,
    sharing: int,
    start_s: float = -np.inf,
    end_s: float = np.inf,
) -> Window:
    """The window of a segment's nodes from one time to another, or of all of them."""
    lo, hi = np.searchsorted(prepared.t, [start_s, end_s + 1e-9]).tolist()
    return Window(
        t=prepared.t[lo:hi],
        core_start_s=max(prepared.start_s, float(prepared.t[lo])),
        core_end_s=min(prepared.end_s, float(prepared.t[hi - 1])),
        bodies=tuple(_segment_runs(prepared, lo, hi, priors, sharing)),
        joint_measurements=_joint_measurements(prepared, lo, hi, priors),
        shoulder=_shoulder(prepared, lo, hi),
        velocity_change=_velocity_change(prepared, lo, hi),
        still=np.flatnonzero(prepared.still[lo:hi] & occluded_at(prepared.t[lo:hi], prepared.gaps)),
        priors=priors,
        noise=noise,
        alone=is_alone(prepared.ray_origin_m),
        is_started=prepared.is_started,
    )


def _velocity_change(prepared: PreparedSegment, lo: int, hi: int) -> FloatArray:
    """How much the velocity may change in each interval without a camera, m/s (n - 1,); inf elsewhere."""
    t = prepared.t[lo:hi]
    middle, dt = 0.5 * (t[1:] + t[:-1]), np.diff(t)
    acceleration_std = np.maximum(
        prepared.acceleration_std[lo : hi - 1], prepared.acceleration_std[lo + 1 : hi]
    )
    change = np.hypot(acceleration_std, STILL_ACCELERATION) * np.sqrt(dt * CHANGE_TIME_S)
    return np.where(occluded_at(middle, prepared.gaps), change, np.inf)


def _weakened(covariance: FloatArray, factor: float) -> FloatArray:
    """The covariance times the factor, no direction worse known than `FREE_RAD`."""
    variance, axes = np.linalg.eigh(covariance)
    return (axes * np.minimum(variance * factor, FREE_RAD**2)) @ axes.T


def _increments(signal: InertialSignal, t: FloatArray, bias: FloatArray) -> ImuIncrements:
    step_t, first = split_steps(t)
    acc, gyro, h = equivalent_samples(integrate(signal, step_t, bias))
    return ImuIncrements(acc, gyro, h, first, bias, signal.velocity_error(t))


def _segment_runs(
    prepared: PreparedSegment, lo: int, hi: int, prior: Priors, sharing: int
) -> Iterator[SegmentRun]:
    """What nodes lo to hi - 1 have of each IMU."""
    for run in prepared.bodies:
        first, last = max(run.first, lo), min(run.first + len(run.start.p), hi)
        if last - first < 2:
            continue
        rows = slice(first - run.first, last - run.first)
        node = int(np.argmin(np.trace(run.attitude_covariance[rows], axis1=1, axis2=2)))
        bias = prior.shared.mean[prior.layout.bias_of(run.segment)]
        yield SegmentRun(
            segment=run.segment,
            first=first - lo,
            start=States(run.start.R[rows], run.start.p[rows], run.start.v[rows]),
            increments=_increments(run.signal, prepared.t[first:last], bias),
            attitude_node=node,
            attitude=run.attitude[rows][node],
            # one prior for all windows together: its error is common to all
            attitude_covariance=_weakened(run.attitude_covariance[rows][node], sharing),
        )


def _joint_measurements(
    prepared: PreparedSegment, lo: int, hi: int, prior: Priors
) -> tuple[JointMeasurements, ...]:
    layout = prior.layout
    parts = [measured for run in prepared.bodies for measured in _of_run(prepared, run, lo, hi, prior)]
    joint_measurements = []
    for joint, camera in product(FOREARM_JOINTS, sorted({part.camera for part in parts})):
        own = [
            part
            for part in parts
            if (part.joint, part.camera) == (joint, camera) and part.segment == layout.segment_of(joint)
        ]
        if len(own) > 1:  # between the pauses of its IMU
            own = [JointMeasurements.joined(own)]
        joint_measurements += own
    return tuple(joint_measurements)


def _of_run(
    prepared: PreparedSegment, run: PreparedRun, lo: int, hi: int, prior: Priors
) -> Iterator[JointMeasurements]:
    """The camera's samples of the joints that are tied to one run of an IMU, in nodes lo to hi - 1."""
    layout, mean = prior.layout, prior.shared.mean
    joints = [joint for joint in FOREARM_JOINTS if layout.segment_of(joint) == run.segment]
    first, last = max(run.first, lo), min(run.first + len(run.start.p), hi)
    if not joints or last - first < 2:
        return
    inside = np.flatnonzero((prepared.frame_node >= first) & (prepared.frame_node < last))
    node, frame_t_imu = prepared.frame_node[inside], prepared.frame_t_imu[inside]
    motion = propagate(
        run.signal,
        prepared.t[run.first :],
        run.start,
        np.clip(frame_t_imu, run.signal.start_s, run.signal.end_s),
        node - run.first,
        layout.down(mean) * GRAVITY,
        mean[layout.bias_of(run.segment)],
    )
    cameras = np.zeros(1, int) if prepared.camera is None else np.unique(prepared.camera)
    for joint, camera in product(joints, cameras.tolist()):
        column, rows_of = JOINTS.index(joint), layout.lever_of_sample(joint, run.segment)
        accepted = prepared.accepted[inside, column]
        if prepared.camera is not None:
            accepted = accepted & (prepared.camera[inside] == camera)
        rows = np.flatnonzero(accepted)
        if len(rows):
            lever = np.zeros(3) if rows_of is None else mean[rows_of]
            yield JointMeasurements(
                joint,
                frame_t_imu[rows],
                node[rows] - lo,
                prepared.position[inside[rows], column],
                prepared.sigma_m[inside[rows], column],
                motion.shift(lever)[rows],
                motion.velocity(lever)[rows],
                run.segment,
                camera,
                _ray_origin(prepared, camera),
            )


def _ray_origin(prepared: PreparedSegment, camera: int) -> FloatArray | None:
    """Where a camera's rays begin, (3,) m; None of one with depth."""
    origins = prepared.ray_origin_m
    return None if origins is None or not np.isfinite(origins[camera]).all() else origins[camera]


def _shoulder(prepared: PreparedSegment, lo: int, hi: int) -> ShoulderMeasurements | None:
    """Knots about every tenth of a second, each with the mean of the frames nearest to it."""
    column = JOINTS.index("shoulder")
    if not prepared.accepted[:, column].any():
        return None
    t = prepared.t[lo:hi]
    knots = [0]
    for i in range(1, len(t)):
        if t[i] - t[knots[-1]] >= KNOT_S or i == len(t) - 1:
            knots.append(i)
    node = np.array(knots)
    visible = np.flatnonzero(prepared.accepted[:, column])
    visible_t = prepared.frame_t_imu[visible]
    near = (visible_t >= t[0] - KNOT_S) & (visible_t <= t[-1] + KNOT_S)
    owner = np.searchsorted(0.5 * (t[node][1:] + t[node][:-1]), visible_t[near])
    count = np.bincount(owner, minlength=len(node)).astype(float)
    total = np.zeros((len(node), 3))
    np.add.at(total, owner, prepared.position[visible[near], column])
    variance = np.bincount(owner, weights=prepared.sigma_m[visible[near], column] ** 2, minlength=len(node))
    with np.errstate(invalid="ignore", divide="ignore"):
        position = total / count[:, None]
        sigma = np.sqrt(variance) / count
    start = interpolate(visible_t, prepared.position[visible, column], t[node])
    if prepared.ray_origin_m is not None:
        return _shoulder_on_rays(prepared, node, visible[near], owner, start)
    return ShoulderMeasurements(node, position, sigma, np.where(count[:, None] > 0, position, start))


def _shoulder_on_rays(
    prepared: PreparedSegment, node: IntArray, frames: IntArray, owner: IntArray, start: FloatArray
) -> ShoulderMeasurements:
    """The same where a camera sees no depth: every frame adds what it knows, across its ray or in all."""
    column = JOINTS.index("shoulder")
    camera = None if prepared.camera is None else prepared.camera[frames]
    origin = origins_of(prepared.ray_origin_m, camera, len(frames))
    assert origin is not None
    position, sigma = prepared.position[frames, column], prepared.sigma_m[frames, column]
    along_m = LONE_SHOULDER_ALONG_M if is_alone(prepared.ray_origin_m) else SHOULDER_ALONG_M
    samples = KnotSamples(owner, position, sigma, origin, along_m)
    mean, sigmas, roots = samples.of_knots(start)
    start = np.where(np.isfinite(mean), mean, start)
    return ShoulderMeasurements(node, mean, sigmas, start, roots, samples)
