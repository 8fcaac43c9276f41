"""A window at its optimum, read as arrays: states, shared quantities, lever arms, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import G, S, U

from ..array_types import FloatArray, IntArray
from ..body import SEGMENTS
from ..linalg import interpolate
from ..measurements.rays import AT_M, NEAREST_M
from ..units import GRAVITY
from ..window.problem import JointMeasurements, States, Window
from ..window.shared import SharedLayout
from ..window.solution import SegmentSolution
from .build import FactorGroup, bias_of_intervals, node_of_variables
from .linear_system import Jacobian, LinearSystem
from .shared_prior import shared_jacobian, shared_keys
from .variables import keys_of, letter_of


@dataclass(frozen=True)
class SolvedWindow:
    """A window's variables at some values; it does not travel between processes."""

    window: Window  # With what cameras without depth saw linearised there
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    groups: Sequence[FactorGroup]  # Of the graph

    @cached_property
    def biases(self) -> IntArray:
        """Which bias variable each interval uses, (n - 1,)."""
        return bias_of_intervals(self.window)

    @cached_property
    def bodies(self) -> list[SegmentSolution]:
        """The solution of each IMU, without covariances."""
        window, values, bodies, n = self.window, self.values, [], len(self.window.t)
        poses = gtsam.utilities.extractPose3(values)
        gravity = window.priors.layout.down(self.shared) * GRAVITY
        for name in window.priors.layout.segments:
            keys = keys_of(name)
            known = np.zeros(n, dtype=bool)
            for run in window.runs(name):
                known[run.nodes] = True
            own, poses = np.split(poses, [int(known.sum())])
            R, p, v = np.tile(np.eye(3), (n, 1, 1)), np.full((n, 3), np.nan), np.full((n, 3), np.nan)
            R[known], p[known] = own[:, :9].reshape(-1, 3, 3), own[:, 9:]
            if known.any():
                v[known] = gtsam.utilities.extractVectors(values, letter_of(keys.velocity))
            count = int(self.biases[-1]) + 1
            bias = np.array([values.atConstantBias(keys.bias + k).vector() for k in range(count)])
            own_bias = bias[np.append(self.biases, self.biases[-1])]
            bodies.append(SegmentSolution(name, window.t, States(R, p, v), own_bias, gravity))
        return bodies

    @cached_property
    def states(self) -> dict[str, States]:
        """Of each IMU by its segment."""
        return {body.segment: body.states for body in self.bodies}

    @cached_property
    def shared(self) -> FloatArray:
        """The shared quantities as one vector (s,)."""
        values, layout, prior = self.values, self.window.priors.layout, self.window.priors.shared
        mean = np.empty(layout.size)
        mean[layout.gravity] = layout.gravity_axes @ values.atUnit3(G(0)).point3()
        if layout.has_upper_arm:
            # the factor's error is range + U - length: the true length is shorter by U
            mean[layout.upper_arm] = prior.mean[layout.upper_arm] - values.atDouble(U(0))
        for segment in layout.segments:
            keys = keys_of(segment)
            mean[layout.bias_of(segment)] = values.atConstantBias(keys.bias + self.middle_bias).vector()
            for joint, rows in layout.levers(segment).items():
                mean[rows] = values.atPoint3(keys.lever_of(joint))
        return mean

    @property
    def middle_bias(self) -> int:
        """Number of the bias of the window's middle: that of the shared vector."""
        return (int(self.biases[-1]) + 1) // 2

    @property
    def shared_keys(self) -> list[int]:
        """Keys of the shared variables in the order of the shared vector."""
        return shared_keys(self.window.priors.layout, self.middle_bias)

    @property
    def shared_jacobian(self) -> FloatArray:
        """The shared vector's change for a change of GTSAM's own coordinates, (s, s)."""
        return shared_jacobian(self.window.priors.layout, self.values.atUnit3(G(0)))

    @cached_property
    def knots(self) -> FloatArray:
        """The shoulder at its knots (k, 3), m."""
        shoulder = self.window.shoulder
        count = 0 if shoulder is None else len(shoulder.node)
        return np.array([self.values.atPoint3(S(k)) for k in range(count)]).reshape(-1, 3)

    @property
    def shoulder(self) -> FloatArray | None:
        """The shoulder at the nodes (n, 3), m; None where the camera saw none."""
        if self.window.shoulder is None:
            return None
        return interpolate(self.window.t[self.window.shoulder.node], self.knots, self.window.t)

    def joint_at_nodes(self, measured: JointMeasurements) -> FloatArray:
        """Where a joint is at the nodes of its samples (k, 3), m."""
        rows = self.window.priors.layout.levers(measured.segment).get(measured.joint)
        lever, own = np.zeros(3) if rows is None else self.shared[rows], self.states[measured.segment]
        return np.asarray(own.p[measured.node] + own.R[measured.node] @ lever)

    def joints(self) -> dict[str, FloatArray]:
        """All joints, at their samples' nodes by `JointMeasurements.key`, the shoulder at its knots."""
        joints = {measured.key: self.joint_at_nodes(measured) for measured in self.window.joint_measurements}
        return joints if self.window.shoulder is None else joints | {"shoulder": self.knots}

    def residuals(self) -> dict[str, FloatArray]:
        """Camera minus answer by `JointMeasurements.key`; of cameras without depth across rays, at `AT_M`."""
        residuals = {}
        for measured in self.window.joint_measurements:
            answer = self.joint_at_nodes(measured)
            residual, rays = measured.position - measured.shift - answer, measured.rays
            if rays is not None and measured.origin_m is not None:
                residual = residual - np.sum(residual * rays, axis=1, keepdims=True) * rays
                distance = np.linalg.norm(answer + measured.shift - measured.origin_m, axis=1)
                residual *= AT_M / np.maximum(distance, NEAREST_M)[:, None]
            residuals[measured.key] = residual
        return residuals

    @cached_property
    def jacobian(self) -> Jacobian:
        """The whitened Jacobian of the graph."""
        return Jacobian.of(self.graph, self.values)

    def system(self, extra: Sequence[FloatArray] = (), in_common: float = 1.0) -> LinearSystem:
        """The normal equations, with columns of further quantities; camera variances times a number."""
        jacobian = self.jacobian
        if in_common != 1.0:
            scale = np.ones(len(jacobian.rhs))
            for group in self.groups:
                if group.kind == "camera":
                    scale[group.rows] = in_common**-0.5
            jacobian, extra = jacobian.scaled(scale), [scale[:, None] * each for each in extra]
        return LinearSystem(jacobian, node_of_variables(self.window), extra)


def levers_of(shared: FloatArray, layout: SharedLayout) -> dict[str, FloatArray]:
    """Lever arms (3,) m by joint, each in the axes of the IMU that the joint is tied to."""
    levers = {joint: shared[layout.lever(joint)] for joint in layout.joints}
    for name in layout.further:
        rows_of = layout.levers(name)
        tied = (joint for joint in SEGMENTS[name].camera_joints if joint in rows_of)
        levers |= {joint: shared[rows_of[joint]] for joint in tied}
    return levers
