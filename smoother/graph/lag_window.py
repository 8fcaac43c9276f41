"""The window of the last moments, solved anew with every frame; what left it stays as a Gaussian (GTSAM).

The factors are those of `build`: preintegrated IMU, joints by lever arms that are variables, shoulder knots
with the upper arm's length. Before a node leaves, all factors that touch it are linearised and it is
eliminated: a Gaussian is left on what it was connected to (a fixed-lag smoother; Dong-Si and Mourikis, ICRA
2011). Nodes inside may still be changed: a late frame or IMU sample costs no more than one in time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from ..recording import JOINTS, FloatArray
from ..window.lag_solution import LagSolution, NodeState
from ..window.problem import ImuIncrements, NoiseModel, Priors
from .build import isotropic, robust
from .imu_factors import noise_levels, preintegration_parameters
from .shared_prior import insert_constants, prior_factor

#: A new bias variable so often, s.
BIAS_EPOCH_S = 1.0
#: Shoulder knots keep so far apart, s.
KNOT_S = 0.09
#: Before any frame a first node is known so well: rad, m, m/s.
FIRST_TURN_RAD, FIRST_POSITION_M, FIRST_VELOCITY = 0.5, 0.5, 1.5
#: An iteration that moves the newest node by less than this is the last, m; so many at most.
SETTLED_M = 0.001
ITERATIONS = 4


@dataclass
class _Node:
    """A node's number, time and factors: the IMU's to the node before it, and all others at it."""

    number: int
    t: float
    epoch: int
    imu: gtsam.NonlinearFactor | None = None
    others: list[gtsam.NonlinearFactor] = field(default_factory=list)


class LagWindow:
    """Nodes of the last moments with their factors.

    Parameters
    ----------
    priors : Priors
        On the shared quantities, before the first node.
    noise : NoiseModel
    sigma_m : ndarray, shape (5,), m
        Noise of the camera's joints, an axis.
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
        self._layout, self._noise, self._sigma_m = priors.layout, noise, sigma_m
        self._g, self._length_s = gravity_magnitude, length_s
        self._walk = priors.bias_walk
        self._upper_arm_m = float(priors.shared.mean[priors.layout.upper_arm].sum())
        self._elbow = priors.shared.mean[priors.layout.lever("elbow")] if self._has_upper_arm else np.zeros(3)
        self._nodes: list[_Node] = []
        self._count = self._epoch = 0
        self._epoch_s = -np.inf
        self._knot: int | None = None
        self._knot_s = -np.inf
        self._left: list[gtsam.NonlinearFactor] = []
        self._values = gtsam.Values()
        self._params: dict[tuple[int, int], gtsam.PreintegrationParams] = {}
        mean = priors.shared.mean
        insert_constants(self._values, priors.layout, mean)
        self._values.insert(B(0), gtsam.imuBias.ConstantBias(mean[:3], mean[3:6]))
        constants = [G(0), *([U(0)] if self._has_upper_arm else []), *self._lever_keys]
        self._left.append(prior_factor(priors, [B(0), *constants]))
        self._constants = constants

    @property
    def _has_upper_arm(self) -> bool:
        return self._layout.has_upper_arm

    @property
    def _lever_keys(self) -> list[int]:
        return [L(JOINTS.index(joint)) for joint in self._layout.joints]

    @property
    def t(self) -> FloatArray:
        """Times of the nodes, s."""
        return np.array([node.t for node in self._nodes])

    @property
    def bias(self) -> FloatArray:
        """The newest bias (6,), m/s^2 and rad/s."""
        return np.asarray(self._values.atConstantBias(B(self._epoch)).vector())

    @property
    def gravity(self) -> FloatArray:
        """Gravity (3,) in {K}, m/s^2."""
        return np.asarray(self._g * self._values.atUnit3(G(0)).point3())

    def lever(self, joint: str) -> FloatArray:
        """A joint's lever arm (3,) in {A}, m; zero for the IMU itself."""
        if joint not in self._layout.joints:
            return np.zeros(3)
        return np.asarray(self._values.atPoint3(L(JOINTS.index(joint))))

    def state(self, index: int) -> NodeState:
        """A node's pose and velocity; -1 is the newest."""
        node = self._nodes[index]
        pose = self._values.atPose3(X(node.number))
        velocity = self._values.atVector(V(node.number))
        return NodeState(node.t, pose.rotation().matrix(), pose.translation(), velocity)

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
        node = _Node(self._count, state.t, self._epoch)
        self._values.insert(X(node.number), Pose3(Rot3(state.R), state.p))
        self._values.insert(V(node.number), state.v)
        if increments is None:
            sigma = np.repeat([FIRST_TURN_RAD, FIRST_POSITION_M], 3)
            model = gtsam.noiseModel.Diagonal.Sigmas(sigma)
            pose = Pose3(Rot3(state.R), state.p)
            node.others.append(gtsam.PriorFactorPose3(X(node.number), pose, model))
            node.others.append(gtsam.PriorFactorVector(V(node.number), state.v, isotropic(3, FIRST_VELOCITY)))
        self._nodes.append(node)
        self._count += 1
        if increments is not None:
            self.set_increments(len(self._nodes) - 1, increments)
        if np.isfinite(velocity_change):
            model = isotropic(3, round(velocity_change, 4))
            before, after = V(node.number - 1), V(node.number)
            node.others.append(gtsam.BetweenFactorVector(before, after, np.zeros(3), model))
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
        before, node = self._nodes[index - 1], self._nodes[index]
        dt = np.array([node.t - before.t])
        level = noise_levels(increments, dt, self._noise, self._g)[0]
        if level not in self._params:
            self._params[level] = preintegration_parameters(self._noise, self._g, *level)
        bias = gtsam.imuBias.ConstantBias(increments.bias[:3], increments.bias[3:])
        pim = gtsam.PreintegratedImuMeasurements(self._params[level], bias)
        acc, gyro = increments.acc + increments.bias[:3], increments.gyro + increments.bias[3:]
        for step in range(len(gyro)):
            pim.integrateMeasurement(acc[step, 0], gyro[step], increments.h[step])
            pim.integrateMeasurement(acc[step, 1], gyro[step], increments.h[step])
        a, b = before.number, node.number
        node.imu = gtsam.ImuFactorWithGravityDirection(
            X(a), V(a), X(b), V(b), B(node.epoch), G(0), pim, self._g
        )

    def measure(self, index: int, joint: str, position: FloatArray) -> None:
        """Add a joint's position (3,) m in {K} at a node; the shoulder counts at the knot before it."""
        node = self._nodes[index]
        column = JOINTS.index(joint)
        model = robust(round(float(self._sigma_m[column]), 6), self._noise.cauchy)
        if joint == "shoulder":
            if self._knot is None or self._knot_s > node.t + KNOT_S:
                if index not in (-1, len(self._nodes) - 1):
                    return
                self._add_knot(node, position)
            assert self._knot is not None
            node.others.append(gtsam.PriorFactorPoint3(S(self._knot), position, model))
        elif joint in self._layout.joints:
            node.others.append(gtsam.GPSFactorArmCalib(X(node.number), L(column), position, model))
        else:
            node.others.append(gtsam.GPSFactorArm(X(node.number), position, np.zeros(3), model))

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
        graph = self._graph()
        t = self.t
        settled = max(int(np.searchsorted(t, settled_s, side="right")) - 1, 0)
        newest = self._nodes[-1].number
        asked = list(
            dict.fromkeys(
                [
                    X(newest),
                    V(newest),
                    X(self._nodes[settled].number),
                    V(self._nodes[settled].number),
                    B(self._epoch),
                    *self._constants,
                    *([] if self._knot is None else [S(self._knot)]),
                ]
            )
        )
        change_m, iterations = np.inf, 0
        while change_m > SETTLED_M and iterations < ITERATIONS:
            change_m, covariance, columns = self._iterate(graph, asked, X(newest))
            iterations += 1
        solution = self._read(covariance, columns, settled, change_m, iterations)
        self._leave(float(t[-1]) - self._length_s)
        return solution

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for factor in self._left:
            graph.add(factor)
        for node in self._nodes:
            if node.imu is not None:
                graph.add(node.imu)
            for factor in node.others:
                graph.add(factor)
        return graph

    def _iterate(
        self, graph: gtsam.NonlinearFactorGraph, asked: list[int], newest: int
    ) -> tuple[float, FloatArray, dict[int, slice]]:
        """One Gauss-Newton step; how far the newest node moved, and the covariance of what is asked for."""
        linear = graph.linearize(self._values)
        others = gtsam.Ordering()
        for key in self._in_order(set(asked)):
            others.push_back(key)
        net, rest = linear.eliminatePartialSequential(others)
        ordering, columns, start = gtsam.Ordering(), {}, 0
        for key in asked:
            ordering.push_back(key)
            columns[key] = slice(start, start + _DIMENSION[chr(gtsam.Symbol(key).chr())])
            start = columns[key].stop
        information, vector = rest.hessian(ordering)
        covariance = _inverse(information)
        step = covariance @ np.ravel(vector)
        known = gtsam.VectorValues()
        for key, rows in columns.items():
            known.insert(key, step[rows])
        delta = net.optimize(known)
        for key, rows in columns.items():
            if not delta.exists(key):
                delta.insert(key, step[rows])
        self._values = self._values.retract(delta)
        return float(np.linalg.norm(step[columns[newest]][3:])), covariance, columns

    def _in_order(self, without: set[int]) -> list[int]:
        """All variables in the order of time, those that last at the end."""
        keys = self._values.keys()
        rank = {"x": 0, "v": 0, "s": 1, "b": 2}
        times = {node.number: node.t for node in self._nodes}

        def place(key: int) -> tuple[int, float]:
            symbol = gtsam.Symbol(key)
            letter = chr(symbol.chr())
            if letter in "xv":
                return 0, times[symbol.index()]
            return rank.get(letter, 3), float(symbol.index())

        return sorted((key for key in keys if key not in without), key=place)

    def _read(
        self,
        covariance: FloatArray,
        columns: dict[int, slice],
        settled: int,
        change_m: float,
        iterations: int,
    ) -> LagSolution:
        """The solution with the covariance in physical coordinates."""
        first, last = self.state(settled), self.state(-1)
        down = self._values.atUnit3(G(0))
        blocks: list[tuple[str, int, FloatArray]] = []

        def pose(prefix: str, state: NodeState, number: int) -> None:
            key = X(number)
            turn, place = np.zeros((3, 6)), np.zeros((3, 6))
            turn[:, :3], place[:, 3:] = state.R, state.R
            blocks.append((prefix + "turn", key, turn))
            blocks.append((prefix + "position", key, place))
            blocks.append((prefix + "velocity", V(number), np.eye(3)))

        pose("", last, self._nodes[-1].number)
        pose("settled_", first, self._nodes[settled].number)
        blocks.append(("bias", B(self._epoch), np.eye(6)))
        blocks.append(("gravity", G(0), self._g * down.basis()))
        blocks += [(joint, L(JOINTS.index(joint)), np.eye(3)) for joint in self._layout.joints]
        if self._knot is not None:
            blocks.append(("shoulder", S(self._knot), np.eye(3)))
        height = sum(block.shape[0] for *_, block in blocks)
        turn, rows, start = np.zeros((height, len(covariance))), {}, 0
        for name, key, block in blocks:
            rows[name] = slice(start, start + len(block))
            turn[rows[name], columns[key]] = block
            start += len(block)
        return LagSolution(
            newest=last,
            settled=first,
            bias=self.bias,
            gravity=self.gravity,
            levers={joint: self.lever(joint) for joint in self._layout.joints},
            shoulder=None if self._knot is None else np.asarray(self._values.atPoint3(S(self._knot))),
            covariance=turn @ covariance @ turn.T,
            rows=rows,
            change_m=change_m,
            iterations=iterations,
        )

    def _leave(self, before_s: float) -> None:
        """Marginalise the nodes before a time, with their knots and biases."""
        count = sum(node.t < before_s for node in self._nodes[:-2])
        if not count:
            return
        leaving, self._nodes = self._nodes[:count], self._nodes[count:]
        factors = self._left + [
            factor for node in leaving for factor in ([node.imu] if node.imu else []) + node.others
        ]
        first = self._nodes[0]
        kept_others = []
        # what ties the first node that stays to those that leave goes with them
        gone = {key for node in leaving for key in (X(node.number), V(node.number))}
        gone |= {S(node.number) for node in leaving if self._values.exists(S(node.number))} - (
            set() if self._knot is None else {S(self._knot)}
        )
        gone |= {B(epoch) for epoch in range(self._first_epoch, first.epoch)}
        self._first_epoch = first.epoch
        for node in self._nodes[:1]:
            if node.imu is not None:
                factors.append(node.imu)
                node.imu = None
        for node in self._nodes:
            kept_others = [factor for factor in node.others if not gone & set(factor.keys())]
            factors += [factor for factor in node.others if gone & set(factor.keys())]
            node.others = kept_others
        touching = gtsam.NonlinearFactorGraph()
        self._left = []
        for factor in factors:
            if gone & set(factor.keys()):
                touching.add(factor)
            else:
                self._left.append(factor)
        order = gtsam.Ordering()
        for key in [key for key in self._in_order_of(gone, leaving)]:
            order.push_back(key)
        _, rest = touching.linearize(self._values).eliminatePartialSequential(order)
        for i in range(rest.size()):
            if rest.at(i) is not None:
                self._left.append(gtsam.LinearContainerFactor(rest.at(i), self._values_of(rest.at(i).keys())))
        for key in gone:
            self._values.erase(key)

    def _in_order_of(self, gone: set[int], leaving: list[_Node]) -> list[int]:
        order = [key for node in leaving for key in (X(node.number), V(node.number))]
        return order + sorted(gone - set(order))

    def _values_of(self, keys: list[int]) -> gtsam.Values:
        """The present values of some variables."""
        values = gtsam.Values()
        for key in keys:
            letter = chr(gtsam.Symbol(key).chr())
            values.insert(key, _READ[letter](self._values, key))
        return values

    def _next_epoch(self, t: float) -> None:
        """A new bias variable where the last one is old."""
        if t - self._epoch_s < BIAS_EPOCH_S:
            return
        if np.isfinite(self._epoch_s):
            self._epoch += 1
            self._values.insert(B(self._epoch), self._values.atConstantBias(B(self._epoch - 1)))
            walk = gtsam.noiseModel.Diagonal.Sigmas(self._walk * np.sqrt(t - self._epoch_s))
            between = gtsam.BetweenFactorConstantBias(
                B(self._epoch - 1), B(self._epoch), gtsam.imuBias.ConstantBias(), walk
            )
            self._left.append(between)
        self._epoch_s = t

    _first_epoch = 0

    def _add_knot(self, node: _Node, position: FloatArray) -> None:
        """A shoulder knot at a node: near the one before, the upper arm's length from the elbow."""
        key = S(node.number)
        self._values.insert(key, np.asarray(position, dtype=float))
        if self._knot is not None:
            sigma = round(self._noise.shoulder_walk * float(np.sqrt(node.t - self._knot_s)), 6)
            between = gtsam.BetweenFactorPoint3(S(self._knot), key, np.zeros(3), isotropic(3, sigma))
            node.others.append(between)
        if self._has_upper_arm:
            model = isotropic(1, self._noise.upper_arm_sigma_m)
            elbow = Pose3(Rot3(), self._elbow)
            node.others.append(
                gtsam.RangeFactorWithTransformBias3D(
                    X(node.number), key, U(0), self._upper_arm_m, model, elbow
                )
            )
        self._knot, self._knot_s = node.number, node.t


_DIMENSION = {"x": 6, "v": 3, "b": 6, "g": 2, "u": 1, "l": 3, "s": 3}
_READ: dict[str, Callable[[gtsam.Values, int], Any]] = {
    "x": gtsam.Values.atPose3,
    "v": gtsam.Values.atVector,
    "b": gtsam.Values.atConstantBias,
    "g": gtsam.Values.atUnit3,
    "u": gtsam.Values.atDouble,
    "l": gtsam.Values.atPoint3,
    "s": gtsam.Values.atPoint3,
}


def _inverse(information: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled to unit diagonal first."""
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        raise np.linalg.LinAlgError("a direction is left free")
    scale = 1.0 / np.sqrt(diagonal)
    factor = np.linalg.cholesky(information * scale[:, None] * scale)
    half = np.linalg.solve(factor, np.diag(scale))
    return np.asarray(half.T @ half)
