"""What a window answers, as plain arrays, which travel between processes."""

from __future__ import annotations

from dataclasses import dataclass

from ..array_types import BoolArray, FloatArray
from .block_shift import BlockShift
from .constant_errors import ErrorEvidence
from .drawn_window import WindowDraws
from .problem import States
from .shared import Gaussian


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
class UpperSolution:
    """A window's answer on the upper-arm IMU, at all of its nodes.

    Attributes
    ----------
    known : ndarray of bool, shape (n,)
        Nodes at which that IMU has samples; elsewhere orientation is the identity and the rest nan.
    states : States
        `R_K_B`, position and velocity of that IMU.
    pose_covariance : ndarray, shape (n, 6, 6), m^2, m rad, rad^2, or None
        Of (position, rotation vector) in {K}; None where not asked for.
    bias : ndarray, shape (n, 6), m/s^2 and rad/s
    """

    known: BoolArray
    states: States
    pose_covariance: FloatArray | None
    bias: FloatArray


@dataclass(frozen=True)
class Solution:
    """A window's answer.

    Attributes
    ----------
    index : int
        Of the window.
    states : States
        At the window's nodes.
    pose_covariance : ndarray, shape (n, 6, 6), m^2, m rad, rad^2, or None
        Of (position, rotation vector) in {K}; None where not asked for.
    velocity_covariance : ndarray, shape (n, 3, 3), m^2/s^2, or None
        In {K}; None where not asked for.
    shoulder : ndarray, shape (k, 3), m, or None
        At the knots, in {K}.
    shoulder_covariance : ndarray, shape (k, 3, 3), m^2, or None
        At the knots; None where not asked for.
    message : Message
        The shared quantities.
    bias : ndarray, shape (n, 6), m/s^2 and rad/s
        At the nodes.
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
    upper : UpperSolution or None
        None where the recording has no upper-arm IMU.
    draws : WindowDraws or None
        Drawn from the posterior; None where not asked for.
    shifts : tuple of BlockShift
        Blocks of the camera's samples against the rest; empty where not asked for.
    """

    index: int
    states: States
    pose_covariance: FloatArray | None
    velocity_covariance: FloatArray | None
    shoulder: FloatArray | None
    shoulder_covariance: FloatArray | None
    message: Message
    bias: FloatArray
    residuals: dict[str, FloatArray]
    iterations: int
    error: float
    offset_information: float = 0.0
    accepted: bool = True
    evidence: ErrorEvidence | None = None
    upper: UpperSolution | None = None
    draws: WindowDraws | None = None
    shifts: tuple[BlockShift, ...] = ()
