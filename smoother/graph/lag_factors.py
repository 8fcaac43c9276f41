"""The nodes of a lag window, and the factors at them (GTSAM)."""

from __future__ import annotations

from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam import Pose3, Rot3
from gtsam.symbol_shorthand import S

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..recording import JOINTS
from ..window.problem import ImuIncrements, NoiseModel, Priors
from ..window.solution import NodeState
from .build import PARENT_TIE_M, tissue_sigma
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
class LagBody:
    """A segment with an IMU at a node."""

    before: int = -1  # Number of the node that the IMU's factor begins at; -1 where there is no such factor
    imu: gtsam.NonlinearFactor | None = None  # The IMU's from that node
    others: list[gtsam.NonlinearFactor] = field(default_factory=list)  # All others of the segment

    def release(self) -> list[gtsam.NonlinearFactor]:
        """The IMU's factor, which is taken from it."""
        imu, self.imu, self.before = self.imu, None, -1
        return [] if imu is None else [imu]


@dataclass
class LagNode:
    """A node with its factors."""

    number: int  # Of its variables
    t: float  # s
    epoch: int  # Number of its bias variables
    # The segments that have variables at it, the forearm first
    bodies: dict[str, LagBody] = field(default_factory=lambda: {FOREARM.name: LagBody()})
    camera: list[gtsam.NonlinearFactor] = field(default_factory=list)  # What the camera saw at it
    others: list[gtsam.NonlinearFactor] = field(default_factory=list)  # All others at it
    # Joints that the camera saw, of segments that have no variables at it yet
    waiting: list[tuple[str, FloatArray]] = field(default_factory=list)

    @property
    def factors(self) -> list[gtsam.NonlinearFactor]:
        """The IMUs' first."""
        imus = [body.imu for body in self.bodies.values() if body.imu is not None]
        return imus + self.camera + self.others + [each for b in self.bodies.values() for each in b.others]

    @property
    def state_keys(self) -> list[int]:
        """Keys of the variables of all its segments."""
        return [key for segment in self.bodies for key in state_keys_of(segment, self.number)]


def state_keys_of(segment: str, number: int) -> list[int]:
    """Keys of a segment's pose and velocity at a node, and of the joint that it shares with its parent."""
    keys, has_point = keys_of(segment), bool(SEGMENTS[segment].shared_joint)
    return [keys.pose + number, keys.velocity + number, *([keys.point + number] if has_point else [])]


class LagFactors:
    """Makes the factors of a lag window."""

    def __init__(
        self, priors: Priors, noise: NoiseModel, sigma_m: FloatArray, gravity_magnitude: float
    ) -> None:
        self._noise, self._sigma_m, self._g = noise, sigma_m, gravity_magnitude
        self._walk = priors.bias_walk
        layout, mean = priors.layout, priors.shared.mean
        self._has_upper_arm = layout.has_upper_arm
        self._upper_arm_m = float(mean[layout.upper_arm].sum())
        self._elbow = mean[layout.lever("elbow")] if layout.has_upper_arm else np.zeros(3)
        self._levers = {segment: tuple(layout.levers(segment)) for segment in layout.segments}
        #: Where the joint that a segment shares with its parent is in its IMU's axes, (3,) m.
        self.shared_joint_m = {
            segment: mean[layout.lever(SEGMENTS[segment].shared_joint, segment)] for segment in layout.further
        }
        self._params: dict[tuple[int, int], gtsam.PreintegrationParams] = {}

    def first(
        self, number: int, state: NodeState, segment: str = FOREARM.name
    ) -> list[gtsam.NonlinearFactor]:
        """Wide priors on a segment's first node, `PriorFactorPose3` and `PriorFactorVector`."""
        keys = keys_of(segment)
        model = gtsam.noiseModel.Diagonal.Sigmas(np.repeat([FIRST_TURN_RAD, FIRST_POSITION_M], 3))
        pose = Pose3(Rot3(state.R), state.p)
        return [
            gtsam.PriorFactorPose3(keys.pose + number, pose, model),
            gtsam.PriorFactorVector(keys.velocity + number, state.v, isotropic(3, FIRST_VELOCITY)),
        ]

    def imu(
        self, before: LagNode, node: LagNode, increments: ImuIncrements, segment: str = FOREARM.name
    ) -> gtsam.NonlinearFactor:
        """One interval of an IMU, `ImuFactorWithGravityDirection` (Forster et al., TRO 2017)."""
        level = noise_levels(increments, np.array([node.t - before.t]), self._noise, self._g)[0]
        if level not in self._params:
            self._params[level] = preintegration_parameters(self._noise, self._g, *level)
        (pim,) = preintegrate(increments, [self._params[level]])
        return imu_factor(keys_of(segment), before.number, node.number, node.epoch, pim, self._g)

    def constant_velocity(self, number: int, change: float) -> gtsam.NonlinearFactor:
        """The velocity changes by no more than about `change`, m/s, from the node before."""
        return constant_velocity(number - 1, round(change, 4))

    def bias_walk(self, epoch: int, length_s: float, segment: str) -> gtsam.NonlinearFactor:
        """A bias variable near the one before it, `BetweenFactorConstantBias`."""
        model, bias = gtsam.noiseModel.Diagonal.Sigmas(self._walk * np.sqrt(length_s)), keys_of(segment).bias
        return bias_walk(bias + epoch - 1, bias + epoch, model)

    def joint(self, number: int, joint: str, position: FloatArray, segment: str) -> gtsam.NonlinearFactor:
        """A segment's joint where the camera sees it, `GPSFactorArmCalib` or `GPSFactorArm`."""
        keys = keys_of(segment)
        lever = keys.lever_of(joint) if joint in self._levers[segment] else None
        return joint_factor(keys.pose + number, lever, position, self._robust(joint))

    def shared_joint(self, number: int, segment: str, step_s: float) -> list[gtsam.NonlinearFactor]:
        """The joint that a segment shares with its parent, `ReferenceFrameFactorPoint3Pose3` for each."""
        body, own = SEGMENTS[segment], keys_of(segment)
        ties = (keys_of(body.parent), PARENT_TIE_M), (own, self._tissue(segment, step_s))
        return [
            gtsam.ReferenceFrameFactorPoint3Pose3(
                keys.lever_of(body.shared_joint), keys.pose + number, own.point + number, isotropic(3, sigma)
            )
            for keys, sigma in ties
        ]

    def shoulder_end(self, number: int, segment: str, step_s: float) -> list[gtsam.NonlinearFactor]:
        """A segment that reaches the shoulder ends in its node's knot, `ReferenceFrameFactorPoint3Pose3`."""
        if "shoulder" not in SEGMENTS[segment].joints:
            return []
        keys, model = keys_of(segment), isotropic(3, self._tissue(segment, step_s))
        ends = keys.lever_of("shoulder"), keys.pose + number, S(number)
        return [gtsam.ReferenceFrameFactorPoint3Pose3(*ends, model)]

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

    def _tissue(self, segment: str, step_s: float) -> float:
        return float(tissue_sigma(self._noise, segment, np.array([step_s]))[0])

    def _robust(self, joint: str) -> gtsam.noiseModel.Robust:
        return robust(round(float(self._sigma_m[JOINTS.index(joint)]), 6), self._noise.cauchy)
