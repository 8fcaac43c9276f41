"""The quantities that all windows of a recording share, as one Gaussian vector.

Bias, gravity's direction, the upper arm's length and the lever arms are known together far better
than one by one (elbow and wrist move along the forearm as a pair), so windows exchange them jointly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian.

    Attributes
    ----------
    mean : ndarray, shape (s,)
    covariance : ndarray, shape (s, s)
    """

    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class SharedLayout:
    """Which rows of the shared vector hold which quantity.

    Attributes
    ----------
    joints : tuple of str
        Those with a lever arm, (3,) m in {A} each.
    has_upper_arm : bool
        The shoulder takes part, (1,) m.
    gravity_axes : ndarray, shape (2, 3)
        Unit vectors in {K} across the direction of down; gravity's two coordinates are the components of
        the unit vector of down along them.
    has_upper_imu : bool
        An IMU on the upper arm takes part: elbow and shoulder in its axes {B}, (3,) m each, and its bias
        (6,) at the end.
    bias : slice
        Accelerometer's and gyroscope's, (6,) m/s^2 and rad/s.
    gravity : slice
        The two coordinates.
    """

    joints: tuple[str, ...]
    has_upper_arm: bool
    gravity_axes: FloatArray
    has_upper_imu: bool = False

    bias = slice(0, 6)
    gravity = slice(6, 8)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return 8 + int(self.has_upper_arm) + 3 * len(self.joints) + 12 * int(self.has_upper_imu)

    @property
    def upper_arm(self) -> slice:
        """Rows of the upper arm's length."""
        return slice(8, 8 + int(self.has_upper_arm))

    @property
    def constants(self) -> slice:
        """Rows of the arm's constants: upper arm and lever arms."""
        return slice(8, self.size - 6 * int(self.has_upper_imu))

    def lever(self, joint: str) -> slice:
        """Rows of a joint's lever arm."""
        first = self.upper_arm.stop + 3 * self.joints.index(joint)
        return slice(first, first + 3)

    @property
    def upper_levers(self) -> dict[str, slice]:
        """Rows of elbow and shoulder in {B}; none without an IMU on the upper arm."""
        if not self.has_upper_imu:
            return {}
        first = self.size - 12
        return {"elbow": slice(first, first + 3), "shoulder": slice(first + 3, first + 6)}

    @property
    def upper_bias(self) -> slice:
        """Rows of the upper-arm IMU's bias; empty without one."""
        return slice(self.size - 6 * int(self.has_upper_imu), self.size)

    def down(self, vector: FloatArray) -> FloatArray:
        """Unit vector of gravity (3,) in {K}, of a shared vector (s,)."""
        across = self.gravity_axes.T @ vector[self.gravity]
        along = np.cross(self.gravity_axes[0], self.gravity_axes[1])
        return across + along * np.sqrt(max(1.0 - float(across @ across), 1e-6))


def axes_across(down: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) with cross product along `down` (3,)."""
    down = down / np.linalg.norm(down)
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])
