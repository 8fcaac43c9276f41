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
    """A block of camera samples against the rest of its window.

    Attributes
    ----------
    start_s, end_s : float, s
        On the IMU's clock.
    shift_m : ndarray, shape (3,)
        What the block has to be moved by in {K}.
    score : float
        Squared shift in sigmas / 3, the camera's slow errors allowed for; about 1 where it is chance.
    camera : int
        Whose samples they are.
    """

    start_s: float
    end_s: float
    shift_m: FloatArray
    score: float
    camera: int = 0


@dataclass(frozen=True)
class WindowDraws:
    """Deviations of drawn motions from a window's answer, or a section's.

    Attributes
    ----------
    position : ndarray, shape (k, n, 3), m
        Of the IMU at the nodes, in {K}.
    rotation : ndarray, shape (k, n, 3), rad
        In {K}.
    velocity : ndarray, shape (k, n, 3), m/s
        In {K}.
    shoulder : ndarray, shape (k, s, 3), m, or None
        At the knots of a window, at the nodes of a section; None where the camera saw no shoulder.
    turns : dict of str to ndarray, shape (k, n, 3), rad
        Rotation of each further IMU in {K} by its segment, nan where it has no samples.
    """

    position: FloatArray
    rotation: FloatArray
    velocity: FloatArray
    shoulder: FloatArray | None
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
    """A window's answer on the shared quantities.

    Attributes
    ----------
    t_s : float, s
        The window's middle, where the bias holds.
    shared : Gaussian
        Posterior of the shared vector; the window's prior is still inside.
    """

    t_s: float
    shared: Gaussian


@dataclass(frozen=True)
class SegmentSolution:
    """A window's answer on the IMU of a segment, at all of the window's nodes.

    Attributes
    ----------
    segment : str
        Name of the segment.
    known : ndarray of bool, shape (n,)
        Nodes at which that IMU has samples; elsewhere orientation is the identity and the rest nan.
    states : States
        Orientation to {K}, position and velocity of the IMU.
    pose_covariance : ndarray, shape (n, 6, 6), m^2, m rad, rad^2, or None
        Of (position, rotation vector) in {K}; None where not asked for.
    velocity_covariance : ndarray, shape (n, 3, 3), m^2/s^2, or None
        In {K}, of the forearm; None where not asked for.
    bias : ndarray, shape (n, 6), m/s^2 and rad/s
    """

    segment: str
    known: BoolArray
    states: States
    pose_covariance: FloatArray | None
    velocity_covariance: FloatArray | None
    bias: FloatArray


@dataclass(frozen=True)
class Solution:
    """A window's answer.

    Attributes
    ----------
    index : int
        Of the window.
    bodies : tuple of SegmentSolution
        Of each segment with an IMU, the forearm first.
    shoulder : ndarray, shape (k, 3), m, or None
        At the knots, in {K}.
    shoulder_covariance : ndarray, shape (k, 3, 3), m^2, or None
        At the knots; None where not asked for.
    message : Message
        The shared quantities.
    residuals : dict of str to ndarray, shape (k, 3), m
        By joint, camera minus answer in the order of `JointMeasurements`.
    iterations : int
        Of the optimiser.
    error : float
        Half the weighted squared sum.
    offset_information : float, 1/s^2
        On a clock offset of the window's own; 0 where not asked for.
    accepted : bool
        The model explains the motion in the window's long gaps; where False the upper arm is left out
        there, so that the covariance covers what is open.
    evidence : ErrorEvidence or None
        On errors that are constant over the recording; None where not asked for.
    draws : WindowDraws or None
        Drawn from the posterior; None where not asked for.
    shifts : tuple of BlockShift
        Blocks of the camera's samples against the rest; empty where not asked for.
    """

    index: int
    bodies: tuple[SegmentSolution, ...]
    shoulder: FloatArray | None
    shoulder_covariance: FloatArray | None
    message: Message
    residuals: dict[str, FloatArray]
    iterations: int
    error: float
    offset_information: float = 0.0
    accepted: bool = True
    evidence: ErrorEvidence | None = None
    draws: WindowDraws | None = None
    shifts: tuple[BlockShift, ...] = ()

    @property
    def forearm(self) -> SegmentSolution:
        """The forearm's."""
        return self.bodies[0]

    def of(self, segment: str) -> SegmentSolution:
        """A segment's, which has an IMU."""
        return next(body for body in self.bodies if body.segment == segment)


@dataclass(frozen=True)
class NodeState:
    """Pose and velocity of the IMU at one moment.

    Attributes
    ----------
    t : float, s
        On the IMU's clock.
    R : ndarray, shape (3, 3)
        `R_K_A`.
    p : ndarray, shape (3,), m
        In {K}.
    v : ndarray, shape (3,), m/s
        In {K}.
    """

    t: float
    R: FloatArray
    p: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class LagSolution:
    """A solved window.

    Attributes
    ----------
    newest, settled : NodeState
        Of the newest node, and of the one that `settled` was asked for.
    bias : ndarray, shape (6,), m/s^2 and rad/s
        The newest.
    gravity : ndarray, shape (3,), m/s^2
        In {K}.
    levers : dict of str to ndarray, shape (3,), m
        In {A}.
    shoulder : ndarray, shape (3,), m, or None
        The newest knot's, in {K}; None before the camera saw one.
    covariance : ndarray, shape (c, c)
        Joint, of the rows below; rotations as vectors in {K}.
    rows : dict of str to slice
        `turn`, `position`, `velocity`, `bias`, `gravity` of the newest node; `settled_turn`,
        `settled_position`, `settled_velocity`; `shoulder`; and the lever arms by joint.
    change_m : float, m
        How far the last iteration moved the newest node.
    iterations : int
    """

    newest: NodeState
    settled: NodeState
    bias: FloatArray
    gravity: FloatArray
    levers: dict[str, FloatArray]
    shoulder: FloatArray | None
    covariance: FloatArray
    rows: dict[str, slice]
    change_m: float
    iterations: int

    def block(self, *names: str) -> FloatArray:
        """Joint covariance of some of the rows, in the order asked for."""
        index = np.array([i for name in names for i in range(self.rows[name].start, self.rows[name].stop)])
        return self.covariance[index[:, None], index]
