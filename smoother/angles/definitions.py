"""The joint angles that a result may have: name, zero and sign, and where the ISB defines them."""

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
    isb: str  # Section of Wu et al., J Biomech 38:981-992 (2005), and which turn of its sequence it is

    @property
    def column(self) -> str:
        """Of the angle, degrees."""
        return f"{self.name}_deg"

    @property
    def sigma_column(self) -> str:
        """Of its standard deviation, degrees."""
        return f"{self.name}_sigma_deg"


_HUMERUS = "2.4.7, humerus to thorax, Y-X-Y"
ELBOW_FLEXION = JointAngle(
    "elbow_flexion",
    "elbow flexion",
    "angle at the elbow, 0 = straight",
    "3.4.1, forearm to humerus, Z-X-Y: Z",
)
SHOULDER_PLANE = JointAngle(
    "shoulder_plane",
    "shoulder plane of elevation",
    f"plane of the shoulder (ISB), {UPRIGHT}, 0 = abduction, 90 = forward flexion",
    f"{_HUMERUS}: first Y",
)
SHOULDER_ELEVATION = JointAngle(
    "shoulder_elevation",
    "shoulder elevation",
    f"elevation of the shoulder (ISB), {UPRIGHT}, 0 = hanging, 90 = level",
    f"{_HUMERUS}: X, with its sign turned",
)
SHOULDER_ROTATION = JointAngle(
    "shoulder_rotation",
    "shoulder rotation",
    f"rotation of the shoulder (ISB), {UPRIGHT}, internal positive",
    f"{_HUMERUS}: second Y",
)
PRONATION = JointAngle(
    "pronation",
    "forearm pronation",
    "pronation of the forearm (ISB), 0 = palm forward with the arm hanging, 90 = thumb forward",
    "3.4.1, forearm to humerus, Z-X-Y: Y",
)


WRIST_FLEXION = JointAngle(
    "wrist_flexion",
    "wrist flexion",
    "flexion of the wrist, 0 = the hand in line with the forearm, to the palm positive",
    "4, hand to forearm, Z-X-Y: Z; by the hand's direction alone",
)
WRIST_DEVIATION = JointAngle(
    "wrist_deviation",
    "wrist deviation",
    "radial deviation of the wrist, 0 = the hand in line with the forearm, to the thumb positive",
    "4, hand to forearm, Z-X-Y: X, radial positive; by the hand's direction alone",
)


def _to_trunk(angle: JointAngle) -> JointAngle:
    """The same angle against the trunk itself."""
    return JointAngle(
        f"{angle.name}_trunk",
        f"{angle.title} against the trunk",
        angle.meaning.replace(UPRIGHT, "relative to the trunk itself"),
        angle.isb,
    )


SHOULDER = (SHOULDER_PLANE, SHOULDER_ELEVATION, SHOULDER_ROTATION)
SHOULDER_TRUNK = tuple(_to_trunk(angle) for angle in SHOULDER)
WRIST = (WRIST_FLEXION, WRIST_DEVIATION)
#: All of them, in the order of columns, curves and messages.
JOINT_ANGLES = (ELBOW_FLEXION, *SHOULDER, PRONATION, *SHOULDER_TRUNK, *WRIST)
