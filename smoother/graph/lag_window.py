"""The window of the last moments, solved anew with every frame; what left it stays as a Gaussian (GTSAM).

Nodes inside may still be changed: a late frame or IMU sample costs no more than one in time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from ..array_types import FloatArray
from ..body import FOREARM
from ..recording import JOINTS
from ..window.problem import ImuIncrements, NoiseModel, Priors
from ..window.shared import SharedLayout
from ..window.solution import LagSolution, NodeState
from .factors import (
    constant_velocity,
    imu_factor,
    isotropic,
    joint_factor,
    knot_walk,
    length_factor,
    noise_levels,
    preintegrate,
    preintegration_parameters,
    robust,
)
from .lag_elimination import LagIteration, iterate, marginalise, split
from .shared_prior import (
    bias_walk,
    gravity_axes,
    have_turned,
    insert_constants,
    prior_factor,
    turned_with_axes,
)
from .variables import keys_of

#: Before any frame a first node is known so well: rad, m, m/s.
FIRST_TURN_RAD, FIRST_POSITION_M, FIRST_VELOCITY = 0.5, 0.5, 1.5


@dataclass
class LagNode:
    """A node with its factors.

    Attributes
    ----------
    number : int
        Of its variables.
    t : float, s
    epoch : int
        Number of its bias variable.
    imu : gtsam.NonlinearFactor or None
        The IMU's from the node before it.
    camera : list of gtsam.NonlinearFactor
        What the camera saw at it.
    others : list of gtsam.NonlinearFactor
        All others at it.
    """

    number: int
    t: float
    epoch: int
    imu: gtsam.NonlinearFactor | None = None
    camera: list[gtsam.NonlinearFactor] = field(default_factory=list)
    others: list[gtsam.NonlinearFactor] = field(default_factory=list)

    @property
    def factors(self) -> list[gtsam.NonlinearFactor]:
        """The IMU's first."""
        return ([] if self.imu is None else [self.imu]) + self.camera + self.others


