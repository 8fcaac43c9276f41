"""The factors of a lag window: at a node, from node to node, and of the shoulder knots (GTSAM).

Those of a window's graph (`factors`), with what is particular to a window that moves on.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import B, S, V, X

from ..array_types import FloatArray
from ..body import FOREARM
from ..recording import JOINTS
from ..window.problem import ImuIncrements, NoiseModel, Priors
from ..window.solution import NodeState
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
from .shared_prior import bias_walk
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
    others : list of gtsam.NonlinearFactor
        All others at it.
    """

    number: int
    t: float
    epoch: int
    imu: gtsam.NonlinearFactor | None = None
    others: list[gtsam.NonlinearFactor] = field(default_factory=list)

    @property
    def factors(self) -> list[gtsam.NonlinearFactor]:
        """The IMU's first."""
        return ([] if self.imu is None else [self.imu]) + self.others


class LagFactors:
    """Makes the factors of a lag window.

    Parameters
    ----------
    priors : Priors
        On the shared quantities.
    noise : NoiseModel
    sigma_m : ndarray, shape (5,), m
        Noise of the camera's joints, an axis.
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
