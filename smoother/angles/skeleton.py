"""Elbow, shoulder and forearm from joints and one IMU's orientation, each angle with its sigma.

Sigma is by first-order propagation through `joint_angles.arm_angles` itself, of the pose of the forearm's IMU
(it moves the elbow and turns the forearm), of the shoulder's position, and of the forearm's direction in the
IMU's axes. The shoulder's errors are treated as independent of the IMU's, as a recovery keeps no covariance
between them; of what both add up to, a measured part counts (`UPPER_ARM_SHARE`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import arm_angles, elbow_flexion_sigma, forearm_axes, wrapped_deg
from ..linalg import rotate_covariance
from ..result.moving_arm import MovingArm
from ..rotation import Rotation
from ..shoulder_angles import DOWN_T, FORWARD_T
from .definitions import (
    ELBOW_FLEXION,
    PRONATION,
    SHOULDER,
    SHOULDER_ELEVATION,
    SHOULDER_PLANE,
    SHOULDER_TRUNK,
)
from .forearm_mounting import ForearmMounting

Angles = dict[str, FloatArray]

#: How far skin and strap turn the IMU on the forearm, rad per axis (2.3 degrees rms about all three on
#: realistic simulated arms; real straps turn by 1 to 3).
STRAP_RAD = np.radians(1.1)
#: What an upper arm's direction is off by, as a part of the variance that shoulder and elbow state together.
#: What all of a camera's joints are off by turns no arm, and slow noise is stated as white noise of the
#: same long-run size; no covariance between joints is kept that would determine it. On simulated arms it is
#: 0.28 (`azure`), 0.46 (`realistic`) and 0.5 (`white`).
UPPER_ARM_SHARE = 0.5
#: A forearm's length where the lever arms do not give it, m.
FOREARM_M = 0.25
#: An angle that may be anything is off by this at most, degrees.
MOST_SIGMA_DEG = 180.0
#: Steps of the numerical derivatives, m and rad.
_STEP = 1e-6


def skeleton_angles(arm: MovingArm, mounting: ForearmMounting) -> tuple[Angles, Angles]:
    """The angles of an arm as its joints and the forearm's IMU have them, the trunk upright.

    Parameters
    ----------
    arm : MovingArm
        Of N samples.
    mounting : ForearmMounting
        Of the whole recording.

    Returns
    -------
    angles, sigmas : dict of str to ndarray, shape (N,), deg
        By the names in `JOINT_ANGLES` but for those against the trunk. nan where not known; near a hanging
        or upright arm plane and rotation are hardly determined, near a straight elbow rotation and pronation:
        sigma grows there to 180 degrees, which means that the angle is unknown.
    """
    names = [angle.name for angle in (*SHOULDER, PRONATION)]
    values, sigmas = _with_sigma(arm, mounting, names, None, None)
    flexion = arm_angles(arm.joints, len(arm))[ELBOW_FLEXION.name]
    return values | {ELBOW_FLEXION.name: flexion}, sigmas | {ELBOW_FLEXION.name: elbow_flexion_sigma(arm)}


def skeleton_trunk_angles(arm: MovingArm, mounting: ForearmMounting) -> tuple[Angles, Angles]:
    """The shoulder's angles against the thorax, by the joints.

    Parameters
    ----------
    arm : MovingArm
        Of N samples, with the trunk's motion.
    mounting : ForearmMounting
        Of the whole recording.

    Returns
    -------
    angles, sigmas : dict of str to ndarray, shape (N,), deg
        By the names of the angles against the trunk; sigma includes the trunk's orientation and its mounting.
    """
    trunk = arm.trunk
    if trunk is None:
        nothing = {angle.name: np.full(len(arm), np.nan) for angle in SHOULDER_TRUNK}
        return nothing, dict(nothing)
    R_K_T = forearm_axes(np.asarray(trunk.quaternion), np.eye(3))
    covariance = trunk.covariance + rotate_covariance(R_K_T, np.diag(trunk.mount_sigma_rad**2))
    found = _with_sigma(arm, mounting, [angle.name for angle in SHOULDER], R_K_T, covariance)
    values, sigmas = (
        {of.name: columns[plain.name] for plain, of in zip(SHOULDER, SHOULDER_TRUNK, strict=True)}
        for columns in found
    )
    return values, sigmas


def widened_elevation(
    elevation_deg: FloatArray, sigma_deg: FloatArray, plane_sigma_deg: FloatArray
) -> FloatArray:
    """Sigma (N,) of an elevation with what it has of the error across it, degrees.

    Elevation has no sign: near a hanging (or upright) arm any error across the plane lengthens it,
    by half its square over the elevation, and by itself at most.

    Parameters
    ----------
    elevation_deg, sigma_deg : ndarray, shape (N,), deg
        As linearised.
    plane_sigma_deg : ndarray, shape (N,), deg
        Of the plane of elevation, not limited.
    """
    sine = np.abs(np.sin(np.radians(elevation_deg)))
    across = np.minimum(np.radians(plane_sigma_deg) * sine, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        longer = np.minimum(0.5 * across**2 / np.maximum(sine, 1e-9), across)
    return np.asarray(np.hypot(sigma_deg, np.degrees(longer)))


def direction_variance(arm: MovingArm) -> float:
    """How far the forearm's direction may be off in the IMU's axes, rad^2 per axis.

    By the lever arms of elbow and wrist without what both have in common, and by strap and skin.
    """
    calibration = arm.calibration
    levers = {} if calibration is None else calibration.lever_arms
    if "elbow" not in levers or "wrist" not in levers:
        return float(STRAP_RAD**2)
    elbow, wrist = levers["elbow"], levers["wrist"]
    own = [float(np.mean(lever.sigma_m**2)) for lever in (elbow, wrist)]
    common = min((arm.estimates.joint_bias_sigma_m or 0.0) ** 2, *own)
    length = float(np.linalg.norm(wrist.position_m - elbow.position_m)) or FOREARM_M
    return float((sum(own) - 2.0 * common) / length**2 + STRAP_RAD**2)


def _with_sigma(
    arm: MovingArm,
    mounting: ForearmMounting,
    names: list[str],
    R_K_T: FloatArray | None,
    of_trunk: FloatArray | None,
) -> tuple[Angles, Angles]:
    """Shoulder angles, and pronation where it is asked for, against a thorax (N, 3, 3) or an upright one."""
    if not {"shoulder", "elbow"} <= set(arm.joints):
        nothing = {name: np.full(len(arm), np.nan) for name in names}
        return nothing, dict(nothing)
    geometry = _Geometry(arm, mounting, R_K_T)
    values = geometry.angles(geometry.upper, np.eye(3))
    values = {name: values[name] for name in names}
    if "shoulder" not in arm.joint_covariance:
        return values, {name: np.full(len(arm), np.nan) for name in names}
    pose, shoulder = np.asarray(arm.pose_covariance), np.asarray(arm.joint_covariance["shoulder"])
    own = direction_variance(arm)
    sigmas = {}
    for name, slope in geometry.slopes(values, of_trunk is not None).items():
        # The pose moves the elbow, whose error counts in part as the shoulder's does, and turns the forearm.
        of_elbow = np.concatenate([-slope.apart, geometry.by_turn_of_elbow(slope.apart)], axis=1)
        by_pose = np.sqrt(UPPER_ARM_SHARE) * of_elbow
        by_pose[:, 3:] += slope.forearm
        variance = _propagated(by_pose, pose) + UPPER_ARM_SHARE * _propagated(slope.apart, shoulder)
        variance += own * (slope.forearm**2).sum(axis=1)
        if of_trunk is not None:
            variance += _propagated(slope.whole, of_trunk)
        if name == PRONATION.name:
            variance += mounting.roll_sigma_deg**2
        sigmas[name] = np.sqrt(variance)
    elevation, plane = SHOULDER_ELEVATION.name, SHOULDER_PLANE.name
    sigmas[elevation] = widened_elevation(values[elevation], sigmas[elevation], sigmas[plane])
    return values, {
        name: np.where(np.isfinite(values[name]), np.minimum(sigma, MOST_SIGMA_DEG), np.nan)
        for name, sigma in sigmas.items()
    }


def _propagated(slope: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (N,) by slopes (N, k) and covariances (N, k, k)."""
    return np.asarray(np.einsum("ni,nij,nj->n", slope, covariance, slope))


