"""Solve one window: optimise its graph, read the answer and its covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import gtsam
import numpy as np
from gtsam.symbol_shorthand import G, S, U

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..errors import SolveError
from ..linalg import interpolate
from ..measurements.rays import AT_M, NEAREST_M
from ..units import GRAVITY
from ..window.draw_plan import DrawPlan
from ..window.problem import JointMeasurements, States, Window, joints_at_start
from ..window.shared import STRAP_PLACE, SharedLayout
from ..window.solution import BlockShift, SegmentSolution, Solution, Step
from .block_shifts import CameraBlocks
from .build import FactorGroup, bias_of_intervals, build, node_of_variables
from .error_columns import (
    constant_error_columns,
    evidence,
    is_place,
    offset_column,
    offset_information,
    stamp_columns,
)
from .linear_system import ExtraColumns, LinearSystem
from .optimise import Optimum, optimise
from .sampling import sample_window
from .scale import coordinates_by_pixels, with_scale_term
from .shared_prior import bias_keys, shared_jacobian, shared_keys
from .steps import StepColumns, moments
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
class WindowOptimum:
    """A window at its optimum: what a solution is read from; it does not travel between processes."""

    window: Window  # With what cameras without depth saw linearised there
    given: Window  # As it was given
    optimum: Optimum
    groups: Sequence[FactorGroup]  # Of its graph
    tighten: int  # Number of the tightening in `TIGHTEN` that it was found with
    tolerance: float  # That it was found with


def optimise_window(window: Window, tolerance: float = RELATIVE_TOLERANCE) -> WindowOptimum:
    """Optimise a window (see `optimise`)."""
    return _optimised(window, tolerance, 0)


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
        except np.linalg.LinAlgError:
            optimised = _optimised(optimised.given, optimised.tolerance, optimised.tighten + 1)


def _optimised(window: Window, tolerance: float, first: int) -> WindowOptimum:
    """A direction that is free but for the attitude prior can be too weak for the solver's precision."""
    for number in range(first, len(TIGHTEN)):
        try:
            return _descended(window, tolerance, number)
        except np.linalg.LinAlgError:
            continue
        except RuntimeError as error:
            if "ndetermin" not in str(error):
                raise
            continue
    raise SolveError(
        f"the motion between {window.t[0]:.1f} s and {window.t[-1]:.1f} s is not determined by what"
        " the camera saw there"
    )


def _descended(given: Window, tolerance: float, number: int) -> WindowOptimum:
    """The optimum at a tightening; keypoints are linearised anew until the joints stay where they are."""
    window, joints, values, coordinates = given, joints_at_start(given), None, 0.0
    for _ in range(MOST_LINEARISATIONS):
        window = given.linearised(joints)
        if coordinates:
            window = replace(window, priors=with_scale_term(window.priors, coordinates))
        built = build(_tightened(window, TIGHTEN[number]))
        optimum = optimise(*built, window, tolerance, values)
        if not given.has_rays:
            break
        before, joints, values = joints, _joints(optimum.values, given), optimum.values
        if given.lone_rays and not coordinates:
            coordinates = coordinates_by_pixels(optimum.graph, values, window, built.groups)
        elif all(_stay(before[key], place) for key, place in joints.items()):
            break
    return WindowOptimum(window, given, optimum, built.groups, number, tolerance)


def _joints(values: gtsam.Values, window: Window) -> dict[str, FloatArray]:
    """Where the joints are: at the samples' nodes by `JointMeasurements.key`, the shoulder at its knots."""
    states = {body.segment: body.states for body in _bodies(values, window, bias_of_intervals(window))}
    joints = {
        measured.key: _joint_at_nodes(values, measured, window, states)
        for measured in window.joint_measurements
    }
    if window.shoulder is not None:
        joints["shoulder"] = np.array([values.atPoint3(S(k)) for k in range(len(window.shoulder.node))])
    return joints


def _stay(before: FloatArray, after: FloatArray) -> bool:
    """Whether places (n, 3) of a joint changed by next to nothing."""
    return not len(before) or float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1)))) < SETTLED_M


