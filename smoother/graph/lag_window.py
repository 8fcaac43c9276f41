"""The window of the last moments, solved anew with every frame; what left it stays as a Gaussian (GTSAM).

Nodes inside may still be changed: a late frame or IMU sample costs no more than one in time.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..recording import JOINTS
from ..window.problem import ImuIncrements, NoiseModel, Priors
from ..window.solution import LagSolution, NodeState
from .build import TISSUE_S
from .lag_elimination import LagIteration, in_order, iterate, marginalise, split
from .lag_factors import LagBody, LagFactors, LagNode, state_keys_of
from .shared_prior import (
    gravity_axes,
    have_turned,
    insert_constants,
    lever_keys,
    prior_factor,
    turned_with_axes,
)
from .variables import keys_of

#: Shoulder knots keep this far apart, s.
KNOT_S = 0.09
#: Interval between new bias variables, s.
BIAS_EPOCH_S = 1.0
#: An iteration that moves the newest node by less than this is the last, m; this many at most. 3 mm leaves
#: 0.5 mm at most (measured), and spares half of the iterations.
SETTLED_M = 0.003
ITERATIONS = 4


class LagWindow:
    """Nodes of the last moments with their factors."""

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
        first, *further = (keys_of(segment).bias for segment in priors.layout.segments)
        for segment, key in zip(priors.layout.segments, (first, *further), strict=True):
            bias = mean[priors.layout.bias_of(segment)]
            self._values.insert(key, gtsam.imuBias.ConstantBias(bias[:3], bias[3:]))
        upper_arm = [U(0)] if priors.layout.has_upper_arm else []
        prior_keys = [first, G(0), *upper_arm, *lever_keys(priors.layout), *further]
        #: Of no node: the prior, the walk of the biases, and what is left of those that left.
        self._lasting: list[gtsam.NonlinearFactor] = [prior_factor(priors, prior_keys)]
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
        return np.asarray(self._g * self._values.atUnit3(G(0)).point3())

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
        self._next_epoch(state.t)
        node = LagNode(self._count, state.t, self._epoch)
        self._values.insert(X(node.number), Pose3(Rot3(state.R), state.p))
        self._values.insert(V(node.number), state.v)
        self._nodes.append(node)
        self._count += 1
        if increments is None:
            node.others += self._factors.first(node.number, state)
        else:
            self._tie(node, self._nodes[-2], FOREARM.name, increments)
        if np.isfinite(velocity_change):
            node.others.append(self._factors.constant_velocity(node.number, velocity_change))
        if self._knot is not None and state.t - self._knot_s >= KNOT_S:
            self._add_knot(node, self._values.atPoint3(S(self._knot)))

    def attach(
        self, index: int, segment: str, state: NodeState, increments: ImuIncrements | None = None
    ) -> None:
        """Give a further segment with an IMU its variables at a node."""
        node, before = self._nodes[index], self.nodes_of(segment)
        lever = self._factors.shared_joint_m[segment]
        pose, velocity, point = state_keys_of(segment, node.number)
        self._values.insert(pose, Pose3(Rot3(state.R), state.p))
        self._values.insert(velocity, state.v)
        self._values.insert(point, state.p + state.R @ lever)
        node.bodies[segment] = body = LagBody()
        if increments is None:
            body.others += self._factors.first(node.number, state, segment)
        else:
            self._tie(node, self._nodes[before[-1]], segment, increments)
        step_s = TISSUE_S if increments is None else node.t - self._nodes[before[-1]].t
        body.others += self._factors.shared_joint(node.number, segment, step_s)
        if self._values.exists(S(node.number)):
            body.others += self._factors.shoulder_end(node.number, segment, KNOT_S)
        waiting, node.waiting = node.waiting, []
        for joint, position in waiting:
            self._see(node, joint, position)

    def detach(self, segment: str, since_s: float) -> None:
        """Take a further segment out of all nodes from a time on."""
        leaving: list[int] = []
        for node in self._nodes:
            if segment in node.bodies and node.t >= since_s:
                del node.bodies[segment]
                leaving += state_keys_of(segment, node.number)
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
        rows = sum(each.dim() for each in factors)
        return 2.0 * sum(each.error(self._values) for each in factors) / rows

    def set_increments(self, index: int, increments: ImuIncrements, segment: str = FOREARM.name) -> None:
        """Set an IMU's way to a node from its one before, also where there was one already."""
        node = self._nodes[index]
        before = next((each for each in self._nodes if each.number == node.bodies[segment].before), None)
        if before is not None:
            self._tie(node, before, segment, increments)

    def _tie(self, node: LagNode, before: LagNode, segment: str, increments: ImuIncrements) -> None:
        body = node.bodies[segment]
        body.imu, body.before = self._factors.imu(before, node, increments, segment), before.number

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
        node.camera.append(self._factors.shoulder(self._knot, position))

    def _see(self, node: LagNode, joint: str, position: FloatArray) -> None:
        """A joint at a node; it waits where the IMU that it belongs to is not there yet."""
        segment = self._layout.segment_of(joint)
        if segment in node.bodies:
            node.camera.append(self._factors.joint(node.number, joint, position, segment))
        else:
            node.waiting.append((joint, position))

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
            graph = self._graph() if self._follow_gravity() else graph
            change_m, iterations = iteration.moved_m(X(newest.number)), iterations + 1
        solution = self._solution(newest, settled, iteration, iterations)
        self._leave(newest.t - self._length_s)
        return solution

    def _solution(
        self, newest: LagNode, settled: LagNode, iteration: LagIteration, iterations: int
    ) -> LagSolution:
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
        blocks.append(("gravity", G(0), self._g * gravity_axes(iteration.before)))
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
            change_m=iteration.moved_m(X(newest.number)),
            iterations=iterations,
        )

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in [*self._lasting, *(factor for node in self._nodes for factor in node.factors)]:
            graph.add(factor)
        return graph

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
        first, gone = self._nodes[0], {node.number for node in leaving}
        for node in self._nodes:
            factors += [f for body in node.bodies.values() if body.before in gone for f in body.release()]
        for node in self._nodes:
            ties, node.others = split(node.others, set(keys))
            seen, node.camera = split(node.camera, set(keys))
            factors += ties + seen
        self._lasting = marginalise(factors, self._values, keys)
        self._first_epoch = first.epoch

    def _leaving_keys(self, leaving: list[LagNode], first: LagNode) -> list[int]:
        """Keys of what leaves with some nodes, in the order of elimination; `first` is the first to stay."""
        states = [key for node in leaving for key in node.state_keys]
        first_biases = [keys_of(segment).bias for segment in self._layout.segments]
        biases = [bias + epoch for epoch in range(self._first_epoch, first.epoch) for bias in first_biases]
        knots = [S(node.number) for node in leaving if node.number != self._knot]
        return [*states, *biases, *(knot for knot in knots if self._values.exists(knot))]

    def _next_epoch(self, t: float) -> None:
        """A new bias variable where the last one is old."""
        if t - self._epoch_s < BIAS_EPOCH_S:
            return
        if np.isfinite(self._epoch_s):
            self._epoch += 1
            for segment in self._layout.segments:
                bias = keys_of(segment).bias + self._epoch
                self._values.insert(bias, self._values.atConstantBias(bias - 1))
                self._lasting.append(self._factors.bias_walk(self._epoch, t - self._epoch_s, segment))
        self._epoch_s = t

    def _add_knot(self, node: LagNode, position: FloatArray) -> None:
        """A shoulder knot at a node: near the one before, the upper arm's length from the elbow."""
        self._values.insert(S(node.number), np.asarray(position, dtype=float))
        if self._knot is not None:
            node.others.append(self._factors.knot_walk(self._knot, node.number, node.t - self._knot_s))
        node.others += self._factors.upper_arm(node.number)
        for segment, body in node.bodies.items():
            if SEGMENTS[segment].parent:
                body.others += self._factors.shoulder_end(node.number, segment, KNOT_S)
        self._knot, self._knot_s = node.number, node.t
