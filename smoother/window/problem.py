"""One window as plain arrays: what a graph is built from.

It travels between processes, so it holds arrays and numbers only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..measurements.outliers import noise_key
from ..measurements.rays import directions
from .shared import Considered, Gaussian, SharedLayout


@dataclass(frozen=True)
class Priors:
    """A window's prior on the quantities that it shares with the rest of the recording.

    Attributes
    ----------
    layout : SharedLayout
        Which rows of the shared vector contain which quantity.
    shared : Gaussian
        On the shared vector, with the bias at the window's middle.
    bias_walk : ndarray, shape (6,), m/s^2/sqrt(s) and rad/s/sqrt(s)
        How far the bias wanders inside the window.
    """

    layout: SharedLayout
    shared: Gaussian
    bias_walk: FloatArray


@dataclass(frozen=True)
class ImuIncrements:
    """Equivalent IMU samples of the window's intervals (see `inertial.equivalent_samples`).

    Attributes
    ----------
    acc : ndarray, shape (m, 2, 3), m/s^2
        Specific force in the halves of the steps, without the bias.
    gyro : ndarray, shape (m, 3), rad/s
        Angular rate in the steps, without the bias.
    h : ndarray, shape (m,), s
        Half of each step.
    first : ndarray of int, shape (n,)
        Index of each interval's first step, and m at the end.
    bias : ndarray, shape (6,), m/s^2 and rad/s
        The bias that was subtracted.
    velocity_error : ndarray, shape (n - 1,), m/s
        What impacts may have cost in each interval.
    turn_error : ndarray, shape (n - 1,), rad, optional
        What missing samples may have cost the direction in each interval.
    """

    acc: FloatArray
    gyro: FloatArray
    h: FloatArray
    first: IntArray
    bias: FloatArray
    velocity_error: FloatArray
    turn_error: FloatArray | None = None


@dataclass(frozen=True)
class JointMeasurements:
    """A joint's accepted camera samples.

    Attributes
    ----------
    joint : str
        Its name.
    t_s : ndarray, shape (k,), s
        Frame times on the IMU's clock.
    node : ndarray of int, shape (k,)
        Index of the node that each belongs to, increasing.
    position : ndarray, shape (k, 3), m
        In {K}.
    sigma_m : ndarray, shape (k,), m
        Standard deviation per axis.
    shift : ndarray, shape (k, 3), m
        The joint at the frame less the joint at the node in {K}, by the IMU; zero for a frame that is a
        node.
    velocity : ndarray, shape (k, 3), m/s
        The joint's velocity at the frame less the IMU's at the node, in {K}.
    segment : str
        The segment whose IMU it is tied to.
    camera : int
        Number of the camera that saw it.
    origin_m : ndarray, shape (3,), m, or None
        Where that camera's rays begin, if it sees no depth (`measurements.rays`).
    """

    joint: str
    t_s: FloatArray
    node: IntArray
    position: FloatArray
    sigma_m: FloatArray
    shift: FloatArray
    velocity: FloatArray
    segment: str = FOREARM.name
    camera: int = 0
    origin_m: FloatArray | None = None

    @property
    def rays(self) -> FloatArray | None:
        """Unit vectors (k, 3) along the samples' rays; None of a camera with depth."""
        return None if self.origin_m is None else directions(self.position, self.origin_m)

    @property
    def key(self) -> str:
        """Its name among the samples of all cameras (`noise_key`)."""
        return noise_key(self.joint, self.camera)

    @classmethod
    def joined(cls, parts: Sequence[JointMeasurements]) -> JointMeasurements:
        """One joint's samples of several runs of its IMU, in order of time."""
        return cls(
            parts[0].joint,
            np.concatenate([part.t_s for part in parts]),
            np.concatenate([part.node for part in parts]),
            np.concatenate([part.position for part in parts]),
            np.concatenate([part.sigma_m for part in parts]),
            np.concatenate([part.shift for part in parts]),
            np.concatenate([part.velocity for part in parts]),
            parts[0].segment,
            parts[0].camera,
            parts[0].origin_m,
        )


@dataclass(frozen=True)
class ShoulderMeasurements:
    """The shoulder's knots: where the smooth shoulder has a variable.

    Attributes
    ----------
    node : ndarray of int, shape (k,)
        The node whose time the knot shares.
    position : ndarray, shape (k, 3), m
        In {K}; nan where the camera saw no shoulder.
    sigma_m : ndarray, shape (k,), m
        Standard deviation per axis.
    start : ndarray, shape (k, 3), m
        Initial value in {K}.
    root_information : ndarray, shape (k, 3, 3), 1/m, optional
        Square root of each knot's information where a camera sees no depth; `sigma_m` is enough where None.
    """

    node: IntArray
    position: FloatArray
    sigma_m: FloatArray
    start: FloatArray
    root_information: FloatArray | None = None