def _joint_at_nodes(
    values: gtsam.Values, measured: JointMeasurements, window: Window, states: Mapping[str, States]
) -> FloatArray:
    known, keys = window.priors.layout.levers(measured.segment), keys_of(measured.segment)
    lever = values.atPoint3(keys.lever_of(measured.joint)) if measured.joint in known else np.zeros(3)
    own = states[measured.segment]
    return np.asarray(own.p[measured.node] + own.R[measured.node] @ lever)


def _read(
    optimised: WindowOptimum,
    with_covariance: bool,
    with_offset: bool,
    with_evidence: bool,
    plan: DrawPlan | None,
    with_blocks: bool = False,
) -> Solution:
    """The answer; raises LinAlgError where something is free."""
    window, optimum, tighten = optimised.window, optimised.optimum, TIGHTEN[optimised.tighten]
    graph, values, groups = optimum.graph, optimum.values, optimised.groups
    biases = bias_of_intervals(window)
    bodies = _bodies(values, window, biases)
    states = {body.segment: body.states for body in bodies}
    following, offset, draws = None, 0.0, None
    shifts: tuple[BlockShift, ...] = ()
    if with_covariance or with_evidence or with_offset:
        extra: list[ExtraColumns] = []
        if with_evidence or window.considered is not None:
            extra.append(
                partial(
                    constant_error_columns, window=window, groups=groups, biases=biases, R=bodies[0].states.R
                )
            )
        knots = _stamp_knots(window) if with_covariance else np.zeros(0)
        if len(knots):
            extra.append(partial(stamp_columns, window=window, groups=groups, states=states, knots=knots))
        if with_offset:
            extra.append(partial(offset_column, window=window, groups=groups, states=states))
        blocks = CameraBlocks.of(window, groups) if with_blocks else None
        if blocks is not None:
            extra.append(blocks.columns)
        system = LinearSystem(graph, values, node_of_variables(window), extra)
        shifts = () if blocks is None else blocks.shifts(system)
        following = _Following.of(system, values, window, biases, knots)
        if with_offset:
            offset = offset_information(system, system.extra_count - 1, window, states)
    if following is not None and with_covariance:
        bodies = [_with_covariance(body, following, window) for body in bodies]
        pose = bodies[0].pose_covariance
        assert pose is not None
        lost = _lost_to_tightening(pose[:, 3:, 3:], window, tighten)
        pose[:, 3:, 3:] += lost
        if plan is not None:
            draws = sample_window(following.system, values, window, biases, plan, following.shared, lost)
    shoulder, shoulder_covariance = _shoulder(values, following if with_covariance else None, window)
    shared = _shared(values, window, biases)
    return Solution(
        bodies=tuple(bodies),
        shoulder=shoulder,
        shoulder_covariance=shoulder_covariance,
        shared=shared,
        levers=_levers(shared, window.priors.layout),
        residuals=_residuals(values, window, states),
        iterations=optimum.iterations,
        error=optimum.error,
        offset_information=offset,
        accepted=optimum.accepted,
        evidence=(
            evidence(following.system, values, shared, optimised.given, biases)
            if following is not None and with_evidence
            else None
        ),
        draws=draws,
        shifts=shifts,
    )


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


def _bodies(values: gtsam.Values, window: Window, biases: IntArray) -> list[SegmentSolution]:
    """The solution of each IMU, read from the variables, without covariances."""
    poses, bodies, n = gtsam.utilities.extractPose3(values), [], len(window.t)
    gravity = window.priors.layout.down(_shared(values, window, biases)) * GRAVITY
    for name in window.priors.layout.segments:
        keys = keys_of(name)
        known = np.zeros(n, dtype=bool)
        for run in window.runs(name):
            known[run.nodes] = True
        own, poses = np.split(poses, [int(known.sum())])
        R, p, v = np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        R[known], p[known] = own[:, :9].reshape(-1, 3, 3), own[:, 9:]
        if known.any():
            v[known] = gtsam.utilities.extractVectors(values, chr(gtsam.Symbol(keys.velocity).chr()))
        bias = np.array([values.atConstantBias(keys.bias + k).vector() for k in range(int(biases[-1]) + 1)])
        states = States(R, p, v)
        bodies.append(SegmentSolution(name, window.t, states, bias[np.append(biases, biases[-1])], gravity))
    return bodies


