"""Solve one window: optimise its graph, read the answer and its covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from gtsam.symbol_shorthand import S

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import FOREARM
from ..errors import SolveError
from ..linalg import interpolate, skew
from ..window.draw_plan import DrawPlan
from ..window.problem import Window, joints_at_start
from ..window.shared import STRAP_PLACE
from ..window.solution import SegmentSolution, Solution
from .build import build
from .changes import Cells, block_columns, block_shifts
from .columns import constant_error_columns, evidence, is_place, offset_information, stamp_columns
from .linear_system import LinearSystem
from .optimise import Optimum, optimise
from .sampling import sample_window
from .scale import coordinates_by_pixels, with_scale_term
from .solved import SolvedWindow, levers_of
from .variables import keys_of

#: Where `solve` stops by default.
RELATIVE_TOLERANCE = 1e-4
#: Sigmas of the attitude prior that are tried one after the other, as shares of it: the solver calls a
#: direction free once its square-root information is 4096 times weaker than its neighbour's.
TIGHTEN = (1.0, 0.3, 0.1, 0.03)
#: What cameras without depth saw is linearised at most so often; no more once joints moved by less, m rms.
MOST_LINEARISATIONS, SETTLED_M = 8, 0.004
#: Spacing of the covariances that are computed rather than interpolated, s.
COVARIANCE_S = 0.5
COVARIANCE_NEAR_S = 0.1
NEAR_S = 0.5
SHOULDER_COVARIANCE_S = 0.1
#: The same near gaps, in them and for the shoulder where IMUs reach up to it, s.
CHAIN_COVARIANCE_S = 0.25


@dataclass(frozen=True)
class WindowOptimum(SolvedWindow):
    """A window at its optimum: what a solution is read from."""

    given: Window  # As it was given
    optimum: Optimum
    tighten: int  # Number of the tightening in `TIGHTEN` that it was found with
    tolerance: float  # That it was found with


def optimise_window(window: Window, tolerance: float = RELATIVE_TOLERANCE, first: int = 0) -> WindowOptimum:
    """Optimise a window, from a number of the tightenings on (see `optimise`).

    A direction that is free but for the attitude prior can be too weak for the solver's precision.
    """
    for number in range(first, len(TIGHTEN)):
        try:
            return _descended(window, tolerance, number)
        except np.linalg.LinAlgError:
            continue
        except RuntimeError as error:
            if "ndetermin" not in str(error):
                raise
    raise SolveError(
        f"the motion between {window.t[0]:.1f} s and {window.t[-1]:.1f} s is not determined by what"
        " the camera saw there"
    )


def solve(
    window: Window,
    with_covariance: bool,
    with_offset: bool = False,
    with_evidence: bool = False,
    tolerance: float = RELATIVE_TOLERANCE,
    plan: DrawPlan | None = None,
) -> Solution:
    """Optimise a window and read its answer: `optimise_window` and `solution_of`, with their parameters."""
    optimised = optimise_window(window, tolerance)
    return solution_of(optimised, with_covariance, with_offset, with_evidence, plan)


def solution_of(
    optimised: WindowOptimum,
    with_covariance: bool,
    with_offset: bool = False,
    with_evidence: bool = False,
    plan: DrawPlan | None = None,
    with_blocks: bool = False,
) -> Solution:
    """Read the answer of a window that is at its optimum."""
    while True:
        try:
            return _read(optimised, with_covariance, with_offset, with_evidence, plan, with_blocks)
        except np.linalg.LinAlgError:  # something is free
            optimised = optimise_window(optimised.given, optimised.tolerance, optimised.tighten + 1)


def _descended(given: Window, tolerance: float, number: int) -> WindowOptimum:
    """The optimum at a tightening; keypoints are linearised anew until the joints stay where they are."""
    window, joints, values, coordinates = given, joints_at_start(given), None, 0.0
    for _ in range(MOST_LINEARISATIONS):
        window = given.linearised(joints)
        if coordinates:
            window = replace(window, priors=with_scale_term(window.priors, coordinates))
        built = build(_tightened(window, TIGHTEN[number]))
        optimum = optimise(*built, window, tolerance, values)
        at = SolvedWindow(window, optimum.graph, optimum.values, built.groups)
        if not given.has_rays:
            break
        before, joints, values = joints, replace(at, window=given).joints(), optimum.values
        if given.lone_rays and not coordinates:
            coordinates = coordinates_by_pixels(at)
        elif all(_stay(before[key], place) for key, place in joints.items()):
            break
    return WindowOptimum(window, at.graph, at.values, at.groups, given, optimum, number, tolerance)


def _stay(before: FloatArray, after: FloatArray) -> bool:
    """Whether places (n, 3) of a joint changed by next to nothing."""
    return not len(before) or float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1)))) < SETTLED_M


def _read(
    optimised: WindowOptimum,
    with_covariance: bool,
    with_offset: bool,
    with_evidence: bool,
    plan: DrawPlan | None,
    with_blocks: bool,
) -> Solution:
    """The answer; raises LinAlgError where something is free."""
    window, optimum = optimised.window, optimised.optimum
    solution = Solution(
        bodies=tuple(optimised.bodies),
        shoulder=optimised.shoulder,
        shoulder_covariance=None,
        shared=optimised.shared,
        levers=levers_of(optimised.shared, window.priors.layout),
        residuals=optimised.residuals(),
        iterations=optimum.iterations,
        error=optimum.error,
        accepted=optimum.accepted,
    )
    if not (with_covariance or with_evidence or with_offset):
        return solution
    considered, knots, extra = window.considered, np.zeros(0), []
    if with_covariance and considered is not None:
        knots = considered.stamp_knots(float(window.t[0]), float(window.t[-1]))
    if with_evidence or considered is not None:
        extra.append(constant_error_columns(optimised))
    if len(knots):
        extra.append(stamp_columns(optimised, knots))
    if with_offset:
        offset_column = sum(columns.shape[1] for columns in extra)
        extra.append(stamp_columns(optimised))
    if with_blocks:
        cells = Cells.of_window(window)
        extra.append(block_columns(optimised, cells))
    in_common = window.noise.in_common if with_covariance else 1.0
    if in_common == 1.0 or with_blocks or with_offset or with_evidence:
        system = optimised.system(extra)
    if with_blocks:
        solution = replace(solution, shifts=tuple(block_shifts(system, considered, cells)))
    if with_offset:
        information = offset_information(optimised, system, offset_column)
        solution = replace(solution, offset_information=information)
    if with_evidence:
        found = evidence(optimised, system, optimised.given.priors.shared)
        solution = replace(solution, evidence=found)
    if with_covariance:
        if in_common != 1.0:  # covariances alone count what a camera's joints err together
            system = optimised.system(extra, in_common)
        _consider(optimised, system, knots)
        bodies = [_with_covariance(body, system, window, optimised.shared) for body in optimised.bodies]
        pose = bodies[0].pose_covariance
        assert pose is not None
        lost = _lost_to_tightening(pose[:, 3:, 3:], window, TIGHTEN[optimised.tighten])
        pose[:, 3:, 3:] += lost
        draws = None if plan is None else sample_window(optimised, system, plan, lost)
        shoulder = _shoulder_covariance(system, window)
        solution = replace(solution, bodies=tuple(bodies), shoulder_covariance=shoulder, draws=draws)
    return solution


def _tightened(window: Window, tighten: float) -> Window:
    """The window with its attitude priors' sigmas times `tighten`."""
    bodies = (replace(run, attitude_covariance=run.attitude_covariance * tighten**2) for run in window.bodies)
    return replace(window, bodies=tuple(bodies))


