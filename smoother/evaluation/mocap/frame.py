"""The mocap's frame {E} against the camera's {K}: from a calibration, or solved from what the camera saw.

p_K = R_K_E p_E + t_K_E. A calibration states it for the camera's optical axes {C} (x right, y down, z
forward); recordings may have other axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray, IntArray
from ...errors import CalibrationError, RecordingError
from ...linalg import nearest_rotation
from ...recording import CameraFrame
from ...result import Recovery
from ..metrics import orientation_at, position_at
from .clock import MocapClock, shared_places, summed_covariance
from .markers import numbers
from .motion import MocapMotion

#: `R_K_C`: optical axes to those of a recording. `zup` is taken as ROS has it: x forward, y left, z up.
FROM_OPTICAL = {
    CameraFrame.OPTICAL: np.eye(3),
    CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0]),
    CameraFrame.ZUP: np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
TABLE = "camera_from_mocap"
#: The joint centres must spread this far in two directions, m (rms), for a transform to be solved.
LEAST_SPREAD_M = 0.02


@dataclass(frozen=True)
class CameraFromMocap:
    """The transform, p_K = R_K_E p_E + t_K_E, in the recording's own camera axes."""

    R_K_E: FloatArray  # (3, 3) and (3,) m: rotation and translation
    t_K_E: FloatArray
    by: str  # What it was taken from
    rotation_sigma_deg: float = float("nan")  # Square root of the covariance's trace
    translation_sigma_m: float = float("nan")  # Likewise, of the place where the arm was
    residual_m: float = float("nan")  # Rms distance of the joint centres that it was solved from

    def place(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) of {E} in {K}, m."""
        return np.asarray(points @ self.R_K_E.T + self.t_K_E)


def stated_frame(table: Any, frame: CameraFrame | None, source: str) -> CameraFromMocap:
    """The transform of a calibration's table `camera_from_mocap`, in the axes of a recording."""
    if not isinstance(table, dict):
        raise CalibrationError(
            f"{source} has no [{TABLE}]; make it with `unocclude calibrate panel`, or leave --calibration out"
            " to align the truth by the motion"
        )
    rotation, translation = numbers(table.get("rotation"), 4), numbers(table.get("translation"), 3)
    if rotation is None or translation is None:
        raise CalibrationError(f"{source}: {TABLE} needs rotation (4 numbers) and translation (3 numbers)")
    if abs(np.linalg.norm(rotation) - 1) > 1e-3:
        raise CalibrationError(f"{source}: {TABLE}.rotation must be a unit quaternion [qw, qx, qy, qz]")
    if frame is None:
        raise CalibrationError(
            f"the axes of the recording's camera are unknown, so [{TABLE}] of {source} cannot be used;"
            " leave --calibration out to align the truth by the motion"
        )
    R_K_C = FROM_OPTICAL[frame]
    R_C_E = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    return CameraFromMocap(R_K_C @ R_C_E, R_K_C @ translation, f"[{TABLE}] of {source}")


def solve_frame(recovery: Recovery, motion: MocapMotion, clock: MocapClock) -> CameraFromMocap:
    """The transform from joint centres, and the IMU, while the camera saw the forearm; robust."""
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    unknown = np.full((len(recovery), 3, 3), np.nan)
    points = [
        (recovery.joints[name], position, recovery.joint_covariance.get(name, unknown))
        for name, position in motion.joints.items()
        if name in recovery.joints
    ]
    imu = imu_in_mocap(motion)
    if imu is not None:
        points.append((recovery.position, imu, recovery.pose_covariance[:, :3, :3]))
    if not points:
        raise RecordingError(f"{motion.source}: it shares no joint with the answer, so it cannot be aligned")
    K = np.concatenate([answer[rows] for answer, _, _ in points])
    E = np.concatenate([position_at(motion.t_s, position, t) for _, position, _ in points])
    owner = np.repeat(np.arange(len(points)), len(rows))
    t_imu = np.tile(recovery.t_s[rows], len(points))
    good = np.isfinite(K).all(axis=1) & np.isfinite(E).all(axis=1)
    K, E, owner, t_imu = K[good], E[good], owner[good], t_imu[good]
    if len(K) < 10:
        raise RecordingError(
            f"{motion.source}: truth and visible answer share {len(K)} samples, too few to align them by;"
            " give --calibration with [camera_from_mocap]"
        )
    spread = np.linalg.svd(E - E.mean(axis=0), compute_uv=False) / np.sqrt(len(E))
    if spread[1] < LEAST_SPREAD_M:
        raise RecordingError(
            f"{motion.source}: what the camera saw of the joint centres lies on a line, which leaves the"
            " rotation about it undetermined; map more joints, or give --calibration with"
            " [camera_from_mocap]"
        )
    # mean variances per axis while seen; zero where none is stated
    stated = [np.trace(covariance[rows], axis1=1, axis2=2) / 3.0 for _, _, covariance in points]
    typical = [np.nanmedian(each) if np.isfinite(each).any() else 0.0 for each in stated]
    return _robust_transform(K, E, t_imu, owner, np.array(typical))


