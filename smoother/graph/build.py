"""The factor graph of one window (GTSAM), in the camera's frame with gravity's direction unknown.

Variables: X pose `T_K_A` and V velocity a node, B bias every few seconds, L lever arms of the joints in {A};
an IMU on another segment of the arm has its own of each, by the letters of `body.SEGMENTS` (on the upper arm
Y, W, C and M), and E the joint that it shares with its parent. G gravity's direction, S shoulder knots, U
correction of the upper-arm length. All factors are GTSAM's own; see each function for the class.

Two rigid bodies share a joint, and the upper arm ends in the shoulder, so that an error of position does not
grow with the time that the camera sees nothing of the forearm. Soft tissue moves an IMU against its bone;
that is the sigma of the joints in its axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam import Pose3, Rot3, Unit3, noiseModel
from gtsam.symbol_shorthand import S

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..linalg import runs, unit
from ..measurements.rays import squashed
from ..window.problem import JointMeasurements, SegmentRun, Window
from .factors import (
    IMU_ROWS,
    POINT_ROWS,
    TISSUE_S,
    constant_velocity,
    imu_factors,
    isotropic,
    joint_factor,
    knot_walk,
    length_factor,
    robust,
    robust_across,
    shared_joint,
    shoulder_end,
    tissue_sigma,
)
from .shared_prior import shared_factors
from .variables import keys_of, node_keys

#: How fast an arm moves whose sensor lies still, m/s per axis.
REST_SPEED = 0.01
#: A bias variable for about this long, s: one for a recording is too stiff to follow scale errors.
BIAS_LENGTH_S = 4.0
#: A window has no more of them: they are used in every step of the solution. In gaps of minutes, where alone
#: windows are that long, the arm's reach says more than the integrated IMU.
MOST_BIASES = 24


def bias_of_intervals(window: Window) -> IntArray:
    """Which bias variable each of a window's intervals uses, (n - 1,)."""
    duration = window.t[-1] - window.t[0]
    count = min(max(1, round(duration / BIAS_LENGTH_S)), MOST_BIASES)
    middle = 0.5 * (window.t[1:] + window.t[:-1]) - window.t[0]
    return np.minimum((middle / duration * count).astype(int), count - 1)


def node_of_variables(window: Window) -> dict[int, int]:
    """The node whose time each of a window's variables in time has, by key."""
    nodes: dict[int, int] = {}
    if window.shoulder is not None:
        nodes |= {S(k): int(node) for k, node in enumerate(window.shoulder.node)}
    for run in window.bodies:
        nodes |= {key: i for i in range(run.first, run.nodes.stop) for key in node_keys(run.segment, i)}
    return nodes


@dataclass(frozen=True)
class FactorGroup:
    """Factors of one kind that follow each other in a graph."""

    kind: str  # What they are, as "camera"
    of: str  # The joint or the segment that they are about
    factors: range  # Their numbers in the graph
    rows: slice  # Their rows in its whitened Jacobian
    nodes: IntArray  # int (m,): the node of each; empty where they have none
    camera: int = 0  # The camera whose samples they are


