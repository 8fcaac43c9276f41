"""The angles of an arm in the order of the ISB's recommendation: names, zero and sign; from joints and axes.

Wu et al., J Biomech 38:981-992 (2005): humerus to thorax Y-X-Y (2.4.7), forearm to humerus Z-X-Y (3.4.1); of
hand to forearm, Z-X-Y as well (4), the hand's direction shows flexion and deviation. ISB axes: x forward, y
up along the bone, z to the right; a left arm is mirrored to a right one first. In degrees:

- `elbow_flexion`: 0 = straight.
- `carrying`: ISB's beta_HF, about the floating x axis; the ordinary valgus is negative. It needs the
  axis through the epicondyles. Without that the humerus is given ISB's second definition (flexion
  axis = normal of the plane of upper arm and forearm), in which it is zero by construction: nan here.
- `pronation`: 0 = palm forward with the arm hanging, 90 = thumb forward.
- `shoulder_plane`: 0 = abduction, 90 = forward flexion.
- `shoulder_elevation`: 0 = arm hanging, 90 = level (ISB's beta_TH with its sign turned).
- `shoulder_rotation`: axial rotation of the humerus, internal positive.

A skeleton of one arm does not show the thorax. It is treated as upright and facing the camera:
shoulder angles are relative to gravity and the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from ..rotation import Rotation

if TYPE_CHECKING:
    from ..result import Recovery

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

ANGLES = (
    "elbow_flexion",
    "carrying",
    "pronation",
    "shoulder_plane",
    "shoulder_elevation",
    "shoulder_rotation",
)
#: Nearer than this to a straight elbow, or to a hanging upper arm, angles that depend on it are noise, deg.
SINGULAR_DEG = 15.0
#: A z axis this near to the vertical does not show where the camera looks (cosine).
_UPRIGHT = 0.8


def recovery_angles(recovery: Recovery) -> dict[str, FloatArray]:
    """The angles (N,) of a recovery by the names in `ANGLES`, degrees; nan where not known."""
    mounting = None if recovery.calibration is None else recovery.calibration.R_F_A
    R_K_F = None if mounting is None else forearm_axes(recovery.quaternion, mounting)
    return arm_angles(recovery.joints, len(recovery), R_K_F, recovery.side, recovery.gravity_direction)


def forearm_axes(
    quaternion: FloatArray,  # (N, 4)
    R_F_A: FloatArray,  # (3, 3)
) -> FloatArray:  # (N, 3, 3)
    """Forearm axes in the camera frame, `R_K_F` = R_K_A R_A_F, (N, 3, 3)."""
    R_K_A = np.full((len(quaternion), 3, 3), np.nan)
    known = np.linalg.norm(quaternion, axis=1) > 0.0  # neither nan nor zero
    R_K_A[known] = Rotation.from_quat(quaternion[known], scalar_first=True).as_matrix()
    return R_K_A @ np.asarray(R_F_A).T


def arm_angles(
    joints: Mapping[str, FloatArray],  # dict of (count, 3) m
    count: int,
    R_K_F: FloatArray | None = None,  # (count, 3, 3)
    side: str = "right",
    down: FloatArray | None = None,  # (3,)
    *,
    forward: FloatArray | None = None,  # (3,)
    flexion_axis: FloatArray | None = None,  # (count, 3)
) -> dict[str, FloatArray]:  # dict of (count,) deg
    """Angles (count,) by the names in `ANGLES`, degrees in (-180, 180]; nan where not known."""
    angles = {name: np.full(count, np.nan) for name in ANGLES}
    if "shoulder" not in joints or "elbow" not in joints:
        return angles
    to_torso = np.eye(3)
    upright = down is not None and bool(np.isfinite(down).all())
    if upright:
        assert down is not None
        to_torso = torso_axes(down, forward).T
    if side == "left":
        to_torso = np.diag([1.0, 1.0, -1.0]) @ to_torso  # from here on it is a right arm
    y_humerus = unit((joints["shoulder"] - joints["elbow"]) @ to_torso.T)
    if upright:
        angles["shoulder_plane"] = _degrees(-y_humerus[:, 0], -y_humerus[:, 2])
        angles["shoulder_elevation"] = _degrees(np.hypot(y_humerus[:, 0], y_humerus[:, 2]), y_humerus[:, 1])
    if "wrist" not in joints:
        return angles

    y_forearm = unit((joints["elbow"] - joints["wrist"]) @ to_torso.T)
    if flexion_axis is None:  # ISB's second definition of the humerus
        z_humerus = unit(np.cross(y_humerus, y_forearm))
        x_humerus = np.cross(y_humerus, z_humerus)
        across = np.linalg.norm(np.cross(y_humerus, y_forearm), axis=1)
        angles["elbow_flexion"] = _degrees(across, _dot(y_forearm, y_humerus))
    else:
        x_humerus = unit(np.cross(y_humerus, flexion_axis @ to_torso.T))
        z_humerus = np.cross(x_humerus, y_humerus)
        angles["carrying"] = np.degrees(np.arcsin(np.clip(_dot(y_forearm, z_humerus), -1, 1)))
        angles["elbow_flexion"] = _degrees(-_dot(y_forearm, x_humerus), _dot(y_forearm, y_humerus))
    if upright:
        angles["shoulder_rotation"] = _degrees(-x_humerus[:, 1], z_humerus[:, 1])
    if R_K_F is not None:
        thumb = (R_K_F[:, :, 2] if side != "left" else -R_K_F[:, :, 2]) @ to_torso.T
        x_forearm = unit(np.cross(y_forearm, thumb))
        z_forearm = np.cross(x_forearm, y_forearm)
        angles["pronation"] = _degrees(-_dot(x_forearm, z_humerus), _dot(z_forearm, z_humerus))
    return angles


def torso_axes(
    down: FloatArray,  # (3,)
    forward: FloatArray | None = None,  # (3,)
) -> FloatArray:  # (3, 3)
    """Axes `R_K_T` (3, 3) of an upright thorax: x forward, y up, z to its right."""
    up = -np.asarray(down) / np.linalg.norm(down)
    if forward is None:
        forward = np.array([1.0, 0.0, 0.0]) if abs(up[2]) > _UPRIGHT else np.array([0.0, 0.0, -1.0])
    ahead = forward - (forward @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    return np.column_stack([ahead, up, np.cross(ahead, up)])


def defined(angles: dict[str, FloatArray]) -> dict[str, BoolArray]:  # angles dict of (N,) deg -> bool (N,)
    """Where each angle (N,) is known and 15 degrees or more from its singular posture."""
    bent = _between(angles["elbow_flexion"]) | np.isfinite(angles["carrying"])
    raised = _between(angles["shoulder_elevation"])
    good = {name: np.isfinite(value) for name, value in angles.items()}
    good["pronation"] &= bent
    good["shoulder_plane"] &= raised
    good["shoulder_rotation"] &= raised & bent
    return good


def wrapped_deg(difference: FloatArray) -> FloatArray:
    """Differences of angles brought to [-180, 180), degrees."""
    return (difference + 180.0) % 360.0 - 180.0


def _between(angle_deg: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray((angle_deg >= SINGULAR_DEG) & (angle_deg <= 180.0 - SINGULAR_DEG))


def _degrees(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    return np.degrees(np.arctan2(sine, cosine))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray((a * b).sum(axis=1))
