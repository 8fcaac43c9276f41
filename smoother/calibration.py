"""The arm's calibration as a plain value: what the smoother takes, and what it found.

The file it is kept in belongs to the package `calib`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .recording import FloatArray


@dataclass(frozen=True)
class LeverArm:
    """A joint's constant position in the forearm IMU's axes {A}.

    Attributes
    ----------
    position_m : (3,) m in {A}.
    sigma_m : (3,) one standard deviation an axis, m.
    """

    position_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True)
class Length:
    """A length and its standard deviation, m."""

    value_m: float
    sigma_m: float


@dataclass(frozen=True)
class ArmCalibration:
    """How the IMU sits on one forearm, and the arm's measures.

    Attributes
    ----------
    side : "left", "right" or "".
    lever_arms : by joint (elbow, wrist, hand), m in {A}. `strap` needs none: it is the IMU.
    upper_arm : shoulder to elbow, or None where it is to be solved.
    R_F_A : (3, 3) IMU axes to forearm axes (y elbow to wrist, x to the back of the hand), or None.
    accelerometer_bias, gyroscope_bias : (3,) m/s^2 and rad/s in {A}, or None where unknown.
    """

    side: str = ""
    lever_arms: dict[str, LeverArm] = field(default_factory=dict)
    upper_arm: Length | None = None
    R_F_A: FloatArray | None = None
    accelerometer_bias: FloatArray | None = None
    gyroscope_bias: FloatArray | None = None

    @property
    def forearm_direction(self) -> FloatArray | None:
        """Unit vector elbow to wrist in {A}, (3,); None without both lever arms."""
        if "elbow" not in self.lever_arms or "wrist" not in self.lever_arms:
            return None
        along = self.lever_arms["wrist"].position_m - self.lever_arms["elbow"].position_m
        return along / np.linalg.norm(along)