class WindowGraph(NamedTuple):
    """A window's graph."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values  # Initial ones, of every variable
    groups: list[FactorGroup]  # Of all factors, in their order

    def add(
        self,
        kind: str,
        of: str,
        factors: Iterable[gtsam.NonlinearFactor],
        dimension: int,
        nodes: Sequence[int] | IntArray = (),
        camera: int = 0,
    ) -> None:
        """Add factors, each with this many rows, and record where they are."""
        first, row = self.graph.size(), self.groups[-1].rows.stop if self.groups else 0
        for factor in factors:
            self.graph.add(factor)
        added = range(first, self.graph.size())
        rows = slice(row, row + dimension * len(added))
        self.groups.append(FactorGroup(kind, of, added, rows, np.asarray(nodes, dtype=int), camera))


def build(window: Window) -> WindowGraph:
    """The graph of a window with all of its IMUs, and its initial values."""
    built = WindowGraph(gtsam.NonlinearFactorGraph(), gtsam.Values(), [])
    biases = bias_of_intervals(window)
    forearm = window.forearm
    _add_imu(built, window, forearm, biases)
    _add_joints(built, window)
    if window.shoulder is not None:
        _add_shoulder(built, window)
    _add_constant_velocity(built, window)
    _add_rest(built, window)
    _add_attitude(built, forearm)
    _add_field(built, window)
    for group in shared_factors(built.values, window, biases):
        built.add(*group)
    for run in window.further:
        _add_imu(built, window, run, biases)
        _add_shared_joint(built, window, run)
        _add_shoulder_end(built, window, run)
        _add_attitude(built, run)
    return built


def _add_imu(built: WindowGraph, window: Window, run: SegmentRun, biases: IntArray) -> None:
    """States of an IMU at its nodes, and `ImuFactorWithGravityDirection` between neighbours."""
    keys, start = keys_of(run.segment), run.start
    for i, (R, p, v) in enumerate(zip(start.R, start.p, start.v, strict=True), run.first):
        built.values.insert(keys.pose + i, Pose3(Rot3(R), p))
        built.values.insert(keys.velocity + i, v)
    nodes = range(run.first, run.nodes.stop - 1)
    between = ((i, i + 1, bias) for i, bias in zip(nodes, biases[nodes].tolist(), strict=True))
    factors = imu_factors(run.segment, between, run.increments, np.diff(window.t[run.nodes]), window.noise)
    built.add("imu", run.segment, factors, IMU_ROWS, nodes)


def _add_joints(built: WindowGraph, window: Window) -> None:
    """`GPSFactorArmCalib` (the lever arm is a variable) or `GPSFactorArm` at the IMU itself."""
    cauchy = window.noise.cauchy
    for measured in window.joint_measurements:
        keys, known = keys_of(measured.segment), window.priors.layout.levers(measured.segment)
        lever = keys.lever_of(measured.joint) if measured.joint in known else None
        nodes, positions, sigmas = stacked_measurements(measured, cauchy)
        roots = ray_roots(measured, nodes, sigmas)
        models = (
            (robust(sigma, cauchy) for sigma in sigmas.tolist())
            if roots is None
            else (robust_across(root, cauchy) for root in roots)
        )
        factors = [
            joint_factor(keys.pose + node, lever, position, model)
            for node, position, model in zip(nodes.tolist(), positions, models, strict=True)
        ]
        built.add("camera", measured.joint, factors, POINT_ROWS, nodes, measured.camera)


def ray_roots(measured: JointMeasurements, nodes: IntArray, sigmas: FloatArray) -> FloatArray | None:
    """Square roots of information (m, 3, 3) of a joint's stacked samples; None of a camera with depth."""
    rays = measured.rays
    if rays is None:
        return None
    if len(nodes) < len(rays):
        total = np.zeros((len(nodes), 3))
        np.add.at(total, np.searchsorted(nodes, measured.node), rays)
        rays = unit(total)
    return squashed(rays, sigmas)


