"""The window of the last moments, solved anew with every frame; what left it stays as a Gaussian (GTSAM).

Nodes inside may still be changed: a late frame or IMU sample costs no more than one in time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..linalg import scaled_inverse
from ..recording import JOINTS
from ..units import GRAVITY
from ..window.problem import ImuIncrements, NoiseModel, Priors
from ..window.solution import LagSolution, NodeState
from .factors import (
    TISSUE_S,
    bias_walk,
    constant_velocity,
    imu_factors,
    isotropic,
    joint_factor,
    knot_walk,
    length_factor,
    robust,
    shared_joint,
    shoulder_end,
    tissue_sigma,
)
from .shared_prior import gravity_axes, have_turned, insert_shared, prior_factor, turned_with_axes
from .variables import DIMENSION, LETTER_BITS, keys_of, letter_of, node_keys, values_of

#: Shoulder knots keep this far apart, s.
KNOT_S = 0.09
#: Interval between new bias variables, s.
BIAS_EPOCH_S = 1.0
#: An iteration that moves the newest node by less than this is the last, m; this many at most. 3 mm leaves
#: 0.5 mm at most (measured), and spares half of the iterations.
SETTLED_M = 0.003
ITERATIONS = 4
#: Before any frame a first node is known so well: rad, m, m/s.
FIRST_TURN_RAD, FIRST_POSITION_M, FIRST_VELOCITY = 0.5, 0.5, 1.5

Factors = list[gtsam.NonlinearFactor]


@dataclass
class LagBody:
    """A segment with an IMU at a node."""

    before: int = -1  # Number of the node that the IMU's factor begins at; -1 where there is no such factor
    imu: gtsam.NonlinearFactor | None = None  # The IMU's from that node
    others: Factors = field(default_factory=list)  # All others of the segment


@dataclass
class LagNode:
    """A node with its factors."""

    number: int  # Of its variables
    t: float  # s
    epoch: int  # Number of its bias variables
    # The segments that have variables at it, the forearm first
    bodies: dict[str, LagBody] = field(default_factory=lambda: {FOREARM.name: LagBody()})
    camera: Factors = field(default_factory=list)  # What the camera saw at it
    others: Factors = field(default_factory=list)  # All others at it
    # Joints that the camera saw, of segments that have no variables at it yet
    waiting: list[tuple[str, FloatArray]] = field(default_factory=list)

    @property
    def factors(self) -> Factors:
        """The IMUs' first."""
        imus = [body.imu for body in self.bodies.values() if body.imu is not None]
        return imus + self.camera + self.others + [each for b in self.bodies.values() for each in b.others]


