"""What is read from a lag window: the variables to ask for, and the answer as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, L, S, U, V, X

from ..array_types import FloatArray
from ..recording import JOINTS
from ..window.lag_solution import LagSolution, NodeState
from ..window.shared import SharedLayout
from .gravity_axes import gravity_axes
from .lag_factors import LagNode
from .lag_iteration import LagIteration


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
