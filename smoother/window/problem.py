"""One window as plain arrays: what a graph is built from.

It travels between processes, so it contains arrays and numbers only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..measurements.outliers import noise_key
from ..measurements.rays import SHOULDER_ALONG_M, directions, linearised, of_rays, squashed
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
    ray : ndarray, shape (k, 3), or None
        Unit vectors to where the joint is, once they were linearised there.
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
    ray: FloatArray | None = None

    @property
    def rays(self) -> FloatArray | None:
        """Unit vectors (k, 3) along the samples' rays; None of a camera with depth."""
        if self.ray is not None:
            return self.ray
        return None if self.origin_m is None else directions(self.position, self.origin_m)

    @property
    def distance_m(self) -> FloatArray | None:
        """How far the camera is from the samples (k,), m; None of a camera with depth."""
        return None if self.origin_m is None else np.linalg.norm(self.position - self.origin_m, axis=1)

    def linearised(self, at_node: FloatArray) -> JointMeasurements:
        """The same about where the joint is at the samples' nodes (k, 3), m; as it is of one with depth."""
        if self.origin_m is None:
            return self
        predicted = at_node + self.shift
        position, sigma_m, ray = linearised(self.position, self.sigma_m, self.origin_m, predicted)
        return replace(self, position=position, sigma_m=sigma_m, ray=ray)

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
    samples : KnotSamples, optional
        What these were made of, where a camera sees no depth.
    """

    node: IntArray
    position: FloatArray
    sigma_m: FloatArray
    start: FloatArray
    root_information: FloatArray | None = None
    samples: KnotSamples | None = None

    def linearised(self, knots: FloatArray) -> ShoulderMeasurements:
        """The same about where the knots (k, 3) m are now; as it is where all cameras see depth."""
        if self.samples is None:
            return self
        position, sigma_m, roots = self.samples.of_knots(knots)
        return replace(self, position=position, sigma_m=sigma_m, root_information=roots)


@dataclass(frozen=True)
class KnotSamples:
    """Samples of the shoulder by knot, some of them of cameras without depth.

    Attributes
    ----------
    knot : ndarray of int, shape (f,)
        That each belongs to.
    position : ndarray, shape (f, 3), m
    sigma_m : ndarray, shape (f,), m
        Noise per axis; on rays at the distance `rays.AT_M`.
    origin_m : ndarray, shape (f, 3), m
        Where rays begin; nan of cameras with depth.
    along_m : float, m
        What a sample says along its ray.
    """

    knot: IntArray
    position: FloatArray
    sigma_m: FloatArray
    origin_m: FloatArray
    along_m: float = SHOULDER_ALONG_M

    def of_knots(self, knots: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean (k, 3) m, sigma (k,) m and square root of information (k, 3, 3) 1/m, the knots being there."""
        count, flat = len(knots), of_rays(self.origin_m, len(self.knot))
        position, root = self.position.copy(), np.eye(3) / self.sigma_m[:, None, None]
        position[flat], sigma, ray = linearised(
            self.position[flat], self.sigma_m[flat], self.origin_m[flat], knots[self.knot[flat]]
        )
        root[flat] = squashed(ray, sigma, self.along_m)
        each = root @ root
        information, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
        np.add.at(information, self.knot, each)
        np.add.at(vector, self.knot, np.einsum("nij,nj->ni", each, position))
        seen = np.bincount(self.knot, minlength=count) > 0
        mean, roots, sigmas = np.full((count, 3), np.nan), np.zeros((count, 3, 3)), np.full(count, np.nan)
        mean[seen] = np.linalg.solve(information[seen], vector[seen][..., None])[..., 0]
        roots[seen] = np.swapaxes(np.linalg.cholesky(information[seen]), 1, 2)
        sigmas[seen] = np.sqrt(3.0 / np.trace(information[seen], axis1=1, axis2=2))
        return mean, sigmas, roots


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
    alone : bool
        There is one camera, and it has no depth.
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
    alone: bool = False

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

    @property
    def has_rays(self) -> bool:
        """A camera without depth saw something."""
        flat = any(each.origin_m is not None for each in self.joint_measurements)
        return flat or (self.shoulder is not None and self.shoulder.samples is not None)

    @property
    def lone_rays(self) -> bool:
        """One camera without depth saw all: only motion and the limbs' lengths show how far away it is."""
        joints, layout = self.joint_measurements, self.priors.layout
        return (
            self.alone
            and {"elbow", "wrist"} <= set(layout.joints)
            and bool(joints)
            and all(each.origin_m is not None for each in joints)
        )

    def linearised(self, joints: Mapping[str, FloatArray]) -> Window:
        """The same with what cameras without depth saw linearised about the joints (`joints_at_start`)."""
        if not self.has_rays:
            return self
        return replace(
            self,
            joint_measurements=tuple(each.linearised(joints[each.key]) for each in self.joint_measurements),
            shoulder=None if self.shoulder is None else self.shoulder.linearised(joints["shoulder"]),
        )


def joints_at_start(window: Window) -> dict[str, FloatArray]:
    """Where start values have the joints, m: at the samples' nodes by key, the shoulder at its knots.

    Empty where all cameras see depth, where nothing is linearised.
    """
    joints: dict[str, FloatArray] = {}
    if not window.has_rays:
        return joints
    layout, mean = window.priors.layout, window.priors.shared.mean
    for measured in window.joint_measurements:
        rows = layout.lever_of_sample(measured.joint, measured.segment)
        lever = np.zeros(3) if rows is None else mean[rows]
        place = np.full((len(window.t), 3), np.nan)
        for run in window.runs(measured.segment):
            place[run.nodes] = run.start.p + run.start.R @ lever
        joints[measured.key] = place[measured.node]
    if window.shoulder is not None:
        joints["shoulder"] = window.shoulder.start
    return joints
