"""One window as plain arrays: what a graph is built from.

It travels between processes, so it contains arrays and numbers only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS
from ..measurements.outliers import noise_key
from ..measurements.rays import SHOULDER_ALONG_M, directions, linearised, of_rays, squashed
from .shared import Considered, Gaussian, SharedLayout


@dataclass(frozen=True)
class Priors:
    """A window's prior on the quantities that it shares with the rest of the recording."""

    layout: SharedLayout  # Which rows of the shared vector contain which quantity
    shared: Gaussian  # On the shared vector, with the bias at the window's middle
    bias_walk: FloatArray  # (6,) m/s^2/sqrt(s) and rad/s/sqrt(s): how far the bias wanders inside the window


@dataclass(frozen=True)
class ImuIncrements:
    """Equivalent IMU samples of the window's intervals (see `inertial.equivalent_samples`)."""

    acc: FloatArray  # (m, 2, 3) m/s^2: specific force in the halves of the steps, without the bias
    gyro: FloatArray  # (m, 3) rad/s: angular rate in the steps, without the bias
    h: FloatArray  # (m,) s: half of each step
    first: IntArray  # int (n,): index of each interval's first step, and m at the end
    bias: FloatArray  # (6,) m/s^2 and rad/s: the bias that was subtracted
    velocity_error: FloatArray  # (n - 1,) m/s: what impacts may have cost in each interval
    # (n - 1,) rad: What missing samples may have cost the direction in each interval
    turn_error: FloatArray | None = None


@dataclass(frozen=True)
class JointMeasurements:
    """A joint's accepted camera samples."""

    joint: str
    t_s: FloatArray  # (k,) s: frame times on the IMU's clock
    node: IntArray  # int (k,): index of the node that each belongs to, increasing
    position: FloatArray  # (k, 3) m: in {K}
    sigma_m: FloatArray  # (k,) m: standard deviation per axis
    shift: FloatArray  # (k, 3) m: the joint at the frame less the joint at the node in {K}, by the IMU
    velocity: FloatArray  # (k, 3) m/s: the joint's velocity at the frame less the IMU's at the node, in {K}
    segment: str = FOREARM.name  # The segment whose IMU it is tied to
    camera: int = 0  # Number of the camera that saw it
    # (3,) m: Where that camera's rays begin, if it sees no depth (`measurements.rays`)
    origin_m: FloatArray | None = None
    # (k, 3): Unit vectors to where the joint is, once they were linearised there
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
        names = ("t_s", "node", "position", "sigma_m", "shift", "velocity")
        whole: dict[str, Any] = {name: np.concatenate([vars(part)[name] for part in parts]) for name in names}
        return replace(parts[0], **whole)


@dataclass(frozen=True)
class ShoulderMeasurements:
    """The shoulder's knots: where the smooth shoulder has a variable."""

    node: IntArray  # int (k,): the node whose time the knot shares
    position: FloatArray  # (k, 3) m: in {K}; nan where the camera saw no shoulder
    sigma_m: FloatArray  # (k,) m: standard deviation per axis
    start: FloatArray  # (k, 3) m: initial value in {K}
    # (k, 3, 3) 1/m: Square root of each knot's information where a camera sees no depth
    root_information: FloatArray | None = None
    samples: KnotSamples | None = None  # What these were made of, where a camera sees no depth

    def linearised(self, knots: FloatArray) -> ShoulderMeasurements:
        """The same about where the knots (k, 3) m are now; as it is where all cameras see depth."""
        if self.samples is None:
            return self
        position, sigma_m, roots = self.samples.of_knots(knots)
        return replace(self, position=position, sigma_m=sigma_m, root_information=roots)


@dataclass(frozen=True)
class KnotSamples:
    """Samples of the shoulder by knot, some of them of cameras without depth."""

    knot: IntArray  # int (f,): that each belongs to
    position: FloatArray  # (f, 3) m
    sigma_m: FloatArray  # (f,) m: noise per axis; on rays at the distance `rays.AT_M`
    origin_m: FloatArray  # (f, 3) m: Where rays begin; nan of cameras with depth
    along_m: float = SHOULDER_ALONG_M  # What a sample says along its ray

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
    """Pose and velocity at the nodes."""

    R: FloatArray  # (n, 3, 3): orientation `R_K_A`
    p: FloatArray  # (n, 3) m: position of the IMU in {K}
    v: FloatArray  # (n, 3) m/s: velocity of the IMU in {K}

    @classmethod
    def unknown(cls, count: int) -> States:
        """Of this many nodes, all nan."""
        return cls(np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan), np.full((count, 3), np.nan))

    def rows(self, rows: slice) -> States:
        """Of some of the nodes."""
        return States(self.R[rows], self.p[rows], self.v[rows])