class LagFactors:
    """Makes the factors of a lag window.

    Parameters
    ----------
    priors : Priors
        On the shared quantities.
    noise : NoiseModel
    sigma_m : ndarray, shape (5,), m
        Noise of the camera's joints, per axis.
    gravity_magnitude : float, m/s^2
    """

    def __init__(
        self, priors: Priors, noise: NoiseModel, sigma_m: FloatArray, gravity_magnitude: float
    ) -> None:
        self._noise, self._sigma_m, self._g = noise, sigma_m, gravity_magnitude
        self._walk = priors.bias_walk
        layout, mean = priors.layout, priors.shared.mean
        self._joints, self._has_upper_arm = layout.joints, layout.has_upper_arm
        self._upper_arm_m = float(mean[layout.upper_arm].sum())
        self._elbow = mean[layout.lever("elbow")] if layout.has_upper_arm else np.zeros(3)
        self._keys = keys_of(FOREARM.name)
        self._params: dict[tuple[int, int], gtsam.PreintegrationParams] = {}

    def first(self, number: int, state: NodeState) -> list[gtsam.NonlinearFactor]:
        """Wide priors on the first node, `PriorFactorPose3` and `PriorFactorVector`."""
        model = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FIRST_TURN_RAD, FIRST_POSITION_M], 3))
        pose = Pose3(Rot3(state.R), state.p)
        return [
            gtsam.PriorFactorPose3(X(number), pose, model),
            gtsam.PriorFactorVector(V(number), state.v, isotropic(3, FIRST_VELOCITY)),
        ]

    def imu(self, before: LagNode, node: LagNode, increments: ImuIncrements) -> gtsam.NonlinearFactor:
        """One interval of the IMU, `ImuFactorWithGravityDirection` (Forster et al., TRO 2017)."""
        level = noise_levels(increments, np.array([node.t - before.t]), self._noise, self._g)[0]
        if level not in self._params:
            self._params[level] = preintegration_parameters(self._noise, self._g, *level)
        (pim,) = preintegrate(increments, [self._params[level]])
        return imu_factor(self._keys, before.number, node.number, node.epoch, pim, self._g)

    def constant_velocity(self, number: int, change: float) -> gtsam.NonlinearFactor:
        """The velocity changes by no more than about `change`, m/s, from the node before."""
        return constant_velocity(number - 1, round(change, 4))

    def bias_walk(self, epoch: int, length_s: float) -> gtsam.NonlinearFactor:
        """A bias variable near the one before it, `BetweenFactorConstantBias`."""
        model = gtsam.noiseModel.Diagonal.Sigmas(self._walk * np.sqrt(length_s))
        return bias_walk(B(epoch - 1), B(epoch), model)

    def joint(self, number: int, joint: str, position: FloatArray) -> gtsam.NonlinearFactor:
        """A joint of the forearm where the camera sees it, `GPSFactorArmCalib` or `GPSFactorArm`."""
        lever = self._keys.lever_of(joint) if joint in self._joints else None
        return joint_factor(X(number), lever, position, self._robust(joint))

    def shoulder(self, knot: int, position: FloatArray) -> gtsam.NonlinearFactor:
        """A shoulder knot where the camera sees it, `PriorFactorPoint3`."""
        return gtsam.PriorFactorPoint3(S(knot), position, self._robust("shoulder"))

    def knot_walk(self, before: int, knot: int, length_s: float) -> gtsam.NonlinearFactor:
        """A shoulder knot near the one before it, `BetweenFactorPoint3`."""
        return knot_walk(before, knot, self._noise.shoulder_walk, float(np.sqrt(length_s)))

    def upper_arm(self, knot: int) -> list[gtsam.NonlinearFactor]:
        """The upper arm's length from a knot to its node's elbow, `RangeFactorWithTransformBias3D`."""
        if not self._has_upper_arm:
            return []
        sigma_m = self._noise.upper_arm_sigma_m
        return [length_factor(knot, knot, self._upper_arm_m, sigma_m, self._elbow)]

    def _robust(self, joint: str) -> gtsam.noiseModel.Robust:
        return robust(round(float(self._sigma_m[JOINTS.index(joint)]), 6), self._noise.cauchy)


@dataclass(frozen=True)
class LagReading:
    """Which variables a solution is about.

    Attributes
    ----------
    newest, settled : LagNode
        The newest node, and the one a lag ago.
    epoch : int
        Of the newest bias.
    knot : int or None
        The newest shoulder knot; None before the camera saw one.
    layout : SharedLayout
        Which lever arms there are.
    gravity_magnitude : float, m/s^2
    """

    newest: LagNode
    settled: LagNode
    epoch: int
    knot: int | None
    layout: SharedLayout
    gravity_magnitude: float

    @property
    def keys(self) -> list[int]:
        """Keys of the variables, no key twice."""
        nodes = [key for node in (self.newest, self.settled) for key in (X(node.number), V(node.number))]
        knot = [] if self.knot is None else [S(self.knot)]
        return list(dict.fromkeys([*nodes, B(self.epoch), *constant_keys(self.layout), *knot]))

    def read(self, iteration: LagIteration, iterations: int) -> LagSolution:
        """The solution with its covariance in physical coordinates.

        Parameters
        ----------
        iteration : LagIteration
            The last one, of `keys`.
        iterations : int
            How many there were.
        """
        values = iteration.values
        newest, settled = state_of(values, self.newest), state_of(values, self.settled)
        physical, rows = self._physical(iteration, newest.R, settled.R)
        return LagSolution(
            newest=newest,
            settled=settled,
            bias=bias_of(values, self.epoch),
            gravity=gravity_of(values, self.gravity_magnitude),
            levers={joint: lever_of(values, joint) for joint in self.layout.joints},
            shoulder=None if self.knot is None else np.asarray(values.atPoint3(S(self.knot))),
            covariance=physical @ iteration.covariance @ physical.T,
            rows=rows,
            change_m=iteration.moved_m(X(self.newest.number)),
            iterations=iterations,
        )

    def _physical(
        self, iteration: LagIteration, R_newest: FloatArray, R_settled: FloatArray
    ) -> tuple[FloatArray, dict[str, slice]]:
        """The physical quantities' change for a change of GTSAM's coordinates, and the rows of each."""
        blocks = [
            *_state_blocks("", self.newest.number, R_newest),
            *_state_blocks("settled_", self.settled.number, R_settled),
            ("bias", B(self.epoch), np.eye(6)),
            ("gravity", G(0), self.gravity_magnitude * gravity_axes(iteration.before)),
            *((joint, L(JOINTS.index(joint)), np.eye(3)) for joint in self.layout.joints),
        ]
        if self.knot is not None:
            blocks.append(("shoulder", S(self.knot), np.eye(3)))
        height, rows, start = sum(len(block) for *_, block in blocks), {}, 0
        physical = np.zeros((height, len(iteration.covariance)))
        for name, key, block in blocks:
            rows[name] = slice(start, start + len(block))
            physical[rows[name], iteration.columns[key]] = block
            start += len(block)
        return physical, rows