@dataclass(frozen=True)
class States:
    """Pose and velocity at the nodes.

    Attributes
    ----------
    R : ndarray, shape (n, 3, 3)
        Orientation `R_K_A`.
    p : ndarray, shape (n, 3), m
        Position of the IMU in {K}.
    v : ndarray, shape (n, 3), m/s
        Velocity of the IMU in {K}.
    """

    R: FloatArray
    p: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class FieldMeasurements:
    """A calibrated magnetometer's directions.

    Attributes
    ----------
    node : ndarray of int, shape (k,)
        Index of the node that each belongs to.
    in_A : ndarray, shape (k, 3)
        Unit vectors in {A}.
    in_K : ndarray, shape (3,)
        Unit vector of the field in {K}.
    sigma_rad : float, rad
        Of each, per axis.
    """

    node: IntArray
    in_A: FloatArray
    in_K: FloatArray
    sigma_rad: float


@dataclass(frozen=True)
class NoiseModel:
    """Densities and losses that all windows share.

    Attributes
    ----------
    accelerometer_density : float, m/s^2/sqrt(Hz)
        White noise of the still sensor.
    gyroscope_density : float, rad/s/sqrt(Hz)
        White noise of the still sensor.
    accelerometer_share, gyroscope_share : float, sqrt(s)
        What scale and mounting errors of the sensor cost, as a share of the specific force beyond gravity
        and of the angular rate: the noise grows with the motion.
    cauchy : float
        Length of a residual, in sigmas, where its weight is halved (Cauchy's loss).
    upper_arm_sigma_m : float, m
        How far from constant the upper arm's length is.
    shoulder_walk : float, m/sqrt(s)
        How the shoulder wanders.
    tissue_m : tuple of (str, float), m
        By segment beyond the forearm, how far its joints are from constant in its IMU's axes, per axis.
    """

    accelerometer_density: float
    gyroscope_density: float
    accelerometer_share: float
    gyroscope_share: float
    cauchy: float
    upper_arm_sigma_m: float
    shoulder_walk: float
    tissue_m: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class SegmentRun:
    """An IMU on a segment of the arm, at neighbouring nodes of a window.

    Attributes
    ----------
    segment : str
        Name of the segment (`body.SEGMENTS`).
    first : int
        The window's node that it begins at.
    start : States
        Initial values at its m nodes: orientation from the IMU's axes to {K}, position and velocity.
    increments : ImuIncrements
        Of its m - 1 intervals.
    attitude_node : int
        The node, counted from `first`, with a weak prior on its orientation, so that no direction is left
        free by the data.
    attitude : ndarray, shape (3, 3)
        The prior's orientation.
    attitude_covariance : ndarray, shape (3, 3), rad^2
        Of the prior, in {K}.
    """

    segment: str
    first: int
    start: States
    increments: ImuIncrements
    attitude_node: int
    attitude: FloatArray
    attitude_covariance: FloatArray

    @property
    def nodes(self) -> slice:
        """The window's nodes that it covers."""
        return slice(self.first, self.first + len(self.start.p))


@dataclass(frozen=True)
class Window:
    """What one graph is built from.

    Attributes
    ----------
    index : int
        Number of the window in its segment.
    t : ndarray, shape (n,), s
        Nodes on the IMU's clock, margins included.
    core_start_s, core_end_s : float, s
        The window's borders; the margins lie beyond them.
    bodies : tuple of SegmentRun
        The forearm's IMU at all nodes, then IMUs on other segments, each between its pauses.
    joint_measurements : tuple of JointMeasurements
        Of the joints that the camera saw, the shoulder's apart.
    shoulder : ShoulderMeasurements or None
        None where the camera saw no shoulder in the segment.
    velocity_change : ndarray, shape (n - 1,), m/s
        How much the velocity may change in an interval; inf where nothing is known of it.
    priors : Priors
        On the shared quantities.
    noise : NoiseModel
        The same for all windows.
    gravity_magnitude : float, m/s^2
    field : FieldMeasurements or None
        A magnetometer's directions where there is a calibrated one.
    considered : Considered or None
        Constant errors that widen the covariance.
    """

    index: int
    t: FloatArray
    core_start_s: float
    core_end_s: float
    bodies: tuple[SegmentRun, ...]
    joint_measurements: tuple[JointMeasurements, ...]
    shoulder: ShoulderMeasurements | None
    velocity_change: FloatArray
    priors: Priors
    noise: NoiseModel
    gravity_magnitude: float
    field: FieldMeasurements | None = None
    considered: Considered | None = None

    @property
    def forearm(self) -> SegmentRun:
        """The forearm's IMU, which covers all nodes."""
        return self.bodies[0]

    @property
    def further(self) -> tuple[SegmentRun, ...]:
        """The IMUs on other segments."""
        return self.bodies[1:]

    @property
    def reaches_shoulder(self) -> bool:
        """IMUs make a chain up to the shoulder: the direction of the upper arm is measured."""
        return any(SEGMENTS[run.segment].carries_parent for run in self.further)

    def runs(self, segment: str) -> tuple[SegmentRun, ...]:
        """What there is of the IMU on a segment."""
        return tuple(run for run in self.bodies if run.segment == segment)