def _stamp_knots(window: Window) -> FloatArray:
    """Times (m,) at which errors of made-up frame times are considered; none where they were measured."""
    if window.considered is None:
        return np.zeros(0)
    return window.considered.stamp_knots(float(window.t[0]), float(window.t[-1]))


@dataclass(frozen=True)
class _Following:
    """Covariances of a system's variables in time, with what they follow of considered errors."""

    system: LinearSystem
    shared: FloatArray | None
    covariance: FloatArray | None

    @classmethod
    def of(
        cls,
        system: LinearSystem,
        values: gtsam.Values,
        window: Window,
        biases: IntArray,
        knots: FloatArray,
    ) -> _Following:
        """With the window's considered errors, if any, and those of the frames' times at knots (m,)."""
        if window.considered is None:
            return cls(system, None, None)
        constant = len(window.considered.covariance)
        covariance = np.zeros((constant + len(knots), constant + len(knots)))
        covariance[:constant, :constant] = window.considered.covariance
        covariance[constant:, constant:] = window.considered.stamp_covariance(knots)
        jacobian = shared_jacobian(window.priors.layout, values.atUnit3(G(0)))
        # further IMUs add rows at the end, which the excerpts were solved without
        shared = np.zeros((window.priors.layout.size, len(covariance)))
        shared[: len(window.considered.shared), :constant] = window.considered.shared
        pull = np.zeros((system.extras.start, len(covariance)))
        pull[system.border_rows(shared_keys(window, biases))] = jacobian.T @ np.linalg.solve(
            window.priors.shared.covariance, shared
        )
        return cls(system, system.shared_sensitivity(pull), covariance)

    def of_variables(self, keys: Sequence[int], at_strap: bool = False) -> FloatArray:
        """Covariances (k, d, d) of variables in time, all of one dimension."""
        covariance = self.system.covariances(keys)
        if self.shared is None or self.covariance is None:
            return covariance
        follows = self.system.sensitivities(keys, self.shared)
        if at_strap:
            follows[:, 3:, STRAP_PLACE] += np.eye(3)  # its place is p + R l, and l may be l + dl
        return np.asarray(covariance + follows @ self.covariance @ np.swapaxes(follows, 1, 2))


def _with_covariance(body: SegmentSolution, following: _Following, window: Window) -> SegmentSolution:
    """The covariances of an IMU's states at the nodes, of (position, rotation) in {K}."""
    t, nodes, keys = window.t, _covariance_nodes(window), keys_of(body.segment)
    is_forearm = body.segment == FOREARM.name
    at_strap = is_forearm and any(is_place(each.joint, window) for each in window.joint_measurements)
    pose, velocity = np.full((len(t), 6, 6), np.nan), None
    for run in window.runs(body.segment):
        rows = np.arange(run.first, run.nodes.stop)
        own = np.union1d(nodes[(nodes >= rows[0]) & (nodes <= rows[-1])], rows[[0, -1]])
        in_body = following.of_variables([keys.pose + i for i in own.tolist()], at_strap)
        pose[rows] = interpolate(t[own], _in_camera(in_body, body.states.R[own]), t[rows])
    if is_forearm:
        velocities = following.of_variables([keys.velocity + i for i in nodes.tolist()])
        velocity = interpolate(t[nodes], velocities, t)
    return replace(body, pose_covariance=pose, velocity_covariance=velocity)


