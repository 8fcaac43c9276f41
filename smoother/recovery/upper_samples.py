"""The upper-arm IMU's answer at the samples of a section, and what it says of the elbow's axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..linalg import interpolate, unit
from ..rotation import Rotation
from ..selfcal.self_calibration import SelfCalibration
from ..window.trajectory import Trajectory
from ..window.upper_runs import PreparedRun
from ..window.upper_times import upper_at
from .samples import SectionAnswer, widen_turns

#: An elbow straighter than this (sine of its flexion) does not show its axis.
MIN_ELBOW_SIN = 0.3
#: Samples of the axis that far apart count as independent, s.
APART_S = 1.0


@dataclass(frozen=True)
class UpperAnswer:
    """The upper-arm IMU at the samples of a section; see `UpperMotion`.

    Attributes
    ----------
    position, quaternion, pose_covariance : ndarray, shape (n, 3), (n, 4), (n, 6, 6)
        nan where it has no samples.
    axis : ndarray, shape (3, 3)
        Sum of a a' over samples with a bent elbow, a the normal of the arm's plane in {B}.
    mean_axis : ndarray, shape (3,)
        Sum of a.
    weight : float
        Independent samples in both.
    """

    position: FloatArray
    quaternion: FloatArray
    pose_covariance: FloatArray
    axis: FloatArray
    mean_axis: FloatArray
    weight: float


def sample_upper(
    answer: SectionAnswer,
    imu_t: FloatArray,
    trajectory: Trajectory,
    prepared: Sequence[PreparedRun],
    model: SelfCalibration,
) -> UpperAnswer | None:
    """The upper-arm IMU at the samples that a section answers for.

    Parameters
    ----------
    answer : SectionAnswer
        Of the forearm.
    imu_t : ndarray, shape (n,), s
        Stamps of these samples.
    trajectory : Trajectory
        Of the second pass.
    prepared : sequence of PreparedRun
    model : SelfCalibration
        As all sections have it.

    Returns
    -------
    upper : UpperAnswer or None
        None where the recording has no such IMU.
    """
    upper = trajectory.upper
    if upper is None:
        return None
    states = upper_at(upper, prepared, imu_t)
    known = np.isfinite(states.p[:, 0])
    quaternion = np.full((len(imu_t), 4), np.nan)
    pose = np.full((len(imu_t), 6, 6), np.nan)
    if known.any():
        quaternion[known] = Rotation.from_matrix(states.R[known]).as_quat(scalar_first=True)
        v = states.v[known]
        covariance = widen_turns(interpolate(upper.t, upper.pose_covariance, imu_t)[known])
        covariance[:, :3, :3] += model.clock.local_sigma_s**2 * v[:, :, None] * v[:, None, :]
        pose[known] = covariance
    axes = _axes(answer, states.R)
    weight = len(axes) * float(np.median(np.diff(imu_t))) / APART_S if len(imu_t) > 1 else 0.0
    share = weight / max(len(axes), 1)
    return UpperAnswer(states.p, quaternion, pose, share * axes.T @ axes, share * axes.sum(axis=0), weight)


def _axes(answer: SectionAnswer, R_K_B: FloatArray) -> FloatArray:
    """Normals (m, 3) of the plane of upper arm and forearm in {B}, where the elbow is bent."""
    joints = answer.joints
    if not {"shoulder", "elbow", "wrist"} <= joints.keys():
        return np.zeros((0, 3))
    upper, fore = unit(joints["shoulder"] - joints["elbow"]), unit(joints["elbow"] - joints["wrist"])
    normal = np.einsum("nji,nj->ni", R_K_B, np.cross(upper, fore))
    size = np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore"):
        return normal[size > MIN_ELBOW_SIN] / size[size > MIN_ELBOW_SIN, None]


def humerus_axes(
    answers: Sequence[UpperAnswer], calibration: ArmCalibration, side: str, tissue_m: float
) -> tuple[FloatArray | None, FloatArray]:
    """The bone's axes in {B}, and how far they may be off.

    y points from elbow to shoulder; z, towards the lateral epicondyle, is the mean normal of the arm's plane
    (ISB's second definition of the humerus, averaged over the recording).

    Parameters
    ----------
    answers : sequence of UpperAnswer
        Of all sections.
    calibration : ArmCalibration
        Its `upper_imu` holds elbow and shoulder in {B}.
    side : str
    tissue_m : float, m
        How far soft tissue moves both.

    Returns
    -------
    R_U_B : ndarray, shape (3, 3), or None
        None where the elbow was never bent.
    sigma_rad : ndarray, shape (3,), rad
        About each axis of the bone.
    """
    elbow, shoulder = calibration.upper_imu["elbow"], calibration.upper_imu["shoulder"]
    along = shoulder.position_m - elbow.position_m
    length_m = float(np.linalg.norm(along))
    y = along / length_m
    weight = sum(answer.weight for answer in answers)
    mean = sum((answer.mean_axis for answer in answers), np.zeros(3))
    scatter = sum((answer.axis for answer in answers), np.zeros((3, 3)))
    across = mean - (mean @ y) * y
    tissue_rad = tissue_m / (0.5 * length_m)
    lever_rad = float(np.hypot(elbow.sigma_m.max(), shoulder.sigma_m.max())) / length_m
    sigma = np.hypot(np.array([lever_rad, 0.0, lever_rad]), tissue_rad)
    if weight < 1.0 or np.linalg.norm(across) < MIN_ELBOW_SIN * weight:
        return None, sigma
    z = unit(across) * (-1.0 if side == "left" else 1.0)
    x = np.cross(y, z)
    spread = float(x @ scatter @ x) / weight  # of the axis about y, rad^2 for small angles
    sigma[1] = np.sqrt(sigma[1] ** 2 + spread / weight + lever_rad**2)
    return np.stack([x, y, z]), sigma
