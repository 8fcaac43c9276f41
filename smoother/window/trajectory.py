"""Windows joined to one motion at the nodes, and that motion at the IMU's own times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..linalg import interpolate, rotate_covariance, runs, skew
from ..measurements.inertial import InertialSignal, integrate
from ..rotation import Rotation
from .prepare import PreparedSegment
from .problem import States, Window
from .solution import Solution, WindowDraws

#: Neighbouring windows are blended over this time on both sides of their border, s.
BLEND_HALF_S = 0.5


@dataclass(frozen=True)
class SegmentTrajectory:
    """The IMU of a segment of the arm at the nodes."""

    t: FloatArray  # (n,) s: nodes on the forearm IMU's clock
    states: States  # Pose and velocity of the IMU; position nan where it has no samples
    pose_covariance: FloatArray  # (n, 6, 6) m^2, m rad, rad^2: of (position, rotation vector) in {K}
    velocity_covariance: FloatArray  # (n, 3, 3) m^2/s^2: in {K}; zero where the windows were solved without
    bias: FloatArray  # (n, 6) m/s^2 and rad/s: of accelerometer and gyroscope
    gravity: FloatArray  # (n, 3) m/s^2: in {K}
    segment: str = FOREARM.name  # Name of the segment

    def of_nodes(self, nodes: slice) -> SegmentTrajectory:
        """At some of the nodes."""
        states, covariances = self.states, (self.pose_covariance[nodes], self.velocity_covariance[nodes])
        own = States(states.R[nodes], states.p[nodes], states.v[nodes])
        return SegmentTrajectory(
            self.t[nodes], own, *covariances, self.bias[nodes], self.gravity[nodes], self.segment
        )


@dataclass(frozen=True)
class Trajectory:
    """The arm at the nodes."""

    bodies: tuple[SegmentTrajectory, ...]  # Of each segment with an IMU, the forearm first
    shoulder: FloatArray | None  # (n, 3) m: in {K}; None where the camera saw no shoulder
    shoulder_covariance: FloatArray | None  # (n, 3, 3) m^2: in {K}
    levers: dict[str, FloatArray]  # dict of (n, 3) m

    @property
    def t(self) -> FloatArray:
        """Nodes (n,) s on the forearm IMU's clock."""
        return self.forearm.t

    @property
    def forearm(self) -> SegmentTrajectory:
        """The forearm's."""
        return self.bodies[0]

    def of(self, segment: str) -> SegmentTrajectory | None:
        """A segment's; None where it has no IMU."""
        return next((body for body in self.bodies if body.segment == segment), None)

    def lever_at(self, joint: str, t: FloatArray) -> FloatArray:
        """A joint's lever arm (k, 3) m at times (k,), as the windows there have it; 0 for the IMU."""
        if joint not in self.levers:
            return np.zeros((len(t), 3))
        return interpolate(self.t, self.levers[joint], t)


def merge_windows(t: FloatArray, windows: list[Window], solutions: list[Solution]) -> Trajectory:  # t (n,) s
    """Blend the windows of a segment."""
    n = len(t)
    has_shoulder = windows[0].shoulder is not None
    shoulder, shoulder_covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    layout = windows[0].priors.layout
    tied = {joint: layout.lever(joint) for joint in layout.joints}
    for name in layout.further:
        rows_of = layout.levers(name)
        tied |= {joint: rows_of[joint] for joint in SEGMENTS[name].camera_joints if joint in rows_of}
    levers = {joint: np.zeros((n, 3)) for joint in tied}
    filled = np.zeros(n, dtype=bool)
    for window, solution in zip(windows, solutions, strict=True):
        own, rows, share = window_share(t, window, filled)
        for joint, values in levers.items():
            lever = solution.message.shared.mean[tied[joint]]
            mix(values, rows, np.tile(lever, (len(own), 1)), share)
        if has_shoulder:
            knots, covariance = _shoulder_at_nodes(window, solution)
            mix(shoulder, rows, knots[own], share)
            if covariance is not None:
                mix(shoulder_covariance, rows, covariance[own], share)
        filled[rows] = True
    return Trajectory(
        tuple(_merge_segment(t, windows, solutions, k) for k in range(len(solutions[0].bodies))),
        shoulder if has_shoulder else None,
        shoulder_covariance if has_shoulder else None,
        levers,
    )


def _merge_segment(
    t: FloatArray, windows: list[Window], solutions: list[Solution], number: int
) -> SegmentTrajectory:
    """The windows' answers on one of the segments, blended."""
    n = len(t)
    R, p, v = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    pose, velocity = np.zeros((n, 6, 6)), np.zeros((n, 3, 3))
    bias, gravity = np.zeros((n, 6)), np.zeros((n, 3))
    filled = np.zeros(n, dtype=bool)
    for window, solution in zip(windows, solutions, strict=True):
        body = solution.bodies[number]
        own, rows, share = window_share(t, window, filled)
        turn = turn_to(R[rows], body.states.R[own], filled[rows])
        base = np.where(filled[rows, None, None], R[rows], body.states.R[own])
        R[rows] = base @ Rotation.from_rotvec(share[:, None] * turn).as_matrix()
        down = window.priors.layout.down(solution.message.shared.mean) * window.gravity_magnitude
        for target, value in (
            (p, body.states.p),
            (v, body.states.v),
            (pose, body.pose_covariance),
            (velocity, body.velocity_covariance),
            (bias, body.bias),
            (gravity, np.tile(down, (len(window.t), 1))),
        ):
            if value is not None:
                mix(target, rows, value[own], share)
        filled[rows] = True
    return SegmentTrajectory(
        t, States(R, p, v), pose, velocity, bias, gravity, solutions[0].bodies[number].segment
    )


