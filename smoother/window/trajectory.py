"""A window's answer at the IMU's own times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import rotate_covariance, runs, skew
from ..measurements.inertial import InertialSignal, integrate
from ..rotation import Rotation
from .prepare import PreparedSegment
from .problem import States
from .solution import SegmentSolution, Solution

#: Neighbouring sections are blended over this time on both sides of their border, s.
BLEND_HALF_S = 0.5


def share_after(t: FloatArray, border_s: float, half_s: float = BLEND_HALF_S) -> FloatArray:
    """Share (n,) of what comes after a border at times (n,): 0 before the blend, 1 after it, smooth there."""
    u = np.clip((t - border_s + half_s) / (2 * half_s), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def joint_from_pose(
    R: FloatArray,  # (n, 3, 3)
    p: FloatArray,  # (n, 3) m
    pose_covariance: FloatArray,  # (n, 6, 6) m^2, m rad, rad^2
    lever: FloatArray,  # (3,) or (n, 3) m
    lever_covariance: FloatArray | None = None,  # (3, 3) m^2
) -> tuple[FloatArray, FloatArray]:  # position (n, 3) m, covariance (n, 3, 3) m^2
    """A joint's position and covariance from the IMU's pose and the joint's lever arm.

    First-order propagation of `p + R l` with a rotation error in {K}: J = [I, -[R l]x] (Barfoot, State
    Estimation for Robotics, 2017, section 7.2); what is given of the lever arm is added as independent.
    """
    arm = np.einsum("nij,nj->ni", R, np.broadcast_to(lever, p.shape))
    jacobian = np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), -skew(arm)], axis=2)
    covariance = rotate_covariance(jacobian, pose_covariance)
    if lever_covariance is not None:
        covariance = covariance + rotate_covariance(R, lever_covariance)
    return p + arm, covariance


def at_times(motion: SegmentSolution, signal: InertialSignal, at: FloatArray) -> States:  # at (N,) s
    """Pose and velocity at any times within the nodes: each node's state propagated forwards by the IMU."""
    first, last = np.searchsorted(motion.t, at[[0, -1]], side="right").tolist()
    motion = motion.of_nodes(slice(max(min(first, len(motion.t) - 1) - 1, 0), last + 1))
    nodes, gravity = motion.t, np.broadcast_to(motion.gravity, (len(motion.t), 3))
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
        h, g = delta.dt[a, None], gravity[rows]
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


def segment_at(motion: SegmentSolution, prepared: PreparedSegment, at: FloatArray) -> States:  # at (k,) s
    """Pose and velocity of an IMU that pauses at any times; orientation and all else nan without samples."""
    states = States.unknown(len(at))
    known = np.isfinite(motion.states.p[:, 0])
    offset = int(np.searchsorted(prepared.t, motion.t[0] - 1e-9))  # the motion may be of some nodes only
    for run in prepared.runs(motion.segment):
        mine = np.zeros_like(known)
        mine[max(run.first - offset, 0) : max(run.first + len(run.start.p) - offset, 0)] = True
        for nodes in runs(known & mine):
            ends = motion.t[[nodes.start, nodes.stop - 1]] + [0.0, 1e-9]
            inside = slice(*np.searchsorted(at, ends).tolist())
            if nodes.stop - nodes.start < 2 or inside.stop <= inside.start:
                continue
            part = motion.of_nodes(nodes)
            answer = at_times(part, run.signal, np.clip(at[inside], part.t[0], part.t[-1]))
            states.R[inside], states.p[inside], states.v[inside] = answer.R, answer.p, answer.v
    return states


def started_from(prepared: PreparedSegment, solution: Solution, before: PreparedSegment) -> PreparedSegment:
    """The segment with an earlier solution's motion as start values, where it has any."""
    inside = np.clip(prepared.t, solution.t[0], solution.t[-1])
    bodies = [replace(prepared.forearm, start=at_times(solution.forearm, before.forearm.signal, inside))]
    for run in prepared.bodies[1:]:
        start, motion = run.start, solution.of(run.segment)
        if motion is not None:
            states = segment_at(motion, before, prepared.t[run.first : run.first + len(run.start.p)])
            good = np.isfinite(states.p[:, 0])
            start = States(
                np.where(good[:, None, None], states.R, start.R),
                np.where(good[:, None], states.p, start.p),
                np.where(good[:, None], states.v, start.v),
            )
        bodies.append(replace(run, start=start))
    return replace(prepared, bodies=tuple(bodies), is_started=True)