def _lost_to_tightening(rotation: FloatArray, window: Window, tighten: float) -> FloatArray:
    """What tightening took from the attitude's covariance (3, 3) in {K} where only the prior holds it."""
    forearm = window.forearm
    used, axes = np.linalg.eigh(forearm.attitude_covariance * tighten**2)
    stated = np.einsum("ia,ij,ja->a", axes, rotation[forearm.attitude_node], axes)
    missing = np.where(stated > 0.5 * used, used / tighten**2 - used, 0.0)
    return (axes * missing) @ axes.T


def _consider(optimised: WindowOptimum, system: LinearSystem, knots: FloatArray) -> None:
    """Count the window's considered errors, and those of the frames' times at knots (m,)."""
    considered, priors = optimised.window.considered, optimised.window.priors
    if considered is None:
        return
    constant = len(considered.covariance)
    covariance = np.zeros((constant + len(knots), constant + len(knots)))
    covariance[:constant, :constant] = considered.covariance
    covariance[constant:, constant:] = considered.stamp_covariance(knots)
    # further IMUs add rows at the end, which the excerpts were solved without
    shared = np.zeros((priors.layout.size, len(covariance)))
    shared[: len(considered.shared), :constant] = considered.shared
    pull = np.zeros((system.extras.start, len(covariance)))
    told = np.linalg.solve(priors.shared.covariance, shared)
    pull[system.border_rows(optimised.shared_keys)] = optimised.shared_jacobian.T @ told
    system.consider(covariance, pull)


