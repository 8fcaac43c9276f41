"""The quantities that all windows of a recording share, as one Gaussian vector.

Bias, gravity's direction, the upper arm's length and the lever arms are known together far better
than one by one (elbow and wrist move along the forearm as a pair), so windows exchange them jointly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..recording import FloatArray


@dataclass(frozen=True)
class Gaussian:
    """A mean and its covariance."""

    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True)
class SharedLayout:
    """Where each shared quantity stands in the vector.

    Attributes
    ----------
    joints : those with a lever arm, (3,) m in {A} each.
    has_upper_arm : the shoulder takes part, (1,) m.
    gravity_axes : (2, 3) unit vectors in {K} across the direction of down; gravity's two coordinates
        are the components of the unit vector of down along them.
    """

    joints: tuple[str, ...]
    has_upper_arm: bool
    gravity_axes: FloatArray

    bias = slice(0, 6)
    gravity = slice(6, 8)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return 8 + int(self.has_upper_arm) + 3 * len(self.joints)

    @property
    def upper_arm(self) -> slice:
        """Where the upper arm's length stands."""
        return slice(8, 8 + int(self.has_upper_arm))

    @property
    def constants(self) -> slice:
        """The part that belongs to the arm: upper arm and lever arms."""
        return slice(8, self.size)

    def lever(self, joint: str) -> slice:
        """Where a joint's lever arm stands."""
        first = self.upper_arm.stop + 3 * self.joints.index(joint)
        return slice(first, first + 3)

    def down(self, vector: FloatArray) -> FloatArray:
        """Unit vector of gravity (3,) in {K}."""
        across = self.gravity_axes.T @ vector[self.gravity]
        along = np.cross(self.gravity_axes[0], self.gravity_axes[1])
        return across + along * np.sqrt(max(1.0 - float(across @ across), 1e-6))


def axes_across(down: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) with cross product along `down` (3,)."""
    down = down / np.linalg.norm(down)
    first = np.cross(down, np.eye(3)[int(np.argmin(np.abs(down)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(down, first)])