def stacked_measurements(
    measured: JointMeasurements, cauchy: float
) -> tuple[IntArray, FloatArray, FloatArray]:  # node int (m,), position (m, 3) m, sigma_m (m,) m
    """A joint's samples node by node."""
    at_node = measured.position - measured.shift
    node, first, count = np.unique(measured.node, return_index=True, return_counts=True)
    if len(node) == len(measured.node):
        return measured.node, at_node, measured.sigma_m
    rank = np.arange(len(measured.node)) - np.repeat(first, count)
    group = np.repeat(np.arange(len(node)), count)
    table = np.full((len(node), int(count.max()), 3), np.inf)  # short groups: the rest sorts last
    table[group, rank] = at_node
    table.sort(axis=1)
    median = table[np.arange(len(node)), (count - 1) // 2]
    off = np.linalg.norm(at_node - median[group], axis=1) / measured.sigma_m
    off[np.repeat(count, count) < 3] = 0.0  # two cannot outvote each other
    weight = 1.0 / (1.0 + (off / cauchy) ** 2) / measured.sigma_m**2
    total = np.bincount(group, weight)
    mean = np.stack([np.bincount(group, weight * at_node[:, axis]) for axis in range(3)], axis=1)
    return node, mean / total[:, None], np.round(1.0 / np.sqrt(total), 6)


def _add_shoulder(built: WindowGraph, window: Window) -> None:
    """Smooth knots (`BetweenFactorPoint3`), camera samples (`PriorFactorPoint3`), the upper arm's length."""
    shoulder, noise = window.shoulder, window.noise
    assert shoulder is not None
    nodes = np.asarray(shoulder.node)
    for k, start in enumerate(shoulder.start):
        built.values.insert(S(k), start)
    seen = np.flatnonzero(np.isfinite(shoulder.position[:, 0]))
    roots = shoulder.root_information
    positions = (
        gtsam.PriorFactorPoint3(
            S(k),
            shoulder.position[k],
            robust(float(shoulder.sigma_m[k]), noise.cauchy)
            if roots is None
            else robust_across(roots[k], noise.cauchy),
        )
        for k in seen.tolist()
    )
    built.add("camera", "shoulder", positions, POINT_ROWS, nodes[seen])
    walks = (
        knot_walk(k, k + 1, noise.shoulder_walk, length)
        for k, length in enumerate(np.sqrt(np.diff(window.t[nodes])).tolist())
    )
    built.add("knot walk", "shoulder", walks, POINT_ROWS, nodes[1:])
    if not len(seen):
        held = gtsam.PriorFactorPoint3(S(0), shoulder.start[0], isotropic(3, 1.0))
        built.add("held knot", "shoulder", [held], POINT_ROWS, nodes[:1])
    if window.priors.layout.has_upper_arm:
        lengths = upper_arm_factors(window, upper_arm_sigmas(window))
        built.add("length", "upper_arm", lengths, 1, nodes)


#: In postures whose forearms differ by less than about this, rad, the skeleton's upper arm is off by the same
#: length: with 10, 15 and 30 degrees arms held for 30 and 60 s are recovered alike.
SAME_POSTURE = np.radians(10.0)


def upper_arm_sigmas(window: Window) -> FloatArray:
    """How far from constant the upper arm's length is at the shoulder's knots (k,), m.

    The error is the same throughout a posture: all knots of a gap in one posture weigh as much as one.
    """
    assert window.shoulder is not None
    in_gap = np.isfinite(window.velocity_change)
    nodes, R = np.asarray(window.shoulder.node), window.forearm.start.R
    sigma = np.full(len(nodes), window.noise.upper_arm_sigma_m)
    for gap in runs(in_gap):
        inside = (nodes >= gap.start) & (nodes <= gap.stop)
        flat = R[nodes[inside]].reshape(-1, 9)
        half_turn = np.clip((3.0 - flat @ flat.T) / 4.0, 0.0, 1.0)  # sin^2 of half of the angle between
        alike = np.exp(-2.0 * half_turn / SAME_POSTURE**2)
        sigma[inside] *= np.sqrt(alike.sum(axis=1))
    return sigma


def upper_arm_factors(
    window: Window,
    sigma_m: FloatArray,
    knots: IntArray | None = None,  # sigma_m (k,) m; knots int (k,)
) -> Iterator[gtsam.RangeFactorWithTransformBias3D]:
    """The elbow's distance from shoulder knots; the length's correction is the variable U."""
    assert window.shoulder is not None
    layout, mean = window.priors.layout, window.priors.shared.mean
    length, elbow = float(mean[layout.upper_arm][0]), mean[layout.lever("elbow")]
    nodes = np.asarray(window.shoulder.node)
    knots = np.arange(len(nodes)) if knots is None else knots
    for knot, node, sigma in zip(knots.tolist(), nodes[knots].tolist(), sigma_m.tolist(), strict=True):
        yield length_factor(node, knot, length, sigma, elbow)


def _add_constant_velocity(built: WindowGraph, window: Window) -> None:
    """`BetweenFactorVector` on the velocities inside gaps: a still arm keeps its velocity."""
    nodes = np.flatnonzero(np.isfinite(window.velocity_change))
    factors = (constant_velocity(i, float(window.velocity_change[i])) for i in nodes.tolist())
    built.add("constant velocity", FOREARM.name, factors, 3, nodes)


def _add_rest(built: WindowGraph, window: Window) -> None:
    """`PriorFactorVector`: no velocity in gaps where the sensor lies still, robust as a chair may roll."""
    velocity, model = keys_of(FOREARM.name).velocity, robust(REST_SPEED, window.noise.cauchy)
    rests = (gtsam.PriorFactorVector(velocity + i, np.zeros(3), model) for i in window.still.tolist())
    built.add("rest", FOREARM.name, rests, 3, window.still)


def _add_attitude(built: WindowGraph, run: SegmentRun) -> None:
    """`PoseRotationPrior3D`: the initial orientation, weakly, at one node."""
    R, node = run.attitude, run.first + run.attitude_node
    model = noiseModel.Gaussian.Covariance(R.T @ run.attitude_covariance @ R)
    prior = gtsam.PoseRotationPrior3D(keys_of(run.segment).pose + node, Rot3(R), model)
    built.add("attitude", run.segment, [prior], 3, [node])


def _add_field(built: WindowGraph, window: Window) -> None:
    """`AttitudeFactorPose3`: a calibrated magnetometer's directions, robust against a magnet near one."""
    if window.field is None:
        return
    field, pose = window.field, keys_of(FOREARM.name).pose
    loss = noiseModel.mEstimator.Cauchy.Create(window.noise.cauchy)
    model = noiseModel.Robust.Create(loss, isotropic(2, round(field.sigma_rad, 5)))
    factors = (
        gtsam.AttitudeFactorPose3(pose + node, Unit3(field.in_K), model, Unit3(in_A))
        for node, in_A in zip(field.node.tolist(), field.in_A, strict=True)
    )
    built.add("magnetic field", FOREARM.name, factors, 2, field.node)


def _add_shared_joint(built: WindowGraph, window: Window, run: SegmentRun) -> None:
    """`ReferenceFrameFactorPoint3Pose3` (lever, pose, point): one point on the segment and its parent."""
    lever = window.priors.layout.lever(SEGMENTS[run.segment].shared_joint, run.segment)
    nodes, point = np.arange(run.first, run.nodes.stop), keys_of(run.segment).point
    places = run.start.p + run.start.R @ window.priors.shared.mean[lever]
    for node, place in zip(nodes.tolist(), places, strict=True):
        built.values.insert(point + node, place)
    ties = zip(nodes.tolist(), _tissue(window, run, nodes), strict=True)
    factors = (factor for node, sigma_m in ties for factor in shared_joint(run.segment, node, sigma_m))
    built.add("shared joint", run.segment, factors, POINT_ROWS, np.repeat(nodes, 2))


def _add_shoulder_end(built: WindowGraph, window: Window, run: SegmentRun) -> None:
    """`ReferenceFrameFactorPoint3Pose3`: a segment that reaches the shoulder ends in its knots."""
    if window.shoulder is None or "shoulder" not in SEGMENTS[run.segment].joints:
        return
    knots = np.asarray(window.shoulder.node)
    tissue = _tissue(window, run, knots)
    inside = np.flatnonzero((knots >= run.first) & (knots < run.nodes.stop))
    ends = (shoulder_end(run.segment, int(knots[k]), k, tissue[k]) for k in inside.tolist())
    built.add("shoulder end", run.segment, ends, POINT_ROWS, knots[inside])


def _tissue(window: Window, run: SegmentRun, nodes: IntArray) -> list[float]:
    """Sigma of a joint in the IMU's axes at nodes (k,)."""
    step_s = np.gradient(window.t[nodes]) if len(nodes) > 1 else np.full(len(nodes), TISSUE_S)
    return np.asarray(tissue_sigma(window.noise, run.segment, step_s)).tolist()