def _robust_transform(
    K: FloatArray, E: FloatArray, t_imu: FloatArray, owner: IntArray, variance: FloatArray
) -> CameraFromMocap:
    """The transform from pairs of points (n, 3): nearest rotation, Cauchy weights."""
    weight = np.ones(len(K))
    for _ in range(20):
        centre_K, centre_E = np.average(K, axis=0, weights=weight), np.average(E, axis=0, weights=weight)
        R = nearest_rotation((weight[:, None] * (K - centre_K)).T @ (E - centre_E))
        residual = K - centre_K - (E - centre_E) @ R.T
        size = np.linalg.norm(residual, axis=1)
        fresh = 1.0 / (1.0 + (size / max(2.0 * np.median(size), 1e-9)) ** 2)
        if np.abs(fresh - weight).max() < 1e-6:
            break
        weight = fresh
    # by the rotation (about the centre) and the translation of the centre
    turned = (E - centre_E) @ R.T
    design = np.zeros((len(K), 3, 6))
    for axis in range(3):
        design[:, :, axis] = np.cross(np.eye(3)[axis], turned)
        design[:, axis, 3 + axis] = 1.0
    information = np.einsum("n,ndi,ndj->ij", weight, design, design)
    gradient = np.einsum("n,ndi,nd->ni", weight, design, residual)
    inverse = np.linalg.inv(information)
    covariance = inverse @ summed_covariance(t_imu, gradient) @ inverse
    for point, each in enumerate(variance):
        gain = inverse @ np.einsum("n,ndi->id", weight * (owner == point), design)
        covariance += each * gain @ gain.T
    shared = 3.0 * float(np.average(variance[owner], weights=weight))
    return CameraFromMocap(
        R,
        centre_K - R @ centre_E,
        "the joint centres while the camera saw them",
        float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        float(np.sqrt(np.trace(covariance[3:, 3:]) + shared)),
        float(np.sqrt(np.average(size**2, weights=weight))),
    )


def imu_in_mocap(motion: MocapMotion) -> FloatArray | None:
    """The IMU (N, 3) m in {E}; None without a plate, or where its place on the plate is not known."""
    if motion.p_E_P is None or motion.R_E_P is None or motion.p_A_P is None:
        return None
    if not motion.p_A_P.any():
        return motion.p_E_P
    if motion.R_A_P is None:
        return None
    return np.asarray(motion.p_E_P - np.einsum("nij,j->ni", motion.R_E_P, motion.R_A_P.T @ motion.p_A_P))


def far_off_m(recovery: Recovery, motion: MocapMotion, clock: MocapClock, frame: CameraFromMocap) -> float:
    """Median distance, m, of the truth's joint centres from the visible answer's; nan without any."""
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    away = [
        np.linalg.norm(mine[rows] - position_at(motion.t_s, frame.place(other), t), axis=1)
        for mine, other in shared_places(recovery, motion)
    ]
    known = np.concatenate(away or [np.empty(0)])
    return float(np.nanmedian(known)) if np.isfinite(known).any() else float("nan")


def solve_plate_place(
    recovery: Recovery, motion: MocapMotion, clock: MocapClock, frame: CameraFromMocap
) -> FloatArray:
    """The plate's origin in the IMU's axes, `p_A_P` (3,) m, from the answer while the camera saw the arm."""
    assert motion.R_A_P is not None and motion.p_E_P is not None
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    quaternion = orientation_at(motion.t_s, motion.quaternion, t)
    plate = frame.place(position_at(motion.t_s, motion.p_E_P, t))
    away = recovery.position[rows] - plate
    good = np.isfinite(away).all(axis=1) & np.isfinite(quaternion).all(axis=1)
    if good.sum() < 10:
        raise RecordingError(
            f"{motion.source}: plate and visible answer share too few samples to find the IMU on the plate;"
            " give the markers' positions in the IMU's axes in the map, [imu_plate]"
        )
    R_K_P = frame.R_K_E @ Rotation.from_quat(quaternion[good], scalar_first=True).as_matrix()
    in_plate = np.median(np.einsum("nji,nj->ni", R_K_P, away[good]), axis=0)
    return np.asarray(-motion.R_A_P @ in_plate)
