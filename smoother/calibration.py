"""The arm's calibration as a plain value: what the smoother takes, and what it answers.

Its file belongs to the package `calib`.
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
    position_m : ndarray, shape (3,), m
        In {A}.
    sigma_m : ndarray, shape (3,), m
        One standard deviation of each axis.
    """

    position_m: FloatArray
    sigma_m: FloatArray


@dataclass(frozen=True)
class Length:
    """A length and its standard deviation.

    Attributes
    ----------
    value_m : float, m
    sigma_m : float, m
        One standard deviation.
    """

    value_m: float
    sigma_m: float


@dataclass(frozen=True)
class ArmCalibration:
    """How the IMU sits on one forearm, and the arm's measures.

    Attributes
    ----------
    side : {"left", "right", ""}
        Which arm; "" where the recording does not say.
    lever_arms : dict of str to LeverArm
        By joint (elbow, wrist, hand). `strap` needs none: it is the IMU.
    upper_arm : Length or None
        Shoulder to elbow; None where it is to be solved.
    R_F_A : ndarray, shape (3, 3), or None
        Maps a vector from the IMU's axes to the forearm's (y elbow to wrist, x to the back of the hand).
    accelerometer_bias : ndarray, shape (3,), m/s^2, or None
        In {A}; None where unknown.
    gyroscope_bias : ndarray, shape (3,), rad/s, or None
        In {A}; None where unknown.
    upper_imu : dict of str to LeverArm
        Elbow and shoulder in the axes {B} of an IMU on the upper arm; empty where there is none.
    R_U_B : ndarray, shape (3, 3), or None
        Maps a vector from that IMU's axes to the upper arm's (y elbow to shoulder, z the axis of elbow
        flexion from the medial to the lateral epicondyle).
    """

    side: str = ""
    lever_arms: dict[str, LeverArm] = field(default_factory=dict)
    upper_arm: Length | None = None
    R_F_A: FloatArray | None = None
    accelerometer_bias: FloatArray | None = None
    gyroscope_bias: FloatArray | None = None
    upper_imu: dict[str, LeverArm] = field(default_factory=dict)
    R_U_B: FloatArray | None = None

    @property
    def forearm_direction(self) -> FloatArray | None:
        """Unit vector elbow to wrist in {A}, (3,); None without both lever arms."""
        if "elbow" not in self.lever_arms or "wrist" not in self.lever_arms:
            return None
        along = self.lever_arms["wrist"].position_m - self.lever_arms["elbow"].position_m
        return along / np.linalg.norm(along)