def constant_keys(layout: SharedLayout) -> list[int]:
    """Keys of what is one variable a window: gravity, the upper arm's length, lever arms."""
    levers = [L(JOINTS.index(joint)) for joint in layout.joints]
    return [G(0), *([U(0)] if layout.has_upper_arm else []), *levers]


def state_of(values: gtsam.Values, node: LagNode) -> NodeState:
    """A node's pose and velocity."""
    pose = values.atPose3(X(node.number))
    velocity = values.atVector(V(node.number))
    return NodeState(node.t, pose.rotation().matrix(), pose.translation(), velocity)


def bias_of(values: gtsam.Values, epoch: int) -> FloatArray:
    """A bias (6,), m/s^2 and rad/s."""
    return np.asarray(values.atConstantBias(B(epoch)).vector())


def gravity_of(values: gtsam.Values, magnitude: float) -> FloatArray:
    """Gravity (3,) in {K}, m/s^2."""
    return np.asarray(magnitude * values.atUnit3(G(0)).point3())


def lever_of(values: gtsam.Values, joint: str) -> FloatArray:
    """A joint's lever arm (3,) in {A}, m."""
    return np.asarray(values.atPoint3(L(JOINTS.index(joint))))


def _state_blocks(prefix: str, number: int, R: FloatArray) -> list[tuple[str, int, FloatArray]]:
    """Turn, position and velocity of a node by its variables; a pose's own change is in the axes {A}."""
    turn, position = np.zeros((3, 6)), np.zeros((3, 6))
    turn[:, :3], position[:, 3:] = R, R
    return [
        (prefix + "turn", X(number), turn),
        (prefix + "position", X(number), position),
        (prefix + "velocity", V(number), np.eye(3)),
    ]


#: Interval between new bias variables, s.
BIAS_EPOCH_S = 1.0
#: Shoulder knots keep this far apart, s.
KNOT_S = 0.09
#: An iteration that moves the newest node by less than this is the last, m; this many at most. 3 mm leaves
#: 0.5 mm at most (measured), and spares half of the iterations.
SETTLED_M = 0.003
ITERATIONS = 4