def _with_covariance(
    body: SegmentSolution, system: LinearSystem, window: Window, shared: FloatArray
) -> SegmentSolution:
    """The covariances of an IMU's states at the nodes, and of joints that have a lever arm on it."""
    t, keys, is_forearm = window.t, keys_of(body.segment), body.segment == FOREARM.name
    nodes, at_strap = _covariance_nodes(window), None
    is_strap = is_forearm and any(is_place(each.joint, window) for each in window.joint_measurements)
    if is_strap and system.considered is not None:
        at_strap = np.zeros((6, len(system.considered)))
        at_strap[3:, STRAP_PLACE] = np.eye(3)  # its place is p + R l, and l may be l + dl
    levers = {joint: shared[rows] for joint, rows in window.priors.layout.levers(body.segment).items()}
    pose, velocity = np.full((len(t), 6, 6), np.nan), None
    joints = {joint: np.full((len(t), 3, 3), np.nan) for joint in levers}
    for run in window.runs(body.segment):
        rows = np.arange(run.first, run.nodes.stop)
        own = np.union1d(nodes[(nodes >= rows[0]) & (nodes <= rows[-1])], rows[[0, -1]])
        poses = [keys.pose + i for i in own.tolist()]
        in_body = system.covariances(poses, own_follow=at_strap)
        pose[rows] = interpolate(t[own], _in_camera(in_body, body.states.R[own]), t[rows])
        for joint, lever in levers.items():
            # p + R l in the IMU's axes follows the pose's columns, turn and place, by this
            slope = np.concatenate([-skew(lever), np.eye(3)], axis=1)
            at_end = system.end_covariances(poses, slope, keys.lever_of(joint))
            joints[joint][rows] = interpolate(t[own], at_end, t[rows])
    if is_forearm:
        velocities = system.covariances([keys.velocity + i for i in nodes.tolist()])
        velocity = interpolate(t[nodes], velocities, t)
    return replace(body, pose_covariance=pose, velocity_covariance=velocity, joint_covariance=joints)


def _in_camera(covariance: FloatArray, R: FloatArray) -> FloatArray:
    """From GTSAM's (rotation, translation) in the body's axes to (position, rotation) in {K}, (n, 6, 6)."""
    order = np.array([3, 4, 5, 0, 1, 2])
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    return np.asarray(turn @ covariance[:, order][:, :, order] @ np.swapaxes(turn, 1, 2))


def _shoulder_covariance(system: LinearSystem, window: Window) -> FloatArray | None:
    if window.shoulder is None:
        return None
    t = window.t[window.shoulder.node]
    apart_s = CHAIN_COVARIANCE_S if window.reaches_shoulder else SHOULDER_COVARIANCE_S
    knots = _spaced(t, np.zeros(len(t) - 1, dtype=bool), apart_s)
    return interpolate(t[knots], system.covariances([S(k) for k in knots]), window.t)


def _covariance_nodes(window: Window) -> IntArray:
    """Where a window's covariance is computed; a chain up to the shoulder hardly changes it over a gap."""
    near_s = CHAIN_COVARIANCE_S if window.reaches_shoulder else COVARIANCE_NEAR_S
    return _spaced(window.t, np.isfinite(window.velocity_change), COVARIANCE_S, near_s)


def _spaced(t: FloatArray, in_gap: BoolArray, apart_s: float, near_s: float = COVARIANCE_NEAR_S) -> IntArray:
    """Nodes at about this spacing, finer in and near gaps (intervals `in_gap`), where covariances change."""

    def every(step_s: float) -> BoolArray:
        chosen: BoolArray = np.diff(np.floor((t - t[0]) / step_s + 1e-6), prepend=-1.0) > 0
        return chosen

    chosen = every(apart_s)
    chosen[-1] = True
    edge = np.flatnonzero(np.diff(in_gap, prepend=False, append=False))  # nodes where gaps begin and end
    if len(edge):
        chosen[edge] = True
        after = np.clip(np.searchsorted(t[edge], t), 0, len(edge) - 1)
        near = np.minimum(np.abs(t[edge][after] - t), np.abs(t - t[edge][np.maximum(after - 1, 0)]))
        inside = np.append(in_gap, False) | np.append(False, in_gap)
        chosen |= (inside | (near < NEAR_S)) & every(near_s)
    return np.flatnonzero(chosen)