class _Slopes(NamedTuple):
    """Derivatives of an angle, (N, 3) each in {K}, deg/m and deg/rad.

    By the shoulder's place against the IMU's; by a turn of the forearm about the elbow; by one of the whole
    arm, which is the trunk's the other way round.
    """

    apart: FloatArray
    forearm: FloatArray
    whole: FloatArray


class _Geometry:
    """Upper arm and forearm of an arm's samples, which may be moved a little."""

    def __init__(self, arm: MovingArm, mounting: ForearmMounting, R_K_T: FloatArray | None) -> None:
        elbow = np.asarray(arm.joints["elbow"])
        #: From elbow to shoulder, and to the wrist, (N, 3) m in {K}.
        self.upper = np.asarray(arm.joints["shoulder"]) - elbow
        self._fore = arm.joints["wrist"] - elbow if "wrist" in arm.joints else np.full_like(elbow, np.nan)
        self._from_imu = elbow - arm.position
        R_F_A = mounting.R_F_A
        self._R_K_F = None if R_F_A is None else forearm_axes(np.asarray(arm.quaternion), R_F_A)
        self._side, self._down, self._R_K_T = arm.side, arm.gravity_direction, R_K_T

    def angles(self, upper: FloatArray, turn: FloatArray) -> Angles:
        """With another upper arm (N, 3), and a forearm that is turned (3, 3)."""
        fore = _turned(self._fore, turn)
        axes = None if self._R_K_F is None else turn @ self._R_K_F
        if self._R_K_T is None:
            joints = {"shoulder": upper, "elbow": np.zeros_like(upper), "wrist": fore}
            return arm_angles(joints, len(upper), axes, self._side, self._down)
        upper, fore = (np.einsum("nji,nj->ni", self._R_K_T, bone) for bone in (upper, fore))
        joints = {"shoulder": upper, "elbow": np.zeros_like(upper), "wrist": fore}
        return arm_angles(joints, len(upper), None, self._side, DOWN_T, forward=FORWARD_T)

    def slopes(self, base: Angles, of_whole: bool) -> dict[str, _Slopes]:
        """Of the angles that `angles` gives for the arm as it is; by one of the whole only if asked for."""
        slopes = {name: _Slopes(*(np.full((len(self.upper), 3), np.nan) for _ in range(3))) for name in base}
        for axis, step in enumerate(_STEP * np.eye(3)):
            turn = Rotation.from_rotvec(step).as_matrix()
            moved = [self.angles(self.upper + step, np.eye(3)), self.angles(self.upper, turn)]
            if of_whole:
                moved.append(self.angles(_turned(self.upper, turn), turn))
            for name, of_angle in slopes.items():
                for slope, angles in zip(of_angle, moved, strict=False):
                    slope[:, axis] = wrapped_deg(angles[name] - base[name]) / _STEP
        return slopes

    def by_turn_of_elbow(self, apart: FloatArray) -> FloatArray:
        """Slopes (N, 3) by how the IMU's turn moves the elbow, from those by the shoulder's place."""
        return np.asarray(np.cross(apart, self._from_imu))


def _turned(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    """Vectors (N, 3) turned by (3, 3); a product of matrices would round a single row otherwise than many."""
    x, y, z = (vectors[:, i, None] for i in range(3))
    return np.asarray(x * turn[:, 0] + y * turn[:, 1] + z * turn[:, 2])
