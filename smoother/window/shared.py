"""The quantities that all windows of a recording share, as one Gaussian vector.

Bias, gravity's direction, the upper arm's length and the lever arms are known together far better
than one by one (elbow and wrist move along the forearm as a pair), so windows exchange them jointly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS, segment_of
from ..linalg import skew_of
from ..recording import JOINTS


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian."""

    mean: FloatArray  # (s,)
    covariance: FloatArray  # (s, s)


@dataclass(frozen=True)
class SharedLayout:
    """Which rows of the shared vector contain which quantity."""

    joints: tuple[str, ...]  # Those with a lever arm on the forearm, (3,) m in {A} each
    has_upper_arm: bool  # The shoulder is used, (1,) m
    gravity_axes: FloatArray  # (2, 3): unit vectors in {K} across the direction of down
    further: tuple[str, ...] = ()  # Names of further segments with an IMU (`body.SEGMENTS`)

    bias = slice(0, 6)
    gravity = slice(6, 8)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self._first_of_further + sum(3 * len(SEGMENTS[name].joints) + 6 for name in self.further)

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all segments with an IMU, the forearm first."""
        return (FOREARM.name, *self.further)

    @property
    def upper_arm(self) -> slice:
        """Rows of the upper arm's length."""
        return slice(8, 8 + int(self.has_upper_arm))

    @property
    def constants(self) -> slice:
        """Rows of the arm's constants: upper arm and lever arms."""
        return slice(8, self.size - 6 * len(self.further))

    @property
    def _first_of_further(self) -> int:
        return self.upper_arm.stop + 3 * len(self.joints)

    def lever(self, joint: str, segment: str = FOREARM.name) -> slice:
        """Rows of a joint's lever arm in a segment's axes."""
        if segment == FOREARM.name:
            first = self.upper_arm.stop + 3 * self.joints.index(joint)
        else:
            before = self.further[: self.further.index(segment)]
            first = self._first_of_further + sum(3 * len(SEGMENTS[name].joints) for name in before)
            first += 3 * SEGMENTS[segment].joints.index(joint)
        return slice(first, first + 3)

    def levers(self, segment: str) -> dict[str, slice]:
        """Rows of the lever arms of a segment with an IMU, by joint."""
        joints = self.joints if segment == FOREARM.name else SEGMENTS[segment].joints
        return {joint: self.lever(joint, segment) for joint in joints}

    def segment_of(self, joint: str) -> str:
        """The segment whose IMU a joint's camera samples are tied to."""
        return segment_of(joint, self.segments)

    def bias_of(self, segment: str) -> slice:
        """Rows of the bias of a segment's IMU."""
        if segment == FOREARM.name:
            return self.bias
        first = self.constants.stop + 6 * self.further.index(segment)
        return slice(first, first + 6)

    def down(self, vector: FloatArray) -> FloatArray:
        """Unit vector of gravity (3,) in {K}, of a shared vector (s,)."""
        across = self.gravity_axes.T @ vector[self.gravity]
        along = skew_of(self.gravity_axes[0]) @ self.gravity_axes[1]
        return across + along * np.sqrt(max(1.0 - float(across @ across), 1e-6))


def axes_across(down: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) with cross product along `down` (3,)."""
    down = down / np.linalg.norm(down)
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])


#: Rows of the vector: accelerometer (9), gyroscope (9), joints in the order of `JOINTS` (15), strap (9).
IMU_ERRORS = slice(0, 18)
JOINT_ERRORS = slice(18, 18 + 3 * len(JOINTS))
STRAP_ERRORS = slice(JOINT_ERRORS.stop, JOINT_ERRORS.stop + 9)
SIZE = STRAP_ERRORS.stop
#: Where the tracked strap is, from the IMU: the joint's rows, in {A}.
STRAP_PLACE = slice(
    JOINT_ERRORS.start + 3 * JOINTS.index("strap"), JOINT_ERRORS.start + 3 * JOINTS.index("strap") + 3
)
#: One camera without depth sees no strap; the rows are its lens's: the focal length's error as a part of it,
#: the radial term k1 that was left out, and none.
LENS = STRAP_PLACE
#: Errors of synthetic stamps are straight lines between times this far apart, s, and last this long, s: a
#: frame that was dropped shifts all that follow, until the offset that wanders has followed.
STAMP_KNOT_S = 0.5
STAMP_MEMORY_S = 1.0


@dataclass(frozen=True)
class ErrorEvidence:
    """A window's evidence on the shared constants and the constant errors, its prior on them taken off."""

    information: FloatArray  # (k, k)
    vector: FloatArray  # (k,): information times mean


@dataclass(frozen=True)
class Considered:
    """Constant errors that are left after correction."""

    covariance: FloatArray  # (SIZE, SIZE): of the errors
    shared: FloatArray  # (s, SIZE): how the recording's estimate of the shared vector follows them
    stamp_sigma_s: float = 0.0  # How far the frames' times may be off, beyond one offset for all

    def stamp_knots(self, start_s: float, end_s: float) -> FloatArray:
        """Times (m,) s between which errors of the frames' times are linear, on one grid for all windows."""
        if not self.stamp_sigma_s:
            return np.zeros(0)
        first, last = np.floor(start_s / STAMP_KNOT_S), np.ceil(end_s / STAMP_KNOT_S)
        return np.asarray(STAMP_KNOT_S * np.arange(first, last + 1))

    def stamp_covariance(self, knots: FloatArray) -> FloatArray:
        """Of the errors at knots, (m, m) s^2: a Gauss-Markov process."""
        apart = np.abs(knots[:, None] - knots)
        return np.asarray(self.stamp_sigma_s**2 * np.exp(-apart / STAMP_MEMORY_S))
