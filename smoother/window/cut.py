"""A window of a prepared segment: nodes, initial values, camera samples by node."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ..array_types import FloatArray
from ..linalg import interpolate
from ..measurements.inertial import equivalent_samples, integrate, split_steps
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
        # one prior for all windows together: its error is common to all; none is weaker than `FREE_RAD`
        variance, axes = np.linalg.eigh(run.attitude_covariance[rows][node])
        weakened = (axes * np.minimum(variance * sharing, FREE_RAD**2)) @ axes.T
        t, bias = prepared.t[first:last], prior.shared.mean[prior.layout.bias_of(run.segment)]
        step_t, steps = split_steps(t)
        acc, gyro, h = equivalent_samples(integrate(run.signal, step_t, bias))
        yield SegmentRun(
            segment=run.segment,
            first=first - lo,
            start=run.start.rows(rows),
            increments=ImuIncrements(acc, gyro, h, steps, bias, run.signal.velocity_error(t)),
            attitude_node=node,
            attitude=run.attitude[rows][node],
            attitude_covariance=weakened,
        )


def _joint_measurements(
    prepared: PreparedSegment, lo: int, hi: int, prior: Priors
) -> tuple[JointMeasurements, ...]:
    """Each joint's samples by each camera, those between all pauses of its IMU together."""
    parts = [measured for run in prepared.bodies for measured in _of_run(prepared, run, lo, hi, prior)]
    cameras = sorted({part.camera for part in parts})
    alike = (
        [part for part in parts if (part.joint, part.camera) == (joint, camera)]
        for joint, camera in product(FOREARM_JOINTS, cameras)
    )
    return tuple(JointMeasurements.joined(own) for own in alike if own)


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
    by_frame = np.zeros(len(inside), int) if prepared.camera is None else prepared.camera[inside]
    origins = origins_of(prepared.ray_origin_m, by_frame, len(inside))
    cameras = np.zeros(1, int) if prepared.camera is None else np.unique(prepared.camera)
    for joint, camera in product(joints, cameras.tolist()):
        column, rows_of = JOINTS.index(joint), layout.levers(run.segment).get(joint)
        rows = np.flatnonzero(prepared.accepted[inside, column] & (by_frame == camera))
        if len(rows):
            lever = np.zeros(3) if rows_of is None else mean[rows_of]
            is_ray = origins is not None and bool(np.isfinite(origins[rows[0]]).all())
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
                origins[rows[0]] if origins is not None and is_ray else None,
            )


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
    if prepared.ray_origin_m is None:
        return ShoulderMeasurements(node, position, sigma, np.where(count[:, None] > 0, position, start))
    # every frame adds what it knows, across its ray or in all
    frames = visible[near]
    camera = None if prepared.camera is None else prepared.camera[frames]
    origin = origins_of(prepared.ray_origin_m, camera, len(frames))
    assert origin is not None
    along_m = LONE_SHOULDER_ALONG_M if is_alone(prepared.ray_origin_m) else SHOULDER_ALONG_M
    places, sigmas_m = prepared.position[frames, column], prepared.sigma_m[frames, column]
    samples = KnotSamples(owner, places, sigmas_m, origin, along_m)
    mean, sigma, roots = samples.of_knots(start)
    return ShoulderMeasurements(node, mean, sigma, np.where(np.isfinite(mean), mean, start), roots, samples)