def _in_camera(covariance: FloatArray, R: FloatArray) -> FloatArray:
    """From GTSAM's (rotation, translation) in the body's axes to (position, rotation) in {K}, (n, 6, 6)."""
    order = np.array([3, 4, 5, 0, 1, 2])
    body = covariance[:, order][:, :, order]
    turn = np.zeros((len(R), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = R
    return np.asarray(turn @ body @ np.swapaxes(turn, 1, 2))


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


def _shoulder(
    values: gtsam.Values, following: _Following | None, window: Window
) -> tuple[FloatArray | None, FloatArray | None]:
    if window.shoulder is None:
        return None, None
    t = window.t[window.shoulder.node]
    position = interpolate(t, np.array([values.atPoint3(S(k)) for k in range(len(t))]), window.t)
    if following is None:
        return position, None
    apart_s = CHAIN_COVARIANCE_S if window.reaches_shoulder else SHOULDER_COVARIANCE_S
    knots = _spaced(t, np.zeros(len(t) - 1, dtype=bool), apart_s)
    covariance = following.of_variables([S(k) for k in knots])
    return position, interpolate(t[knots], covariance, window.t)


def _shared(values: gtsam.Values, window: Window, biases: IntArray) -> FloatArray:
    """The shared quantities as one vector (s,)."""
    layout = window.priors.layout
    mean = np.empty(layout.size)
    mean[layout.gravity] = layout.gravity_axes @ values.atUnit3(G(0)).point3()
    if layout.has_upper_arm:
        # the factor's error is range + U - length: the true length is shorter by U
        mean[layout.upper_arm] = window.priors.shared.mean[layout.upper_arm] - values.atDouble(U(0))
    for segment, bias in zip(layout.segments, bias_keys(layout, shared_keys(window, biases)), strict=True):
        mean[layout.bias_of(segment)] = values.atConstantBias(bias).vector()
        for joint, rows in layout.levers(segment).items():
            mean[rows] = values.atPoint3(keys_of(segment).lever_of(joint))
    return mean


def _levers(shared: FloatArray, layout: SharedLayout) -> dict[str, FloatArray]:
    """Lever arms (3,) m by joint, each in the axes of the IMU that the joint is tied to."""
    levers = {joint: shared[layout.lever(joint)] for joint in layout.joints}
    for name in layout.further:
        rows_of = layout.levers(name)
        levers |= {
            joint: shared[rows_of[joint]] for joint in SEGMENTS[name].camera_joints if joint in rows_of
        }
    return levers


def _residuals(values: gtsam.Values, window: Window, states: Mapping[str, States]) -> dict[str, FloatArray]:
    """Camera minus answer by `JointMeasurements.key`; of cameras without depth across rays, at `AT_M`."""
    residuals = {}
    for measured in window.joint_measurements:
        answer = _joint_at_nodes(values, measured, window, states)
        residual, rays = measured.position - measured.shift - answer, measured.rays
        if rays is not None and measured.origin_m is not None:
            residual = residual - np.sum(residual * rays, axis=1, keepdims=True) * rays
            distance = np.linalg.norm(answer + measured.shift - measured.origin_m, axis=1)
            residual *= AT_M / np.maximum(distance, NEAREST_M)[:, None]
        residuals[measured.key] = residual
    return residuals


def steps_of(optimised: WindowOptimum) -> tuple[Step, ...]:
    """What may have changed for good within a window that is at its optimum."""
    window, values, groups = optimised.window, optimised.optimum.values, optimised.groups
    at_s = moments(window)
    if not len(at_s):
        return ()
    biases = bias_of_intervals(window)
    states = {body.segment: body.states for body in _bodies(values, window, biases)}
    levers = _levers(_shared(values, window, biases), window.priors.layout)
    columns = StepColumns(window, groups, states, levers, _shoulder(values, None, window)[0], at_s)
    errors = partial(
        constant_error_columns, window=window, groups=groups, biases=biases, R=states[FOREARM.name].R
    )
    extra: list[ExtraColumns] = [columns] if window.considered is None else [errors, columns]
    try:
        system = LinearSystem(optimised.optimum.graph, values, node_of_variables(window), extra)
    except np.linalg.LinAlgError:
        return ()
    return tuple(columns.steps(system))