class LagWindow:
    """Nodes of the last moments with their factors."""

    def __init__(self, priors: Priors, noise: NoiseModel, sigma_m: FloatArray, length_s: float) -> None:
        self._layout, self._mean, self._length_s = priors.layout, priors.shared.mean, length_s
        self._noise, self._sigma_m, self._walk = noise, sigma_m, priors.bias_walk
        self._nodes: list[LagNode] = []
        self._count = 0
        self._first_epoch = self._epoch = 0
        self._epoch_s = -np.inf
        self._knot: int | None = None
        self._knot_s = -np.inf
        self._values = gtsam.Values()
        insert_shared(self._values, priors.layout, self._mean, range(1))
        #: Of no node: the prior, the walk of the biases, and what is left of those that left.
        self._lasting: Factors = [prior_factor(priors, 0)]
        self._axes = gravity_axes(self._values)

    @property
    def t(self) -> FloatArray:
        """Times of the nodes, s."""
        return np.array([node.t for node in self._nodes])

    @property
    def bias(self) -> FloatArray:
        """The forearm IMU's newest bias (6,), m/s^2 and rad/s."""
        return self.bias_of(FOREARM.name)

    def bias_of(self, segment: str) -> FloatArray:
        """The newest bias (6,) of the IMU on a segment, m/s^2 and rad/s."""
        return np.asarray(self._values.atConstantBias(keys_of(segment).bias + self._epoch).vector())

    @property
    def gravity(self) -> FloatArray:
        """Gravity (3,) in {K}, m/s^2."""
        return np.asarray(GRAVITY * self._values.atUnit3(G(0)).point3())

    def lever(self, joint: str) -> FloatArray:
        """A joint's lever arm (3,) in {A}, m; zero for the IMU itself."""
        if joint not in self._layout.joints:
            return np.zeros(3)
        return np.asarray(self._values.atPoint3(L(JOINTS.index(joint))))

    def state(self, index: int, segment: str = FOREARM.name) -> NodeState:
        """A segment's pose and velocity at a node where it has variables; -1 is the newest node."""
        return self._state(self._nodes[index], segment)

    def _state(self, node: LagNode, segment: str = FOREARM.name) -> NodeState:
        keys = keys_of(segment)
        pose = self._values.atPose3(keys.pose + node.number)
        velocity = self._values.atVector(keys.velocity + node.number)
        return NodeState(node.t, pose.rotation().matrix(), pose.translation(), velocity)

    def is_due(self, index: int, segment: str, since_s: float) -> bool:
        """Whether a further segment whose last node is at a time is to have variables at a node."""
        node = self._nodes[index]
        is_seen = any(self._layout.segment_of(joint) == segment for joint, _ in node.waiting)
        return is_seen or self._values.exists(S(node.number)) or node.t - since_s > KNOT_S

    def nodes_of(self, segment: str) -> list[int]:
        """Indices of the nodes at which a segment has variables."""
        return [index for index, node in enumerate(self._nodes) if segment in node.bodies]

    def add(
        self, state: NodeState, increments: ImuIncrements | None, velocity_change: float = np.inf
    ) -> None:
        """Add a node after the newest."""
        if np.isfinite(self._epoch_s) and state.t - self._epoch_s >= BIAS_EPOCH_S:
            self._epoch += 1
            model = gtsam.noiseModel.Diagonal.Sigmas(self._walk * np.sqrt(state.t - self._epoch_s))
            for segment in self._layout.segments:
                bias = keys_of(segment).bias + self._epoch
                self._values.insert(bias, self._values.atConstantBias(bias - 1))
                self._lasting.append(bias_walk(bias - 1, bias, model))
        if state.t - self._epoch_s >= BIAS_EPOCH_S:
            self._epoch_s = state.t
        node = LagNode(self._count, state.t, self._epoch)
        self._nodes.append(node)
        self._count += 1
        self._begin(node, FOREARM.name, state, increments)
        if np.isfinite(velocity_change):
            node.others.append(constant_velocity(node.number - 1, round(velocity_change, 4)))
        if self._knot is not None and state.t - self._knot_s >= KNOT_S:
            self._add_knot(node, self._values.atPoint3(S(self._knot)))

    def _begin(
        self, node: LagNode, segment: str, state: NodeState, increments: ImuIncrements | None
    ) -> LagNode | None:
        """A segment's variables at a node, tied to its last one, or with wide priors; that last one."""
        before = next((each for each in reversed(self._nodes[:-1]) if segment in each.bodies), None)
        pose, velocity, *_ = node_keys(segment, node.number)
        here = Pose3(Rot3(state.R), state.p)
        self._values.insert(pose, here)
        self._values.insert(velocity, state.v)
        body = node.bodies.setdefault(segment, LagBody())
        if increments is not None:
            assert before is not None
            self._tie(node, before, segment, increments)
            return before
        wide = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FIRST_TURN_RAD, FIRST_POSITION_M], 3))
        first = [
            gtsam.PriorFactorPose3(pose, here, wide),
            gtsam.PriorFactorVector(velocity, state.v, isotropic(3, FIRST_VELOCITY)),
        ]
        (node if segment == FOREARM.name else body).others.extend(first)
        return None

    def attach(
        self, index: int, segment: str, state: NodeState, increments: ImuIncrements | None = None
    ) -> None:
        """Give a further segment with an IMU its variables at a node."""
        node = self._nodes[index]
        before = self._begin(node, segment, state, increments)
        body, lever = node.bodies[segment], self._layout.lever(SEGMENTS[segment].shared_joint, segment)
        self._values.insert(keys_of(segment).point + node.number, state.p + state.R @ self._mean[lever])
        step_s = TISSUE_S if before is None else node.t - before.t
        body.others += shared_joint(segment, node.number, float(tissue_sigma(self._noise, segment, step_s)))
        if self._values.exists(S(node.number)):
            self._end_in_knot(node, segment)
        waiting, node.waiting = node.waiting, []
        for joint, position in waiting:
            self._see(node, joint, position)

    def detach(self, segment: str, since_s: float) -> None:
        """Take a further segment out of all nodes from a time on."""
        leaving: list[int] = []
        for node in self._nodes:
            if segment in node.bodies and node.t >= since_s:
                del node.bodies[segment]
                leaving += node_keys(segment, node.number)
                _, node.camera = split(node.camera, set(leaving))
        # what those that left say of it stays, as far as it is about the rest
        held = set(leaving) & {key for factor in self._lasting for key in list(factor.keys())}
        if held:
            self._lasting = marginalise(self._lasting, self._values, in_order(held))
        for key in set(leaving) - held:
            self._values.erase(key)

    def misfit(self, segment: str, since_s: float) -> float:
        """How badly a further segment's IMU fits to the rest at nodes from a time on."""
        bodies = [
            node.bodies[segment] for node in self._nodes if segment in node.bodies and node.t >= since_s
        ]
        factors = [each for body in bodies if body.imu is not None for each in (body.imu, *body.others)]
        if not factors:
            return float("nan")
        return 2.0 * sum(each.error(self._values) for each in factors) / sum(each.dim() for each in factors)

    def set_increments(self, index: int, increments: ImuIncrements, segment: str = FOREARM.name) -> None:
        """Set an IMU's way to a node from its one before, also where there was one already."""
        node = self._nodes[index]
        before = next((each for each in self._nodes if each.number == node.bodies[segment].before), None)
        if before is not None:
            self._tie(node, before, segment, increments)

    def _tie(self, node: LagNode, before: LagNode, segment: str, increments: ImuIncrements) -> None:
        """One interval of an IMU, from its node before."""
        body, between, dt = node.bodies[segment], (before.number, node.number, node.epoch), node.t - before.t
        (body.imu,) = imu_factors(segment, [between], increments, np.array([dt]), self._noise)
        body.before = before.number

    def measure(self, index: int, joint: str, position: FloatArray) -> None:
        """Add a joint's position (3,) m in {K} at a node; the shoulder counts at the knot before it."""
        node = self._nodes[index]
        if joint != "shoulder":
            self._see(node, joint, position)
            return
        if self._knot is None or self._knot_s > node.t + KNOT_S:
            if index not in (-1, len(self._nodes) - 1):
                return
            self._add_knot(node, position)
        assert self._knot is not None
        node.camera.append(gtsam.PriorFactorPoint3(S(self._knot), position, self._robust(joint)))

    def _see(self, node: LagNode, joint: str, position: FloatArray) -> None:
        """A joint at a node; it waits where the IMU that it belongs to is not there yet."""
        segment = self._layout.segment_of(joint)
        if segment not in node.bodies:
            node.waiting.append((joint, position))
            return
        keys = keys_of(segment)
        lever = keys.lever_of(joint) if joint in self._layout.levers(segment) else None
        node.camera.append(joint_factor(keys.pose + node.number, lever, position, self._robust(joint)))

    def _robust(self, joint: str) -> gtsam.noiseModel.Robust:
        return robust(round(float(self._sigma_m[JOINTS.index(joint)]), 6), self._noise.cauchy)

    def retract(self, after_s: float) -> None:
        """Take back what the camera saw at nodes after a time."""
        for node in self._nodes:
            if node.t > after_s:
                node.camera.clear()
                node.waiting.clear()

    def solve(self, settled_s: float) -> LagSolution:
        """Optimise (Gauss-Newton), read the newest node and one a lag ago, let old nodes leave."""
        graph, newest = self._graph(), self._nodes[-1]
        settled = self._nodes[max(int(np.searchsorted(self.t, settled_s, side="right")) - 1, 0)]
        states = [key for node in (newest, settled) for key in (X(node.number), V(node.number))]
        levers = [L(JOINTS.index(joint)) for joint in self._layout.joints]
        constants = [B(self._epoch), G(0), *([U(0)] if self._layout.has_upper_arm else []), *levers]
        knot = [] if self._knot is None else [S(self._knot)]
        query_keys = list(dict.fromkeys([*states, *constants, *knot]))
        change_m, iterations = np.inf, 0
        while change_m > SETTLED_M and iterations < ITERATIONS:
            iteration = iterate(graph, self._values, query_keys)
            self._values = iteration.values
            if have_turned(self._axes, gravity_axes(self._values)):
                # the Gaussians turn with the axes across gravity
                self._lasting = turned_with_axes(self._lasting, self._values, self._axes)
                self._axes = gravity_axes(self._values)
                graph = self._graph()
            change_m, iterations = iteration.moved_m(X(newest.number)), iterations + 1
        solution = self._solution(newest, settled, iteration)
        self._leave(newest.t - self._length_s)
        return solution

    def _solution(self, newest: LagNode, settled: LagNode, iteration: LagIteration) -> LagSolution:
        """The solution with its covariance in physical coordinates, which follow GTSAM's own."""
        now, before = self._state(newest), self._state(settled)
        blocks: list[tuple[str, int, FloatArray]] = []
        for prefix, node, state in (("", newest, now), ("settled_", settled, before)):
            # a pose's own change is in the axes {A}
            turn, position = np.zeros((3, 6)), np.zeros((3, 6))
            turn[:, :3], position[:, 3:] = state.R, state.R
            blocks.append((prefix + "turn", X(node.number), turn))
            blocks.append((prefix + "position", X(node.number), position))
            blocks.append((prefix + "velocity", V(node.number), np.eye(3)))
        blocks.append(("bias", B(self._epoch), np.eye(6)))
        blocks.append(("gravity", G(0), GRAVITY * gravity_axes(iteration.before)))
        blocks += [(joint, L(JOINTS.index(joint)), np.eye(3)) for joint in self._layout.joints]
        if self._knot is not None:
            blocks.append(("shoulder", S(self._knot), np.eye(3)))
        height, rows, start = sum(len(block) for *_, block in blocks), {}, 0
        physical = np.zeros((height, len(iteration.covariance)))
        for name, key, block in blocks:
            rows[name] = slice(start, start + len(block))
            physical[rows[name], iteration.columns[key]] = block
            start += len(block)
        return LagSolution(
            newest=now,
            settled=before,
            bias=self.bias,
            gravity=self.gravity,
            levers={joint: self.lever(joint) for joint in self._layout.joints},
            shoulder=None if self._knot is None else np.asarray(self._values.atPoint3(S(self._knot))),
            covariance=physical @ iteration.covariance @ physical.T,
            rows=rows,
        )

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in [*self._lasting, *(factor for node in self._nodes for factor in node.factors)]:
            graph.add(factor)
        return graph

    def _leave(self, before_s: float) -> None:
        """Marginalise the nodes before a time, with their knots and biases; the newest two stay."""
        count = sum(node.t < before_s for node in self._nodes[:-2])
        if not count:
            return
        leaving, self._nodes = self._nodes[:count], self._nodes[count:]
        first, gone = self._nodes[0], {node.number for node in leaving}
        keys = [key for node in leaving for segment in node.bodies for key in node_keys(segment, node.number)]
        first_biases = [keys_of(segment).bias for segment in self._layout.segments]
        keys += [bias + epoch for epoch in range(self._first_epoch, first.epoch) for bias in first_biases]
        knots = (S(node.number) for node in leaving if node.number != self._knot)
        keys += [knot for knot in knots if self._values.exists(knot)]
        factors = self._lasting + [factor for node in leaving for factor in node.factors]
        # what ties those that stay to those that leave goes with them
        for node in self._nodes:
            for body in node.bodies.values():
                if body.before in gone:
                    factors += [] if body.imu is None else [body.imu]
                    body.imu, body.before = None, -1
        for node in self._nodes:
            ties, node.others = split(node.others, set(keys))
            seen, node.camera = split(node.camera, set(keys))
            factors += ties + seen
        self._lasting = marginalise(factors, self._values, keys)
        self._first_epoch = first.epoch

    def _add_knot(self, node: LagNode, position: FloatArray) -> None:
        """A shoulder knot at a node: near the one before, the upper arm's length from the elbow."""
        knot, noise, layout = node.number, self._noise, self._layout
        self._values.insert(S(knot), np.asarray(position, dtype=float))
        if self._knot is not None:
            root_s = float(np.sqrt(node.t - self._knot_s))
            node.others.append(knot_walk(self._knot, knot, noise.shoulder_walk, root_s))
        if layout.has_upper_arm:
            length_m, elbow = float(self._mean[layout.upper_arm][0]), self._mean[layout.lever("elbow")]
            node.others.append(length_factor(knot, knot, length_m, noise.upper_arm_sigma_m, elbow))
        self._knot, self._knot_s = knot, node.t
        for segment in node.bodies:
            self._end_in_knot(node, segment)

    def _end_in_knot(self, node: LagNode, segment: str) -> None:
        """A further segment that reaches the shoulder ends in its node's knot."""
        if SEGMENTS[segment].parent and "shoulder" in SEGMENTS[segment].joints:
            sigma_m = float(tissue_sigma(self._noise, segment, KNOT_S))
            node.bodies[segment].others.append(shoulder_end(segment, node.number, node.number, sigma_m))


