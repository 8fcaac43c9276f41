"""The wrist's angles by an IMU on the hand: where the hand points, seen from the forearm."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..body import HAND
from ..calibration import LeverArm
from ..joint_angles import forearm_axes
from ..linalg import rotate_covariance, skew
from ..result import Recovery
from ..rotation import Rotation
from .definitions import WRIST
from .forearm_mounting import ForearmMounting
from .skeleton import Angles

#: A hand that points along the thumb's axis has no flexion.
_STEEP = 0.05


def wrist_angles(
    samples: Recovery,
    mounting: ForearmMounting,
) -> tuple[Angles, Angles]:  # values dict of (N,) deg, sigmas dict of (N,) deg
    """Flexion and deviation of the wrist, and their sigmas."""
    count = len(samples.t_s)
    values, sigmas = ({angle.name: np.full(count, np.nan) for angle in WRIST} for _ in range(2))
    motion, calibration = samples.segments.get(HAND.name), samples.calibration
    if motion is None or calibration is None or mounting.R_F_A is None:
        return values, sigmas
    both = np.isfinite(np.asarray(motion.quaternion)).all(axis=1)
    both &= np.isfinite(np.asarray(samples.quaternion)).all(axis=1)
    rows = np.flatnonzero(both)
    if not len(rows):
        return values, sigmas
    levers = calibration.mountings[HAND.name].lever_arms
    along = levers["hand"].position_m - levers["wrist"].position_m
    length_m = float(np.linalg.norm(along))
    R_K_H = Rotation.from_quat(np.asarray(motion.quaternion)[rows], scalar_first=True).as_matrix()
    R_K_F = forearm_axes(np.asarray(samples.quaternion)[rows], mounting.R_F_A)
    d_K = R_K_H @ (along / length_m)
    x, y, z = np.einsum("nji,nj->in", R_K_F, d_K)
    thumb = -1.0 if samples.side == "left" else 1.0
    with np.errstate(invalid="ignore", divide="ignore"):
        level = x**2 + y**2
        flexion, deviation = np.arctan2(-x, y), thumb * np.arcsin(np.clip(z, -1.0, 1.0))
        of_flexion = np.stack([-y / level, x / level, np.zeros_like(x)], axis=1)
        of_deviation = np.stack([np.zeros_like(x), np.zeros_like(x), thumb / np.sqrt(level)], axis=1)
    of_d_F = np.stack([of_flexion, of_deviation], axis=1)
    # turns of the hand and of the forearm in {K} move the direction against each other
    turns = rotate_covariance(R_K_F, _forearm_covariance(samples, mounting))
    for poses in (motion.pose_covariance, samples.pose_covariance):
        turns = turns + np.asarray(poses)[rows, 3:, 3:]
    across = rotate_covariance(skew(d_K), turns)
    tissue_m = calibration.mountings[HAND.name].tissue_m  # of either joint
    between = between_joints(levers["wrist"], levers["hand"], samples) + 2.0 * tissue_m**2
    across = across + rotate_covariance(R_K_H, np.diag(between / length_m**2))
    covariance = rotate_covariance(of_d_F @ np.swapaxes(R_K_F, 1, 2), across)
    known = level > _STEEP**2
    for number, (angle, value) in enumerate(zip(WRIST, (flexion, deviation), strict=True)):
        values[angle.name][rows[known]] = np.degrees(value[known])
        sigma = np.sqrt(np.maximum(covariance[known, number, number], 0.0))
        sigmas[angle.name][rows[known]] = np.degrees(sigma)
    return values, sigmas


def between_joints(first: LeverArm, second: LeverArm, samples: Recovery) -> FloatArray:
    """Variance (3,), m^2, of the vector between two joints: an error that all joints share is in it once."""
    bias_m = samples.estimates.joint_bias_sigma_m
    common = bias_m**2 if bias_m is not None and np.isfinite(bias_m) else 0.0
    either = first.sigma_m**2 + second.sigma_m**2
    return np.asarray(np.maximum(either - common, 0.5 * either))


def _forearm_covariance(samples: Recovery, mounting: ForearmMounting) -> FloatArray:
    """How far the forearm's axes are turned, (3, 3) rad^2 in {F}: about y by the roll, across by levers."""
    calibration = samples.calibration
    assert calibration is not None
    tilt_rad = 0.0
    if calibration.forearm_direction is not None:
        elbow, wrist = (calibration.lever_arms[joint] for joint in ("elbow", "wrist"))
        length_m = float(np.linalg.norm(wrist.position_m - elbow.position_m))
        tilt_rad = float(np.sqrt(between_joints(elbow, wrist, samples).max())) / length_m
    return np.asarray(np.diag([tilt_rad, np.radians(mounting.roll_sigma_deg), tilt_rad]) ** 2)


def why_no_wrist(arm: Recovery, mounting: ForearmMounting, name: str) -> str:
    """Why the wrist's angles are nowhere known, a sentence."""
    if mounting.R_F_A is None:
        return mounting.reason
    return "The IMUs on hand and forearm never have samples at the same time."