@dataclass(frozen=True)
class FieldMeasurements:
    """A calibrated magnetometer's directions."""

    node: IntArray  # int (k,): index of the node that each belongs to
    in_A: FloatArray  # (k, 3): unit vectors in {A}
    in_K: FloatArray  # (3,): unit vector of the field in {K}
    sigma_rad: float  # Of each, per axis


@dataclass(frozen=True)
class NoiseModel:
    """Densities and losses that all windows share."""

    accelerometer_density: float  # White noise of the still sensor, m/s^2/sqrt(Hz)
    gyroscope_density: float  # White noise of the still sensor, rad/s/sqrt(Hz)
    # What scale and mounting errors of the sensor cost, as a share of the specific force beyond gravity and
    # of the angular rate: the noise grows with the motion
    accelerometer_share: float
    gyroscope_share: float
    cauchy: float  # Length of a residual, in sigmas, where its weight is halved (Cauchy's loss)
    upper_arm_sigma_m: float  # How far from constant the upper arm's length is
    shoulder_walk: float  # How the shoulder wanders
    # By segment beyond the forearm, how far its joints are from constant in its IMU's axes, per axis
    tissue_m: tuple[tuple[str, float], ...] = ()
    in_common: float = 1.0  # By this much the camera's variance is larger than its joints' own


@dataclass(frozen=True)
class SegmentRun:
    """An IMU on a segment of the arm, at neighbouring nodes of a window."""

    segment: str  # Name of the segment (`body.SEGMENTS`)
    first: int  # The window's node that it begins at
    start: States  # Initial values at its m nodes
    increments: ImuIncrements  # Of its m - 1 intervals
    # The node, counted from `first`, with a weak prior on its orientation, so that no direction is left free
    # by the data
    attitude_node: int
    attitude: FloatArray  # (3, 3): the prior's orientation
    attitude_covariance: FloatArray  # (3, 3) rad^2: of the prior, in {K}

    @property
    def nodes(self) -> slice:
        """The window's nodes that it covers."""
        return slice(self.first, self.first + len(self.start.p))


@dataclass(frozen=True)
class Window:
    """What one graph is built from."""

    t: FloatArray  # (n,) s: nodes on the IMU's clock, margins included
    core_start_s: float  # What it is to answer for; the margins lie beyond
    core_end_s: float  # What it is to answer for; the margins lie beyond
    # The forearm's IMU at all nodes, then IMUs on other segments, each between its pauses
    bodies: tuple[SegmentRun, ...]
    # Of the joints that the camera saw, the shoulder's apart
    joint_measurements: tuple[JointMeasurements, ...]
    shoulder: ShoulderMeasurements | None  # None where the camera saw no shoulder in the segment
    velocity_change: FloatArray  # (n - 1,) m/s: how much the velocity may change in an interval
    still: IntArray  # int (k,): nodes in gaps at which the sensor lies still
    priors: Priors  # On the shared quantities
    noise: NoiseModel  # The same for all windows
    field: FieldMeasurements | None = None  # A magnetometer's directions where there is a calibrated one
    considered: Considered | None = None  # Constant errors that widen the covariance
    alone: bool = False  # There is one camera, and it has no depth
    loose_gaps: bool = False  # The upper arm says next to nothing in long gaps: their motion is not asked for
    is_started: bool = False  # The start values are an earlier solution's

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
    """Where start values have the joints, m: at the samples' nodes by key, the shoulder at its knots."""
    joints: dict[str, FloatArray] = {}
    if not window.has_rays:
        return joints
    layout, mean = window.priors.layout, window.priors.shared.mean
    for measured in window.joint_measurements:
        rows = layout.levers(measured.segment).get(measured.joint)
        lever = np.zeros(3) if rows is None else mean[rows]
        place = np.full((len(window.t), 3), np.nan)
        for run in window.runs(measured.segment):
            place[run.nodes] = run.start.p + run.start.R @ lever
        joints[measured.key] = place[measured.node]
    if window.shoulder is not None:
        joints["shoulder"] = window.shoulder.start
    return joints