def window_share(
    t: FloatArray,  # (n,) s
    window: Window,
    filled: np.ndarray,  # bool (n,)
) -> tuple[IntArray, IntArray, FloatArray]:  # own int (k,), rows int (k,), share (k,)
    """What a window counts for in its section."""
    offset = int(np.searchsorted(t, window.t[0] - 1e-9))
    own = _own_nodes(window, first=offset == 0, last=offset + len(window.t) == len(t))
    rows = offset + own
    share = share_after(window.t[own], window.core_start_s)
    share[~filled[rows]] = 1.0
    return own, rows, share


def _own_nodes(window: Window, first: bool, last: bool) -> np.ndarray:
    start = -np.inf if first else window.core_start_s - BLEND_HALF_S
    end = np.inf if last else window.core_end_s + BLEND_HALF_S
    return np.flatnonzero((window.t >= start) & (window.t <= end))


def share_after(t: FloatArray, border_s: float, half_s: float = BLEND_HALF_S) -> FloatArray:
    """Share (n,) of the window after a border at times (n,): 0 before the blend, 1 after it, smooth there."""
    u = np.clip((t - border_s + half_s) / (2 * half_s), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def turn_to(R: FloatArray, target: FloatArray, filled: np.ndarray) -> FloatArray:
    """Rotation vectors (k, 3) from R to the target (k, 3, 3); zero where R is not filled yet."""
    turn = np.zeros((len(R), 3))
    if filled.any():
        turn[filled] = Rotation.from_matrix(np.swapaxes(R[filled], 1, 2) @ target[filled]).as_rotvec()
    return turn


def mix(target: FloatArray, rows: np.ndarray, value: FloatArray, share: FloatArray) -> None:
    """Move the target's rows (k,) towards the values (k, ...) by the share (k,) of the way."""
    weight = share.reshape(-1, *([1] * (value.ndim - 1)))
    target[rows] = (1.0 - weight) * target[rows] + weight * value


def _shoulder_at_nodes(window: Window, solution: Solution) -> tuple[FloatArray, FloatArray | None]:
    """Knots interpolated linearly to the window's nodes."""
    assert window.shoulder is not None and solution.shoulder is not None
    knots, covariance = window.t[window.shoulder.node], solution.shoulder_covariance
    return (
        interpolate(knots, solution.shoulder, window.t),
        None if covariance is None else interpolate(knots, covariance, window.t),
    )


def joint_from_pose(
    R: FloatArray,  # (n, 3, 3)
    p: FloatArray,  # (n, 3) m
    pose_covariance: FloatArray,  # (n, 6, 6) m^2, m rad, rad^2
    lever: FloatArray,  # (3,) or (n, 3) m
    lever_covariance: FloatArray | None = None,  # (3, 3) m^2
) -> tuple[FloatArray, FloatArray]:  # position (n, 3) m, covariance (n, 3, 3) m^2
    """A joint's position and covariance from the IMU's pose and the joint's lever arm.

    First-order propagation of `p + R l` with a rotation error in {K}: J = [I, -[R l]x] (Barfoot, State
    Estimation for Robotics, 2017, section 7.2); the lever arm's error is taken as independent
    of the pose's.
    """
    arm = np.einsum("nij,nj->ni", R, np.broadcast_to(lever, p.shape))
    jacobian = np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), -skew(arm)], axis=2)
    covariance = rotate_covariance(jacobian, pose_covariance)
    if lever_covariance is not None:
        covariance = covariance + rotate_covariance(R, lever_covariance)
    return p + arm, covariance


