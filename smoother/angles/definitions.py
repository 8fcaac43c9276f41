"""The joint angles that a result may have: name, zero and sign, in the ISB's order of turns.

Wu et al., J Biomech 38:981-992 (2005): humerus to thorax Y-X-Y (2.4.7), forearm to humerus Z-X-Y (3.4.1); of
hand to forearm, Z-X-Y as well (4), the hand's direction shows flexion and deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

#: The thorax of the plain shoulder angles, in the words that columns and pages have for it.
UPRIGHT = "the trunk upright and facing the camera"


@dataclass(frozen=True)
class JointAngle:
    """A joint angle, as all outputs name it."""

    name: str  # Its columns are `NAME_deg` and `NAME_sigma_deg`
    title: str  # For pages and plots
    meaning: str  # What it is, its zero and the direction in which it grows; the column's description

    @property
    def column(self) -> str:
        """Of the angle, degrees."""
        return f"{self.name}_deg"

    @property
    def sigma_column(self) -> str:
        """Of its standard deviation, degrees."""
        return f"{self.name}_sigma_deg"

    @property
    def to_trunk(self) -> JointAngle:
        """The same angle against the trunk itself."""
        meaning = self.meaning.replace(UPRIGHT, "relative to the trunk itself")
        return JointAngle(f"{self.name}_trunk", f"{self.title} against the trunk", meaning)


ELBOW_FLEXION = JointAngle("elbow_flexion", "elbow flexion", "angle at the elbow, 0 = straight")
SHOULDER_PLANE = JointAngle(
    "shoulder_plane",
    "plane of shoulder elevation",
    f"plane of the shoulder (ISB), {UPRIGHT}, 0 = abduction, 90 = forward flexion",
)
SHOULDER_ELEVATION = JointAngle(
    "shoulder_elevation",
    "shoulder elevation",
    f"elevation of the shoulder (ISB), {UPRIGHT}, 0 = hanging, 90 = level",
)
SHOULDER_ROTATION = JointAngle(
    "shoulder_rotation",
    "shoulder rotation",
    f"rotation of the shoulder (ISB), {UPRIGHT}, internal positive",
)
PRONATION = JointAngle(
    "pronation",
    "forearm pronation",
    "pronation of the forearm (ISB), 0 = palm forward with the arm hanging, 90 = thumb forward",
)
SHOULDER = (SHOULDER_PLANE, SHOULDER_ELEVATION, SHOULDER_ROTATION)
SHOULDER_TRUNK = tuple(angle.to_trunk for angle in SHOULDER)
WRIST = (
    JointAngle(
        "wrist_flexion",
        "wrist flexion",
        "flexion of the wrist, 0 = the hand in line with the forearm, to the palm positive",
    ),
    JointAngle(
        "wrist_deviation",
        "wrist deviation",
        "radial deviation of the wrist, 0 = the hand in line with the forearm, to the thumb positive",
    ),
)
#: All of them, in the order of columns, curves and messages.
JOINT_ANGLES = (ELBOW_FLEXION, *SHOULDER, PRONATION, *SHOULDER_TRUNK, *WRIST)
#: What people call each, by its name.
ANGLE_TITLES = {angle.name: angle.title for angle in JOINT_ANGLES}
