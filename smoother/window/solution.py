"""What a window answers, as plain arrays, which travel between processes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..array_types import FloatArray
from ..linalg import interpolate
from .problem import States
from .shared import ErrorEvidence


@dataclass(frozen=True)
class BlockShift:
    """A block of camera samples against the rest of its window."""

    start_s: float  # On the IMU's clock
    end_s: float  # On the IMU's clock
    shift_m: FloatArray  # (3,): what the block has to be moved by in {K}
    score: float  # Squared shift in sigmas / 3, the camera's slow errors allowed for
    camera: int = 0  # Whose samples they are


@dataclass(frozen=True)
class Step:
    """Something that may have changed for good at some moment."""

    kind: str  # `camera` (turns, rad, and moves, m), `place` (moves), `mounting` (as the camera), `clock` (s)
    at_s: float  # On the IMU's clock
    size: FloatArray  # By how much
    squared: float  # In sigmas, squared, with what is allowed


@dataclass(frozen=True)
class WindowDraws:
    """Deviations of drawn motions from a window's answer at its nodes."""

    position: FloatArray  # (k, n, 3) m: of the IMU, in {K}
    rotation: FloatArray  # (k, n, 3) rad: in {K}
    velocity: FloatArray  # (k, n, 3) m/s: in {K}
    shoulder: FloatArray | None  # (k, n, 3) m
    shared_covariance: FloatArray  # (s, s): of the shared vector
    levers: dict[str, FloatArray]  # (k, 3) m by joint of the forearm, in the IMU's axes
    # dict of (k, n, 3) rad: Rotation of each further IMU in {K} by its segment, nan where it has no samples
    turns: dict[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class SegmentSolution:
    """A window's answer on the IMU of a segment, at all of the window's nodes."""

    segment: str  # Name of the segment
    t: FloatArray  # (n,) s: the nodes on the forearm IMU's clock
    states: States  # Orientation to {K}, position and velocity of the IMU; position nan without samples
    bias: FloatArray  # (n, 6) m/s^2 and rad/s
    gravity: FloatArray  # (3,) or (n, 3) m/s^2: in {K}
    # (n, 6, 6) m^2, m rad, rad^2: of (position, rotation vector) in {K}; None where not asked for
    pose_covariance: FloatArray | None = None
    velocity_covariance: FloatArray | None = None  # (n, 3, 3) m^2/s^2: in {K}, of the forearm
    # (n, 3, 3) m^2: Of joints that have a lever arm on it, in the IMU's axes
    joint_covariance: dict[str, FloatArray] = field(default_factory=dict)

    def of_nodes(self, nodes: slice) -> SegmentSolution:
        """States at some of the nodes."""
        gravity = self.gravity if self.gravity.ndim == 1 else self.gravity[nodes]
        states = self.states.rows(nodes)
        return SegmentSolution(self.segment, self.t[nodes], states, self.bias[nodes], gravity)

    def pose_covariance_at(self, t: FloatArray) -> FloatArray:
        """The pose's covariance (k, 6, 6) between the nodes; nan where the IMU has no samples."""
        assert self.pose_covariance is not None
        return interpolate(self.t, self.pose_covariance, t)


@dataclass(frozen=True)
class Solution:
    """A window's answer: the arm at its nodes."""

    bodies: tuple[SegmentSolution, ...]  # Of each segment with an IMU, the forearm first
    shoulder: FloatArray | None  # (n, 3) m: in {K}; None where the camera saw no shoulder
    shoulder_covariance: FloatArray | None  # (n, 3, 3) m^2; None where not asked for
    shared: FloatArray  # (s,): the shared quantities (`SharedLayout`), the bias at the window's middle
    levers: dict[str, FloatArray]  # (3,) m by joint, in the axes of the IMU that it is tied to
    # dict of (k, 3) m: By joint, camera minus answer in the order of `JointMeasurements`
    residuals: dict[str, FloatArray]
    iterations: int  # Of the optimiser
    error: float  # Half the weighted squared sum
    offset_information: float = 0.0  # On a clock offset of the window's own; 0 where not asked for
    accepted: bool = True  # The model explains the motion in the window's long gaps
    evidence: ErrorEvidence | None = None  # On errors that are constant over the recording
    draws: WindowDraws | None = None  # Drawn from the posterior; None where not asked for
    shifts: tuple[BlockShift, ...] = ()  # Blocks of the camera's samples against the rest

    @property
    def t(self) -> FloatArray:
        """The nodes (n,) s on the forearm IMU's clock."""
        return self.forearm.t

    @property
    def forearm(self) -> SegmentSolution:
        """The forearm's."""
        return self.bodies[0]

    def of(self, segment: str) -> SegmentSolution | None:
        """A segment's; None where it has no IMU."""
        return next((body for body in self.bodies if body.segment == segment), None)

    def lever(self, joint: str) -> FloatArray:
        """A joint's lever arm (3,) m; 0 for the IMU itself."""
        return self.levers.get(joint, np.zeros(3))


@dataclass(frozen=True)
class NodeState:
    """Pose and velocity of the IMU at one moment."""

    t: float  # s: on the IMU's clock
    R: FloatArray  # (3, 3): `R_K_A`
    p: FloatArray  # (3,) m: in {K}
    v: FloatArray  # (3,) m/s: in {K}


@dataclass(frozen=True)
class LagSolution:
    """A solved window."""

    newest: NodeState
    settled: NodeState  # Of the node that was asked for
    bias: FloatArray  # (6,) m/s^2 and rad/s: the newest
    gravity: FloatArray  # (3,) m/s^2: in {K}
    levers: dict[str, FloatArray]  # dict of (3,) m: in {A}
    shoulder: FloatArray | None  # (3,) m: the newest knot's, in {K}; None before the camera saw one
    covariance: FloatArray  # (c, c): joint, of the rows below; rotations as vectors in {K}
    rows: dict[str, slice]  # `turn`, `position`, `velocity`, `bias`, `gravity` of the newest node

    def block(self, *names: str) -> FloatArray:
        """Joint covariance of some of the rows, in the order asked for."""
        index = np.array([i for name in names for i in range(self.rows[name].start, self.rows[name].stop)])
        return self.covariance[index[:, None], index]


#: A stretch fails where its mean squared error is this many times what is stated, and the error so large, m:
#: the worst of twelve sound simulated recordings was 2.1.
FAILED_NEES, FAILED_M = 6.0, 0.05


@dataclass(frozen=True)
class HiddenStretch:
    """A stretch that was hidden."""

    start_s: float  # On the IMU's clock
    end_s: float  # On the IMU's clock
    samples: int = 0  # Camera samples that were compared; 0 where it could not be recovered
    rms_m: float = float("nan")  # 3D error
    stated_m: float = float("nan")  # What was stated of it, the camera's noise included
    inside: int = 0  # Samples inside the 95 % region
    nees: float = float("nan")  # Mean squared error in sigmas / 3
    error_m: tuple[float, ...] = ()  # 3D error of each sample
    stated_95_m: float = float("nan")  # Distance within which 95 of 100 of them should lie
    contradicting: tuple[int, ...] = ()  # Cameras whose samples lie where by the rest they cannot be

    @property
    def failed(self) -> bool:
        """It could not be recovered, or was recovered elsewhere with a sigma that contradicts them."""
        return self.samples == 0 or self.contradicted

    @property
    def contradicted(self) -> bool:
        """What was seen is where by the rest it cannot be."""
        return self.nees > FAILED_NEES and self.rms_m > FAILED_M
