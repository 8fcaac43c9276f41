"""What a window answers, as plain arrays, which travel between processes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import interpolate
from .problem import States
from .shared import ErrorEvidence, Gaussian


@dataclass(frozen=True)
class BlockShift:
    """A block of camera samples against the rest of its window."""

    start_s: float  # On the IMU's clock
    end_s: float  # On the IMU's clock
    shift_m: FloatArray  # (3,): what the block has to be moved by in {K}
    score: float  # Squared shift in sigmas / 3, the camera's slow errors allowed for
    camera: int = 0  # Whose samples they are


@dataclass(frozen=True)
class WindowDraws:
    """Deviations of drawn motions from a window's answer, or a section's."""

    position: FloatArray  # (k, n, 3) m: of the IMU at the nodes, in {K}
    rotation: FloatArray  # (k, n, 3) rad: in {K}
    velocity: FloatArray  # (k, n, 3) m/s: in {K}
    shoulder: FloatArray | None  # (k, s, 3) m: at the knots of a window, at the nodes of a section
    # dict of (k, n, 3) rad: Rotation of each further IMU in {K} by its segment, nan where it has no samples
    turns: dict[str, FloatArray] = field(default_factory=dict)

    def at_nodes(self, knots: FloatArray, t: FloatArray) -> WindowDraws:
        """With the shoulder at all nodes (n,), by linear interpolation between its knots' times (s,)."""
        if self.shoulder is None:
            return self
        shoulder = np.moveaxis(interpolate(knots, np.moveaxis(self.shoulder, 1, 0), t), 0, 1)
        return replace(self, shoulder=shoulder)

    def columns(self) -> dict[str, FloatArray]:
        """What there is, by name; `turn_` before a segment's."""
        named = {"position": self.position, "rotation": self.rotation, "velocity": self.velocity}
        named |= {} if self.shoulder is None else {"shoulder": self.shoulder}
        return named | {f"turn_{segment}": values for segment, values in self.turns.items()}

    @classmethod
    def from_columns(cls, columns: dict[str, FloatArray]) -> WindowDraws:
        """What `columns` gives."""
        turns = {name.removeprefix("turn_"): v for name, v in columns.items() if name.startswith("turn_")}
        shoulder = columns.get("shoulder")
        return cls(columns["position"], columns["rotation"], columns["velocity"], shoulder, turns)


@dataclass(frozen=True)
class Message:
    """A window's answer on the shared quantities."""

    t_s: float  # The window's middle, where the bias holds
    shared: Gaussian  # Posterior of the shared vector; the window's prior is still inside


@dataclass(frozen=True)
class SegmentSolution:
    """A window's answer on the IMU of a segment, at all of the window's nodes."""

    segment: str  # Name of the segment
    known: BoolArray  # bool (n,): nodes at which that IMU has samples
    states: States  # Orientation to {K}, position and velocity of the IMU
    pose_covariance: FloatArray | None  # (n, 6, 6) m^2, m rad, rad^2: of (position, rotation vector) in {K}
    velocity_covariance: FloatArray | None  # (n, 3, 3) m^2/s^2: in {K}, of the forearm
    bias: FloatArray  # (n, 6) m/s^2 and rad/s


@dataclass(frozen=True)
class Solution:
    """A window's answer."""

    index: int  # Of the window
    bodies: tuple[SegmentSolution, ...]  # Of each segment with an IMU, the forearm first
    shoulder: FloatArray | None  # (k, 3) m: at the knots, in {K}
    shoulder_covariance: FloatArray | None  # (k, 3, 3) m^2: at the knots; None where not asked for
    message: Message  # The shared quantities
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
    def forearm(self) -> SegmentSolution:
        """The forearm's."""
        return self.bodies[0]

    def of(self, segment: str) -> SegmentSolution:
        """A segment's, which has an IMU."""
        return next(body for body in self.bodies if body.segment == segment)


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

    newest: NodeState  # Of the newest node, and of the one that `settled` was asked for
    settled: NodeState  # Of the newest node, and of the one that `settled` was asked for
    bias: FloatArray  # (6,) m/s^2 and rad/s: the newest
    gravity: FloatArray  # (3,) m/s^2: in {K}
    levers: dict[str, FloatArray]  # dict of (3,) m: in {A}
    shoulder: FloatArray | None  # (3,) m: the newest knot's, in {K}; None before the camera saw one
    covariance: FloatArray  # (c, c): joint, of the rows below; rotations as vectors in {K}
    rows: dict[str, slice]  # `turn`, `position`, `velocity`, `bias`, `gravity` of the newest node
    change_m: float  # How far the last iteration moved the newest node
    iterations: int

    def block(self, *names: str) -> FloatArray:
        """Joint covariance of some of the rows, in the order asked for."""
        index = np.array([i for name in names for i in range(self.rows[name].start, self.rows[name].stop)])
        return self.covariance[index[:, None], index]
