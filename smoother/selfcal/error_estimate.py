"""Errors of IMU and camera that are constant over a recording: estimated by all windows, and removed.

A consumer IMU's axes are some tenths of a percent too long and some tenths of a degree off; a skeleton's
joints are millimetres off. Both move every window's answer the same way, so no difference between windows
shows them; they show in how the residuals follow the motion. What cannot be determined stays in the
covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import scaled_inverse
from ..measurements.inertial import InertialSignal
from ..measurements.segment import Segment
from ..recording import JOINTS
from ..window.problem import Priors, Window
from ..window.shared import (
    IMU_ERRORS,
    JOINT_ERRORS,
    LENS,
    SIZE,
    STRAP_ERRORS,
    STRAP_PLACE,
    Considered,
    Gaussian,
)
from ..window.solution import Solution


@dataclass(frozen=True)
class PooledEvidence:
    """Information on [gravity of each recording, the arm's constants; the errors]."""

    information: FloatArray  # (k + SIZE, k + SIZE)
    vector: FloatArray  # (k + SIZE,): information times mean, of the errors as a change of `before`
    before: FloatArray  # (SIZE,): what was taken off the windows' data
    recordings: int  # How many directions of gravity come first

    @classmethod
    def of(
        cls,
        windows: Sequence[Window],
        solutions: Sequence[Solution],
        prior: Priors,
        recording_of_window: IntArray,  # int (k,)
        taken_off: ConstantErrors,
    ) -> PooledEvidence:
        """Add the windows up, and the prior on what they share once."""
        recordings = int(recording_of_window.max(initial=0)) + 1
        constants = 2 * recordings + np.arange(prior.layout.size - prior.layout.constants.start)
        errors = 2 * recordings + len(constants) + np.arange(SIZE)
        information, vector = np.zeros((errors[-1] + 1, errors[-1] + 1)), np.zeros(errors[-1] + 1)
        for window, solution, recording in zip(windows, solutions, recording_of_window, strict=True):
            assert solution.evidence is not None
            # neighbours overlap by their margins: what both have seen counts once
            share = min((window.core_end_s - window.core_start_s) / (window.t[-1] - window.t[0]), 1.0)
            rows = np.concatenate([2 * recording + np.arange(2), constants, errors])
            information[np.ix_(rows, rows)] += share * solution.evidence.information
            vector[rows] += share * solution.evidence.vector
        own, mean = np.linalg.inv(prior.shared.covariance[6:, 6:]), prior.shared.mean
        for recording in range(recordings):
            gravity = 2 * recording + np.arange(2)
            information[np.ix_(gravity, gravity)] += own[:2, :2]
            vector[gravity] += own[:2, :2] @ mean[prior.layout.gravity]
        information[np.ix_(constants, constants)] += own[2:, 2:]
        vector[constants] += own[2:, 2:] @ mean[prior.layout.constants]
        before = np.concatenate([taken_off.imu.ravel(), taken_off.joints.error_m.ravel(), np.zeros(9)])
        return cls(information, vector, before, recordings)

    @property
    def constants(self) -> Gaussian:
        """The arm's constants (upper arm, lever arms), the errors as they were taken off."""
        others = slice(0, len(self.vector) - SIZE)
        covariance = scaled_inverse(self.information[others, others])
        rows = slice(2 * self.recordings, None)
        return Gaussian((covariance @ self.vector[others])[rows], covariance[rows, rows])

    def posterior(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (SIZE,) and covariance (SIZE, SIZE) of the errors, of a prior about zero with a covariance."""
        errors = slice(len(self.vector) - SIZE, None)
        before = np.linalg.inv(covariance)
        information, vector = self.information.copy(), self.vector.copy()
        information[errors, errors] += before
        vector[errors] -= before @ self.before
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * scale[:, None] * scale) * scale[:, None] * scale
        return self.before + (inverse @ vector)[errors], inverse[errors, errors]

    def lens(self, covariance: FloatArray) -> tuple[float, float]:
        """Error of the focal length, as a part of it, and its sigma, of a prior with a covariance."""
        mean, after = self.posterior(covariance)
        return float(mean[LENS][0]), float(np.sqrt(after[LENS, LENS][0, 0]))

    def shared_sensitivity(self) -> FloatArray:
        """How the shared vector follows the errors, (s, SIZE); gravity of the first recording."""
        others, errors = slice(0, len(self.vector) - SIZE), slice(len(self.vector) - SIZE, None)
        follows = -np.linalg.solve(self.information[others, others], self.information[others, errors])
        return np.concatenate([np.zeros((6, SIZE)), follows[:2], follows[2 * self.recordings :]])


@dataclass(frozen=True)
class JointBias:
    """The camera's constant errors, free of their common part."""

    # (5, 3) m: In {K}, in the order of `JOINTS`
    error_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    joints: tuple[str, ...] = ()  # Joints with enough samples to tell
    sigma_m: float = 0.0  # How large a joint's constant error is in this recording, per axis (one sigma)


#: How large such errors are before the recording speaks (an element; the IMU's: `Config.imu.scale_sigma`): a
#: joint's, m, and how far a strap turns on the forearm as the posture changes, rad.
JOINT_M = 0.010
STRAP_RAD = np.radians(2.0)
#: A joint's constant error is never taken for larger, m: an Azure Kinect's are 13 to 17 mm. On an arm that
#: hardly turns a wrong mounting looks like such an error.
LARGEST_JOINT_M = 0.025
#: Where a tracked strap that represents the IMU is from the chip in its case, m per axis (BROAD: 8 mm).
STRAP_PLACE_M = 0.010
#: How large the first radial term is that a lens may lack, by the focal length's standard error: webcams' are
#: -0.15 to 0.12, those of a calibration within 0.02.
DISTORTION, LARGEST_DISTORTION = 2.0, 0.15
#: What a focal length may be off where only the motion is to tell.
OPEN_SHARE = 0.3
#: For this many elements a share of that counts when the recording shows how large they are, in this many
#: steps: of 1, 3 and 10 on 24 simulated Azure Kinects, 100, 96 and 91 % of orientations are inside 95 %, and
#: without errors sigma is 3.0, 1.9 and 1.8 times too large.
WEIGHT, USUAL = 1.0, 0.6
STEPS = 3
#: A joint with fewer samples shows nothing of its error.
FEWEST_SAMPLES = 10
#: What the gyroscope's three axes turn together defines the sensor's axes: no error, rad.
DEFINED_RAD = 1e-5
GYROSCOPE_PAIRS = ((10, 12), (11, 15), (14, 16))


@dataclass(frozen=True)
class ConstantErrors:
    """What is taken off the data, and what may be left."""

    # (2, 3, 3): Scales and axes of accelerometer and gyroscope: a sample reads (I + imu) times what it should
    imu: FloatArray = field(default_factory=lambda: np.zeros((2, 3, 3)))
    joints: JointBias = field(default_factory=JointBias)  # The camera's
    considered: Considered | None = None  # What may be left; None before the first round
    lens: tuple[float, float] = (0.0, 0.0)  # Of one camera without depth

    def corrected(self, segment: Segment, signals: dict[int, InertialSignal] | None = None) -> Segment:
        """A segment with the errors taken off."""
        known = {} if signals is None else signals
        key = id(segment.signal)
        if key not in known:
            known[key] = segment.signal.scaled(*(np.eye(3) - self.imu))
        return replace(segment, signal=known[key], position=segment.position - self.joints.error_m)

    @classmethod
    def estimated(
        cls,
        pooled: PooledEvidence,
        joints: tuple[str, ...],
        place: bool,
        imu_sigma: float,
        cameras: int = 1,
        stamp_sigma_s: float = 0.0,
        focal_share: float = 0.0,
    ) -> ConstantErrors:
        """The errors as another round estimates them, of joints with enough samples.

        `place`: a tracked strap represents the IMU; `cameras`: how many see depth.
        """
        sizes = _Sizes(
            imu_sigma,
            imu_sigma,
            JOINT_M / np.sqrt(cameras) if joints else 0.0,
            STRAP_RAD,
            STRAP_PLACE_M if place else None,
            joints,
            cameras,
            focal_share,
        )
        first = sizes
        for _ in range(STEPS):
            mean, covariance = pooled.posterior(sizes.covariance())
            sizes = sizes.updated(mean, covariance, first)
        lens = (0.0, 0.0)
        if focal_share:  # a lens that the motion contradicts is off by as much as the motion shows
            lens = pooled.lens(replace(sizes, focal_share=OPEN_SHARE).covariance())
            seen = float(np.sqrt(max(lens[0] ** 2 - lens[1] ** 2, 0.0)))
            lens = lens[0], float(np.hypot(lens[1], focal_share))
            sizes = replace(sizes, focal_share=max(focal_share, seen))
            mean, covariance = pooled.posterior(sizes.covariance())
        if place:  # the IMU's errors are taken off as they show without it: it takes a part of theirs
            mean = mean.copy()
            alone, _ = pooled.posterior(replace(sizes, strap_place_m=None).covariance())
            mean[IMU_ERRORS] = alone[IMU_ERRORS]
        # the strap's turning and place are not taken off: what is known of them widens the covariance
        for rows in (STRAP_ERRORS, *((STRAP_PLACE,) if place else ())):
            covariance[rows, rows] += np.outer(mean[rows], mean[rows])
        error_m = np.zeros((len(JOINTS), 3))
        if joints:
            error_m = mean[JOINT_ERRORS].reshape(-1, 3).copy()
            error_m -= error_m[[JOINTS.index(joint) for joint in joints]].mean(axis=0)
            if place:
                error_m[JOINTS.index("strap")] = 0.0
        return cls(
            mean[IMU_ERRORS].reshape(2, 3, 3),
            JointBias(error_m, joints, sizes.joint_m),
            Considered(covariance, pooled.shared_sensitivity(), stamp_sigma_s),
            lens,
        )


@dataclass(frozen=True)
class _Sizes:
    """How large an element of each kind of error is: a prior's sigmas, learnt from the recording.

    Expectation-maximisation of the sigmas (Dempster, Laird and Rubin 1977) with a weak prior on them. That of
    a strap that represents the IMU is not learnt; None where it is a joint like the others.
    """

    accelerometer: float
    gyroscope: float
    joint_m: float
    strap_rad: float
    strap_place_m: float | None
    joints: tuple[str, ...]  # Those of the forearm that `joint_m` is of
    cameras: int = 1  # With depth
    focal_share: float = 0.0

    @property
    def alike(self) -> FloatArray:
        """Covariance (5, 5) of the joints' errors on an axis, as a part of their own variance.

        A further camera is placed by its joints: against the first camera's their errors average out joint
        by joint, but what all joints of the first one have in common stays as it was.
        """
        seen = np.isin(JOINTS, ("shoulder", *self.joints))
        return np.eye(len(JOINTS)) + (self.cameras - 1) / seen.sum() * np.outer(seen, seen)

    def covariance(self) -> FloatArray:
        """Of the errors, (SIZE, SIZE); no direction is exactly free of error."""
        variance = np.repeat(
            np.square([self.accelerometer, self.gyroscope, max(self.joint_m, 1e-6), self.strap_rad]),
            [9, 9, 3 * len(JOINTS), 9],
        )
        if self.strap_place_m is not None:
            variance[STRAP_PLACE] = self.strap_place_m**2
        if self.focal_share:
            variance[LENS] = np.square(
                [self.focal_share, min(DISTORTION * self.focal_share, LARGEST_DISTORTION), 1e-6]
            )
        covariance = np.diag(variance)
        common = np.kron(self.alike - np.eye(len(JOINTS)), np.eye(3))
        covariance[JOINT_ERRORS, JOINT_ERRORS] += self.joint_m**2 * common
        turn = np.zeros((3, SIZE))
        for row, (a, b) in zip(turn, GYROSCOPE_PAIRS, strict=True):
            row[a], row[b] = np.sqrt(0.5), -np.sqrt(0.5)
        return covariance - (self.gyroscope**2 - DEFINED_RAD**2) * turn.T @ turn

    def updated(self, mean: FloatArray, covariance: FloatArray, first: _Sizes) -> _Sizes:
        """A step: each kind's mean square over its elements."""
        second = np.outer(mean, mean) + covariance
        square, own = np.diag(second), [JOINTS.index(joint) for joint in self.joints]
        by_axis = second[JOINT_ERRORS, JOINT_ERRORS].reshape(2 * (len(JOINTS), 3))
        products = np.einsum("iaja->ij", by_axis)[np.ix_(own, own)]
        of_joints = np.linalg.inv(self.alike[np.ix_(own, own)]) * products

        def size(squares: FloatArray, free: int, before: float) -> float:
            return float(np.sqrt((squares.sum() + WEIGHT * (USUAL * before) ** 2) / (free + WEIGHT)))

        return _Sizes(
            size(square[:9], 9, first.accelerometer),
            size(square[9:18], 6, first.gyroscope),
            min(size(of_joints, 3 * len(own), first.joint_m), LARGEST_JOINT_M) if own else 0.0,
            size(square[STRAP_ERRORS], 9, first.strap_rad),
            self.strap_place_m,
            self.joints,
            self.cameras,
            self.focal_share,
        )


def well_seen_joints(windows: Sequence[Window], place: bool) -> tuple[str, ...]:
    """Joints of the forearm with enough samples; none where there are not two."""
    counts: dict[str, int] = {}
    for window in windows:
        for measured in window.joint_measurements:
            counts[measured.joint] = counts.get(measured.joint, 0) + len(measured.node)
    joints = tuple(
        joint
        for joint, count in counts.items()
        if count >= FEWEST_SAMPLES and not (place and joint == "strap")
    )
    return joints if len(joints) > 1 else ()