#: Elimination goes along time; the variables of few nodes follow, and last come those of all.
_RANK = {"s": 1}
for _segment in SEGMENTS.values():
    _letters = _segment.letters
    _RANK |= dict.fromkeys(_letters[:2] + _letters[4:], 0) | {_letters[2]: 2}
_LAST = 3


def in_order(keys: Iterable[int]) -> list[int]:
    """Variables in the order of time, as their numbers have it; those that last at the end."""
    number = (1 << LETTER_BITS) - 1
    return sorted(keys, key=lambda key: (_RANK.get(letter_of(key), _LAST), key & number, key))


@dataclass(frozen=True)
class LagIteration:
    """What an iteration answers."""

    before: gtsam.Values  # Where it was linearised
    values: gtsam.Values  # After the step
    step: FloatArray  # (c,): of the variables that are read, in GTSAM's own coordinates
    covariance: FloatArray  # (c, c): joint, of the same
    columns: dict[int, slice]  # Where each of them is in both

    def moved_m(self, pose: int) -> float:
        """How far the step moved a pose that is read."""
        return float(np.linalg.norm(self.step[self.columns[pose]][3:]))


def iterate(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, query_keys: Sequence[int]
) -> LagIteration:
    """One Gauss-Newton step: eliminate all but what is read, invert what is left, and substitute back."""
    others = ordering_of(in_order(set(values.keys()) - set(query_keys)))
    net, rest = graph.linearize(values).eliminatePartialSequential(others)
    columns, start = {}, 0
    for key in query_keys:
        columns[key] = slice(start, start + DIMENSION[letter_of(key)])
        start = columns[key].stop
    information, vector = rest.hessian(ordering_of(query_keys))
    covariance = scaled_inverse(information)
    step = covariance @ np.ravel(vector)
    asked_steps = gtsam.VectorValues()
    for key, rows in columns.items():
        asked_steps.insert(key, step[rows])
    delta = net.optimize(asked_steps)
    for key, rows in columns.items():
        if not delta.exists(key):
            delta.insert(key, step[rows])
    return LagIteration(values, values.retract(delta), step, covariance, columns)


def ordering_of(keys: Iterable[int]) -> gtsam.Ordering:
    """The keys as GTSAM takes them."""
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    return ordering


def marginalise(factors: Factors, values: gtsam.Values, leaving: Sequence[int]) -> Factors:
    """Eliminate variables; what is left of the factors."""
    touching, rest = split(factors, set(leaving))
    graph = gtsam.NonlinearFactorGraph()
    for factor in touching:
        graph.add(factor)
    _, gaussians = graph.linearize(values).eliminatePartialSequential(ordering_of(leaving))
    for i in range(gaussians.size()):
        gaussian = gaussians.at(i)
        if gaussian is not None:
            rest.append(gtsam.LinearContainerFactor(gaussian, values_of(values, gaussian.keys())))
    for key in leaving:
        values.erase(key)
    return rest


def split(factors: Factors, keys: set[int]) -> tuple[Factors, Factors]:
    """The factors that touch some variables, and those that do not."""
    touching: Factors = []
    others: Factors = []
    for factor in factors:
        (others if keys.isdisjoint(factor.keys()) else touching).append(factor)
    return touching, others
