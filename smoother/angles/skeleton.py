"""Elbow, shoulder and forearm from joints and one IMU's orientation, each angle with its sigma.

Sigma is by first-order propagation through the angles of `joint_angles.arm_angles`, of the pose of the
forearm's IMU (it moves the elbow and turns the forearm), of the shoulder's position, and of the forearm's
direction in the IMU's axes. The shoulder's errors are treated as independent of the IMU's, as a recovery
keeps no covariance between them; of what both add up to, a measured part counts (`UPPER_ARM_SHARE`).
"""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..joint_angles import arm_angles, elbow_flexion_sigma, forearm_axes, torso_axes
from ..linalg import rotate_covariance, unit
from ..result import Recovery
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
#: Least sine of elevation in these formulas: a bone that hangs straight has no plane.
_NO_PLANE = 1e-12


def skeleton_angles(
    arm: Recovery,
    mounting: ForearmMounting,
) -> tuple[Angles, Angles]:  # angles dict of (N,) deg, sigmas dict of (N,) deg
    """The angles of an arm as its joints and the forearm's IMU have them, the trunk upright."""
    names = [angle.name for angle in (*SHOULDER, PRONATION)]
    values, sigmas = _with_sigma(arm, mounting, names, None, None)
    return values, sigmas | {ELBOW_FLEXION.name: elbow_flexion_sigma(arm)}


def skeleton_trunk_angles(
    arm: Recovery,
    mounting: ForearmMounting,
) -> tuple[Angles, Angles]:  # angles dict of (N,) deg, sigmas dict of (N,) deg
    """The shoulder's angles against the thorax, by the joints."""
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
    """Sigma (N,) of an elevation with what it has of the error across it, degrees."""
    sine = np.maximum(np.abs(np.sin(np.radians(elevation_deg))), _NO_PLANE)
    across = np.minimum(np.radians(plane_sigma_deg) * sine, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        longer = np.minimum(0.5 * across**2 / np.maximum(sine, 1e-9), across)
    return np.asarray(np.hypot(sigma_deg, np.degrees(longer)))


def direction_variance(arm: Recovery) -> float:
    """How far the forearm's direction may be off in the IMU's axes, rad^2 per axis."""
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
    arm: Recovery,
    mounting: ForearmMounting,
    names: list[str],
    R_K_T: FloatArray | None,
    of_trunk: FloatArray | None,
) -> tuple[Angles, Angles]:
    """Angles of shoulder, elbow and forearm against a thorax (N, 3, 3) or an upright one; sigmas of some."""
    values = {name: np.full(len(arm), np.nan) for name in (*names, ELBOW_FLEXION.name)}
    sigmas = {name: values[name] for name in names}
    if not {"shoulder", "elbow"} <= set(arm.joints):
        return values, sigmas
    elbow = np.asarray(arm.joints["elbow"])
    upper = np.asarray(arm.joints["shoulder"]) - elbow
    fore = arm.joints["wrist"] - elbow if "wrist" in arm.joints else np.full_like(elbow, np.nan)
    values = _values(arm, mounting, upper, fore, R_K_T)
    if "shoulder" not in arm.joint_covariance:
        return values, sigmas
    pose, shoulder = np.asarray(arm.pose_covariance), np.asarray(arm.joint_covariance["shoulder"])
    own = direction_variance(arm)
    apart, forearm = _slopes(upper, fore, arm.gravity_direction, R_K_T)
    # The pose moves the elbow, whose error counts in part as the shoulder's does, and turns the forearm.
    turned = np.cross(apart, (elbow - arm.position)[:, :, None], axis=1)
    by_pose = np.sqrt(UPPER_ARM_SHARE) * np.concatenate([-apart, turned], axis=1)
    by_pose[:, 3:] += forearm
    variance = _propagated(by_pose, pose) + UPPER_ARM_SHARE * _propagated(apart, shoulder)
    variance += own * (forearm**2).sum(axis=1)
    if of_trunk is not None:  # the trunk's turn is one of the whole arm the other way round
        variance += _propagated(np.cross(upper[:, :, None], apart, axis=1) + forearm, of_trunk)
    of_name = dict(zip(_SLOPES, np.degrees(np.sqrt(variance)).T, strict=True))
    of_name[PRONATION.name] = np.hypot(of_name[PRONATION.name], mounting.roll_sigma_deg)
    sigmas = {name: of_name[name] for name in names}
    elevation, plane = SHOULDER_ELEVATION.name, SHOULDER_PLANE.name
    sigmas[elevation] = widened_elevation(values[elevation], sigmas[elevation], sigmas[plane])
    return values, {
        name: np.where(np.isfinite(values[name]), np.minimum(sigma, MOST_SIGMA_DEG), np.nan)
        for name, sigma in sigmas.items()
    }


def _propagated(slope: FloatArray, covariance: FloatArray) -> FloatArray:
    """Variances (N, m) of m angles by their slopes (N, k, m) and covariances (N, k, k)."""
    return np.asarray(np.einsum("nim,nim->nm", covariance @ slope, slope))


#: The angles that `_slopes` gives.
_SLOPES = (*(angle.name for angle in SHOULDER), PRONATION.name)


def _values(
    arm: Recovery, mounting: ForearmMounting, upper: FloatArray, fore: FloatArray, R_K_T: FloatArray | None
) -> Angles:
    """Angles of bones (N, 3) from the elbow to shoulder and wrist."""
    if R_K_T is None:
        axes = None if mounting.R_F_A is None else forearm_axes(np.asarray(arm.quaternion), mounting.R_F_A)
        joints = {"shoulder": upper, "elbow": np.zeros_like(upper), "wrist": fore}
        return arm_angles(joints, len(upper), axes, arm.side, arm.gravity_direction)
    upper, fore = (np.einsum("nji,nj->ni", R_K_T, bone) for bone in (upper, fore))
    joints = {"shoulder": upper, "elbow": np.zeros_like(upper), "wrist": fore}
    return arm_angles(joints, len(upper), None, arm.side, DOWN_T, forward=FORWARD_T)


def _slopes(
    upper: FloatArray, fore: FloatArray, down: FloatArray, R_K_T: FloatArray | None
) -> tuple[FloatArray, FloatArray]:  # apart (N, 3, 4), forearm (N, 3, 4)
    """Derivatives of the angles of a right arm; those of a left one are these or their negatives."""
    T = np.full((3, 3), np.nan) if R_K_T is None else R_K_T
    if R_K_T is None and np.isfinite(down).all():
        T = torso_axes(down)
    reach = np.linalg.norm(upper, axis=1)[:, None]
    u, v = unit(upper), -unit(fore)
    # of a bone that hangs straight the plane is not determined: any will do
    level = np.cross(T[..., 1], u) + _NO_PLANE * T[..., 0]
    bend = np.cross(u, v)
    z = unit(bend)
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = level / (level**2).sum(axis=1)[:, None] / reach
        elevation = np.cross(unit(level), u) / reach
        sine = np.linalg.norm(bend, axis=1)[:, None]
        cotangent = (u * v).sum(axis=1)[:, None] / sine
        by_bend = z / reach
        rise = (T[..., 1] * u).sum(axis=1)[:, None]
        apart = [plane, elevation, -rise * plane - cotangent * by_bend, by_bend / sine]
        rotation, pronation = u + cotangent * np.cross(u, z), v - cotangent * np.cross(v, z)
    forearm = [np.zeros_like(u), np.zeros_like(u), rotation, pronation]
    return np.stack(apart, axis=2), np.stack(forearm, axis=2)
