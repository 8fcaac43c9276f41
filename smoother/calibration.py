"""The arm's calibration as a plain value: what the smoother takes, and what it answers.

Its file belongs to the package `calib`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .array_types import FloatArray


@dataclass(frozen=True)
class LeverArm:
    """A joint's constant position in the forearm IMU's axes {A}."""

    position_m: FloatArray  # (3,) m: In {A}
    sigma_m: FloatArray  # (3,) m: One standard deviation of each axis


@dataclass(frozen=True)
class Length:
    """A length and its standard deviation."""

    value_m: float
    sigma_m: float  # One standard deviation


@dataclass(frozen=True)
class SigmaFactor:
    """How much wider sigma must be in gaps of one length, as hidden gaps have shown."""

    length_s: float  # Of the gaps
    factor: float  # What sigma of a position is multiplied by
    gaps: int  # Hidden gaps behind it


@dataclass(frozen=True)
class SigmaFactors:
    """Factors of sigma by the length of a gap."""

    by_length: tuple[SigmaFactor, ...]  # Of increasing lengths, at least one

    def at(self, length_s: float) -> float:
        """The factor for a gap of some length: linear between the lengths, held beyond them."""
        lengths = [entry.length_s for entry in self.by_length]
        return float(np.interp(length_s, lengths, [entry.factor for entry in self.by_length]))

    @property
    def longest_s(self) -> float:
        """The longest gap that was hidden, s."""
        return self.by_length[-1].length_s


@dataclass(frozen=True)
class SegmentMounting:
    """How an IMU sits on a segment beyond the forearm."""

    lever_arms: dict[str, LeverArm]  # Of the segment's two joints, in that IMU's axes
    tissue_m: float = 0.01  # How far the joints are from constant there, per axis: soft tissue
    R_bone: FloatArray | None = None  # (3, 3): Maps a vector from that IMU's axes to the bone's (ISB)


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
    sigma_factors : SigmaFactors or None
        How much wider positions in gaps must be stated for this camera; None where not checked.
    mountings : dict of str to SegmentMounting
        Of IMUs on further segments, by the segment's name ("upper_arm": elbow and shoulder in {B}).
    """

    side: str = ""
    lever_arms: dict[str, LeverArm] = field(default_factory=dict)
    upper_arm: Length | None = None
    R_F_A: FloatArray | None = None
    accelerometer_bias: FloatArray | None = None
    gyroscope_bias: FloatArray | None = None
    sigma_factors: SigmaFactors | None = None
    mountings: dict[str, SegmentMounting] = field(default_factory=dict)

    @property
    def upper_imu(self) -> dict[str, LeverArm]:
        """Elbow and shoulder in the axes {B} of an IMU on the upper arm; empty where there is none."""
        return self.mountings["upper_arm"].lever_arms if "upper_arm" in self.mountings else {}

    @property
    def R_U_B(self) -> FloatArray | None:
        """Maps a vector from that IMU's axes to the upper arm's, (3, 3); None where unknown.

        y points from elbow to shoulder, z along the axis of elbow flexion from the medial to the lateral
        epicondyle.
        """
        return self.mountings["upper_arm"].R_bone if "upper_arm" in self.mountings else None

    def with_bone_axes(self, segment: str, R_bone: FloatArray | None) -> ArmCalibration:
        """The same with the axes of a segment's bone (3, 3) in its IMU's."""
        mounting = replace(self.mountings[segment], R_bone=R_bone)
        return replace(self, mountings=self.mountings | {segment: mounting})

    @property
    def forearm_direction(self) -> FloatArray | None:
        """Unit vector elbow to wrist in {A}, (3,); None where one is unknown, or both are one point."""
        if "elbow" not in self.lever_arms or "wrist" not in self.lever_arms:
            return None
        along = self.lever_arms["wrist"].position_m - self.lever_arms["elbow"].position_m
        length_m = np.linalg.norm(along)
        return along / length_m if length_m > 0.0 else None