class LagWindow:
    """Nodes of the last moments with their factors.

    Parameters
    ----------
    priors : Priors
        On the shared quantities, before the first node.
    noise : NoiseModel
    sigma_m : ndarray, shape (5,), m
        Noise of the camera's joints, per axis.
    gravity_magnitude : float, m/s^2
    length_s : float, s
        Nodes older than this against the newest leave.
    """

    def __init__(
        self,
        priors: Priors,
        noise: NoiseModel,
        sigma_m: FloatArray,
        gravity_magnitude: float,
        length_s: float,
    ) -> None:
        self._layout, self._g, self._length_s = priors.layout, gravity_magnitude, length_s
        self._factors = LagFactors(priors, noise, sigma_m, gravity_magnitude)
        self._nodes: list[LagNode] = []
        self._count = 0
        self._first_epoch = self._epoch = 0
        self._epoch_s = -np.inf
        self._knot: int | None = None
        self._knot_s = -np.inf
        mean = priors.shared.mean
        self._values = gtsam.Values()
        insert_constants(self._values, priors.layout, mean)
        self._values.insert(B(0), gtsam.imuBias.ConstantBias(mean[:3], mean[3:6]))
        #: Of no node: the prior, the walk of the bias, and what is left of those that left.
        self._lasting: list[gtsam.NonlinearFactor] = [
            prior_factor(priors, [B(0), *constant_keys(priors.layout)])
        ]
        self._axes = gravity_axes(self._values)

    @property
    def t(self) -> FloatArray:
        """Times of the nodes, s."""
        return np.array([node.t for node in self._nodes])

    @property
    def bias(self) -> FloatArray:
        """The newest bias (6,), m/s^2 and rad/s."""
        return bias_of(self._values, self._epoch)

    @property
    def gravity(self) -> FloatArray:
        """Gravity (3,) in {K}, m/s^2."""
        return gravity_of(self._values, self._g)

    def lever(self, joint: str) -> FloatArray:
        """A joint's lever arm (3,) in {A}, m; zero for the IMU itself."""
        return lever_of(self._values, joint) if joint in self._layout.joints else np.zeros(3)

    def state(self, index: int) -> NodeState:
        """A node's pose and velocity; -1 is the newest."""
        return state_of(self._values, self._nodes[index])

    def add(
        self, state: NodeState, increments: ImuIncrements | None, velocity_change: float = np.inf
    ) -> None:
        """Add a node after the newest.

        Parameters
        ----------
        state : NodeState
            Where to start.
        increments : ImuIncrements or None
            Of the interval from the newest node; None for the first one.
        velocity_change : float, m/s
            How much the velocity may change in the interval; inf where nothing is known of it.
        """
        self._next_epoch(state.t)
        node = LagNode(self._count, state.t, self._epoch)
        self._values.insert(X(node.number), Pose3(Rot3(state.R), state.p))
        self._values.insert(V(node.number), state.v)
        self._nodes.append(node)
        self._count += 1
        if increments is None:
            node.others += self._factors.first(node.number, state)
        else:
            self.set_increments(len(self._nodes) - 1, increments)
        if np.isfinite(velocity_change):
            node.others.append(self._factors.constant_velocity(node.number, velocity_change))
        if self._knot is not None and state.t - self._knot_s >= KNOT_S:
            self._add_knot(node, self._values.atPoint3(S(self._knot)))

    def set_increments(self, index: int, increments: ImuIncrements) -> None:
        """Set the IMU's way to a node from the one before, also where there was one already.

        Parameters
        ----------
        index : int
            Of the node, not the first.
        increments : ImuIncrements
            Of one interval.
        """
        node = self._nodes[index]
        node.imu = self._factors.imu(self._nodes[index - 1], node, increments)

    def measure(self, index: int, joint: str, position: FloatArray) -> None:
        """Add a joint's position (3,) m in {K} at a node; the shoulder counts at the knot before it."""
        node = self._nodes[index]
        if joint != "shoulder":
            node.camera.append(self._factors.joint(node.number, joint, position))
            return
        if self._knot is None or self._knot_s > node.t + KNOT_S:
            if index not in (-1, len(self._nodes) - 1):
                return
            self._add_knot(node, position)
        assert self._knot is not None
        node.camera.append(self._factors.shoulder(self._knot, position))

    def retract(self, after_s: float) -> None:
        """Take back what the camera saw at nodes after a time."""
        for node in self._nodes:
            if node.t > after_s:
                node.camera.clear()

    def solve(self, settled_s: float) -> LagSolution:
        """Optimise (Gauss-Newton), read the newest node and one a lag ago, let old nodes leave.

        Parameters
        ----------
        settled_s : float, s
            The last node that is no later is the one a lag ago.

        Raises
        ------
        numpy.linalg.LinAlgError
            A direction is left free.
        """
        graph, reading = self._graph(), self._reading(settled_s)
        query_keys = reading.keys
        change_m, iterations = np.inf, 0
        while change_m > SETTLED_M and iterations < ITERATIONS:
            iteration = iterate(graph, self._values, query_keys)
            self._values = iteration.values
            graph = self._graph() if self._follow_gravity() else graph
            change_m, iterations = iteration.moved_m(X(reading.newest.number)), iterations + 1
        solution = reading.read(iteration, iterations)
        self._leave(reading.newest.t - self._length_s)
        return solution

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in [*self._lasting, *(factor for node in self._nodes for factor in node.factors)]:
            graph.add(factor)
        return graph

    def _reading(self, settled_s: float) -> LagReading:
        """What a solution is about: the newest node, and the last one that is no later than a time."""
        settled = max(int(np.searchsorted(self.t, settled_s, side="right")) - 1, 0)
        return LagReading(
            self._nodes[-1], self._nodes[settled], self._epoch, self._knot, self._layout, self._g
        )

    def _follow_gravity(self) -> bool:
        """Turn the Gaussians with the axes across gravity, where these have turned."""
        if not have_turned(self._axes, gravity_axes(self._values)):
            return False
        self._lasting = turned_with_axes(self._lasting, self._values, self._axes)
        self._axes = gravity_axes(self._values)
        return True

    def _leave(self, before_s: float) -> None:
        """Marginalise the nodes before a time, with their knots and biases; the newest two stay."""
        count = sum(node.t < before_s for node in self._nodes[:-2])
        if not count:
            return
        leaving, self._nodes = self._nodes[:count], self._nodes[count:]
        keys = self._leaving_keys(leaving, self._nodes[0])
        factors = self._lasting + [factor for node in leaving for factor in node.factors]
        # what ties those that stay to those that leave goes with them
        first = self._nodes[0]
        factors += [] if first.imu is None else [first.imu]
        first.imu = None
        for node in self._nodes:
            ties, node.others = split(node.others, set(keys))
            seen, node.camera = split(node.camera, set(keys))
            factors += ties + seen
        self._lasting = marginalise(factors, self._values, keys)
        self._first_epoch = first.epoch

    def _leaving_keys(self, leaving: list[LagNode], first: LagNode) -> list[int]:
        """Keys of what leaves with some nodes, in the order of elimination; `first` is the first to stay."""
        states = [key for node in leaving for key in (X(node.number), V(node.number))]
        biases = [B(epoch) for epoch in range(self._first_epoch, first.epoch)]
        knots = [S(node.number) for node in leaving if node.number != self._knot]
        return [*states, *biases, *(knot for knot in knots if self._values.exists(knot))]

    def _next_epoch(self, t: float) -> None:
        """A new bias variable where the last one is old."""
        if t - self._epoch_s < BIAS_EPOCH_S:
            return
        if np.isfinite(self._epoch_s):
            self._epoch += 1
            self._values.insert(B(self._epoch), self._values.atConstantBias(B(self._epoch - 1)))
            self._lasting.append(self._factors.bias_walk(self._epoch, t - self._epoch_s))
        self._epoch_s = t

    def _add_knot(self, node: LagNode, position: FloatArray) -> None:
        """A shoulder knot at a node: near the one before, the upper arm's length from the elbow."""
        self._values.insert(S(node.number), np.asarray(position, dtype=float))
        if self._knot is not None:
            node.others.append(self._factors.knot_walk(self._knot, node.number, node.t - self._knot_s))
        node.others += self._factors.upper_arm(node.number)
        self._knot, self._knot_s = node.number, node.t