def at_times(motion: SegmentTrajectory, signal: InertialSignal, at: FloatArray) -> States:  # at (N,) s
    """Pose and velocity at any times within the nodes: each node's state propagated forwards by the IMU."""
    first, last = np.searchsorted(motion.t, at[[0, -1]], side="right").tolist()
    motion = motion.of_nodes(slice(max(min(first, len(motion.t) - 1) - 1, 0), last + 1))
    nodes = motion.t
    union = np.union1d(nodes, at)
    node_row = np.searchsorted(union, nodes)
    interval = np.clip(np.searchsorted(nodes, union, side="right") - 1, 0, len(nodes) - 2)
    delta = integrate(signal, union, motion.bias[interval[:-1]])
    R, p, v = np.zeros((len(union), 3, 3)), np.zeros((len(union), 3)), np.zeros((len(union), 3))
    R[node_row], p[node_row], v[node_row] = motion.states.R, motion.states.p, motion.states.v
    inside = np.diff(node_row) - 1
    error_R, error_p, error_v = (np.zeros((len(nodes) - 1, 3)) for _ in range(3))
    for k in range(int(inside.max(initial=0)) + 1):
        rows = np.flatnonzero(inside >= k)
        a = node_row[rows] + k
        h, g = delta.dt[a, None], motion.gravity[rows]
        next_p = p[a] + v[a] * h + 0.5 * g * h**2 + np.einsum("nij,nj->ni", R[a], delta.delta_p[a])
        next_v = v[a] + g * h + np.einsum("nij,nj->ni", R[a], delta.delta_v[a])
        next_R = R[a] @ delta.delta_R[a]
        ends = inside[rows] == k
        last = rows[ends]
        if len(last):
            error_p[last] = motion.states.p[last + 1] - next_p[ends]
            error_v[last] = motion.states.v[last + 1] - next_v[ends]
            turn = np.swapaxes(next_R[ends], 1, 2) @ motion.states.R[last + 1]
            error_R[last] = Rotation.from_matrix(turn).as_rotvec()
        inner = ~ends
        R[a[inner] + 1], p[a[inner] + 1], v[a[inner] + 1] = next_R[inner], next_p[inner], next_v[inner]
    row = np.searchsorted(union, at)
    of = interval[row]
    length = np.diff(nodes)[of]
    is_node = np.isin(at, nodes, assume_unique=True)
    u = np.where(is_node, 0.0, (at - nodes[of]) / length)[:, None]
    length = length[:, None]
    # the cubic with value and slope 0 at the start, (error_p, error_v) at the end
    value = error_p[of] * (3 * u**2 - 2 * u**3) + error_v[of] * length * (u**3 - u**2)
    slope = error_p[of] * (6 * u - 6 * u**2) / length + error_v[of] * (3 * u**2 - 2 * u)
    turned = R[row] @ Rotation.from_rotvec(error_R[of] * u).as_matrix()
    return States(turned, p[row] + value, v[row] + slope)


def merge_draws(
    t: FloatArray,  # (n,) s
    windows: Sequence[Window],
    solutions: Sequence[Solution],
) -> WindowDraws:
    """The windows' draws blended as `merge_windows` blends the answer."""
    merged: dict[str, FloatArray] = {}
    filled = np.zeros(len(t), dtype=bool)
    for window, solution in zip(windows, solutions, strict=True):
        assert solution.draws is not None
        knots = window.t if window.shoulder is None else window.t[window.shoulder.node]
        own, rows, share = window_share(t, window, filled)
        for name, values in solution.draws.at_nodes(knots, window.t).columns().items():
            column = merged.setdefault(name, np.zeros((values.shape[0], len(t), 3)))
            mix(np.moveaxis(column, 1, 0), rows, np.moveaxis(values[:, own], 1, 0), share)
        filled[rows] = True
    return WindowDraws.from_columns(merged)


def segment_at(motion: SegmentTrajectory, prepared: PreparedSegment, at: FloatArray) -> States:  # at (k,) s
    """Pose and velocity of an IMU that pauses at any times; orientation and all else nan without samples."""
    states = States(
        np.full((len(at), 3, 3), np.nan), np.full((len(at), 3), np.nan), np.full((len(at), 3), np.nan)
    )
    known = np.isfinite(motion.states.p[:, 0])
    offset = int(np.searchsorted(prepared.t, motion.t[0] - 1e-9))  # the motion may be of some nodes only
    for run in prepared.runs(motion.segment):
        mine = np.zeros_like(known)
        mine[max(run.first - offset, 0) : max(run.first + len(run.start.p) - offset, 0)] = True
        for nodes in runs(known & mine):
            inside = slice(
                *np.searchsorted(at, motion.t[[nodes.start, nodes.stop - 1]] + [0.0, 1e-9]).tolist()
            )
            if nodes.stop - nodes.start < 2 or inside.stop <= inside.start:
                continue
            part = motion.of_nodes(nodes)
            answer = at_times(part, run.signal, np.clip(at[inside], part.t[0], part.t[-1]))
            states.R[inside], states.p[inside], states.v[inside] = answer.R, answer.p, answer.v
    return states


def with_start(
    prepared: PreparedSegment, forearm: States, trajectory: Trajectory, before: PreparedSegment
) -> PreparedSegment:
    """The segment with an earlier solution's motion as start values, where it has any."""
    bodies = [replace(prepared.forearm, start=forearm)]
    for run in prepared.bodies[1:]:
        start, motion = run.start, trajectory.of(run.segment)
        if motion is not None:
            states = segment_at(motion, before, prepared.t[run.first : run.first + len(run.start.p)])
            good = np.isfinite(states.p[:, 0])
            start = States(
                np.where(good[:, None, None], states.R, start.R),
                np.where(good[:, None], states.p, start.p),
                np.where(good[:, None], states.v, start.v),
            )
        bodies.append(replace(run, start=start))
    return replace(prepared, bodies=tuple(bodies))
