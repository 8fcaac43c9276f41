"""The paths of all scenes put together: a baseline's `Recovery`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..calibration import ArmCalibration
from ..linalg import interpolate, rotate_covariance, skew
from ..measurements.alignment import lever_of
from ..recording import JOINTS, FloatArray, Recording
from ..result import Recovery
from .scene import Path, Scene

#: What of the graph's figures a baseline was told, and its result repeats.
TOLD_FIGURES = ("camera_sigma_m", "camera_effective_sigma_m", "joint_bias_m", "joint_bias_sigma_m")

TOLD = (
    "calibration, clock, gravity and what is occluded are the graph's, which every method to compare with is"
    " told; only the path between is this method's"
)


def answer(
    recording: Recording,
    told: Recovery,
    scenes: Sequence[Scene],
    paths: Sequence[Path],
    method: str,
    settings: dict[str, object] | None = None,
) -> Recovery:
    """A baseline's answer at every IMU sample; nan where it has none, covariances nan where it states none.

    Joints are pose and lever arm unless the path gives them; the shoulder is the camera's, linear between
    its frames.

    Parameters
    ----------
    told : the graph's recovery of the recording, see `scenes_of`.
    scenes, paths : stretch by stretch.
    settings : what the method was told beside, by name; kept in the result's figures.
    """
    assert told.residuals is not None
    names = [joint for joint in JOINTS if joint in recording.arm.present and joint != "strap"]
    whole = _Whole(len(recording.imu), names)
    residual = np.full((len(told.arm), len(JOINTS), 3), np.nan)
    for scene, path in zip(scenes, paths, strict=True):
        stamps = recording.imu.t_s[scene.rows]
        piece = _piece(scene, path, names)
        _place(whole, scene, piece, stamps)
        frames = (told.arm.t_s >= scene.t[0]) & (told.arm.t_s <= scene.t[-1])
        seen = {**piece.joints, "strap": _strap(scene.calibration, piece)}
        for joint, place in seen.items():
            column = JOINTS.index(joint)
            at_frames = interpolate(scene.t, place, told.arm.t_s[frames])
            residual[frames, column] = recording.arm.position[frames, column] - at_frames
    return Recovery(
        method=method,
        t_s=recording.imu.t_s,
        occluded=told.occluded,
        position=whole.position,
        quaternion=whole.quaternion,
        velocity=whole.velocity,
        pose_covariance=whole.pose_covariance,
        velocity_covariance=np.full((len(recording.imu), 3, 3), np.nan),
        joints=whole.joints,
        joint_covariance=whole.joint_covariance,
        gaps=told.gaps,
        calibration=told.calibration,
        gravity_direction=told.gravity_direction,
        clock_offset_s=told.clock_offset_s,
        clock_offset_sigma_s=told.clock_offset_sigma_s,
        arm=told.arm,
        residuals=replace(told.residuals, t_s=told.arm.t_s, residual=residual),
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=tuple(dict.fromkeys((*(note for path in paths for note in path.notes), TOLD, *told.notes))),
        config=told.config,
        figures={name: told.figures[name] for name in TOLD_FIGURES if name in told.figures}
        | (settings or {}),
    )


@dataclass
class _Piece:
    """One path with everything in it; (n, ...) at the scene's times."""

    position: FloatArray
    R_K_A: FloatArray
    velocity: FloatArray
    pose_covariance: FloatArray
    joints: dict[str, FloatArray]
    joint_covariance: dict[str, FloatArray]


class _Whole:
    """The answer at every sample of the recording, nan to begin with."""

    def __init__(self, count: int, names: list[str]) -> None:
        self.position, self.velocity = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
        self.quaternion = np.full((count, 4), np.nan)
        self.pose_covariance = np.full((count, 6, 6), np.nan)
        self.joints = {joint: np.full((count, 3), np.nan) for joint in names}
        self.joint_covariance = {joint: np.full((count, 3, 3), np.nan) for joint in names}


def _piece(scene: Scene, path: Path, names: list[str]) -> _Piece:
    """The path with joints and covariances filled in."""
    count = len(scene.t)
    R = scene.R_K_A if path.R_K_A is None else path.R_K_A
    pose = np.full((count, 6, 6), np.nan)
    if path.covariance is not None:
        pose[:, :3, :3] = path.covariance
    if path.attitude_covariance is not None:
        pose[:, 3:, 3:] = path.attitude_covariance
    if path.covariance is not None and path.attitude_covariance is not None:
        pose[:, :3, 3:] = pose[:, 3:, :3] = 0.0
    joints, covariances = {}, {}
    for joint in names:
        joints[joint], covariances[joint] = _joint(joint, scene, path, R, pose)
    velocity = np.full((count, 3), np.nan) if path.velocity is None else path.velocity
    return _Piece(path.position, R, velocity, pose, joints, covariances)


def _joint(
    joint: str, scene: Scene, path: Path, R: FloatArray, pose: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A joint's position and covariance at the samples."""
    nothing = np.full((len(scene.t), 3, 3), np.nan)
    if joint in path.joints:
        return path.joints[joint], nothing
    if joint == "shoulder":
        return scene.shoulder, nothing
    lever = lever_of(scene.calibration, joint)
    if lever is None:
        return np.full((len(scene.t), 3), np.nan), nothing
    arm = R @ lever
    turning = pose[:, 3:, 3:]
    if path.attitude_covariance is None:  # the scene's orientation, as uncertain as it is said to be
        turning = np.tile(np.eye(3) * scene.attitude_sigma_rad**2, (len(arm), 1, 1))
    covariance = pose[:, :3, :3] + rotate_covariance(skew(arm), turning)
    if joint in scene.calibration.lever_arms:
        sigma = scene.calibration.lever_arms[joint].sigma_m
        covariance = covariance + rotate_covariance(R, np.diag(sigma**2))
    return path.position + arm, covariance


def _strap(calibration: ArmCalibration, piece: _Piece) -> FloatArray:
    lever = lever_of(calibration, "strap")
    return piece.position if lever is None or not lever.any() else piece.position + piece.R_K_A @ lever


def _place(whole: _Whole, scene: Scene, piece: _Piece, stamps: FloatArray) -> None:
    """Write a stretch into its rows, carried from steadied times to the IMU's own stamps."""
    rows, same = scene.rows, np.array_equal(scene.t, stamps)

    def at_stamps(values: FloatArray) -> FloatArray:
        return values if same else interpolate(scene.t, values, stamps)

    whole.position[rows], whole.velocity[rows] = at_stamps(piece.position), at_stamps(piece.velocity)
    whole.quaternion[rows] = _quaternion(scene.t, piece.R_K_A, stamps)
    whole.pose_covariance[rows] = at_stamps(piece.pose_covariance)
    for joint, place in piece.joints.items():
        whole.joints[joint][rows] = at_stamps(place)
        whole.joint_covariance[joint][rows] = at_stamps(piece.joint_covariance[joint])


def _quaternion(t: FloatArray, R: FloatArray, stamps: FloatArray) -> FloatArray:
    """qw, qx, qy, qz (n, 4) at the stamps; nan where there is no orientation."""
    known = np.isfinite(R).all(axis=(1, 2))
    quaternion = np.full((len(stamps), 4), np.nan)
    if not known.any():
        return quaternion
    if np.array_equal(t, stamps):
        quaternion[known] = Rotation.from_matrix(R[known]).as_quat(scalar_first=True)
        return quaternion
    inside = np.clip(stamps, t[known][0], t[known][-1])
    turned = Slerp(t[known], Rotation.from_matrix(R[known]))(inside)
    quaternion[known] = turned.as_quat(scalar_first=True)[known]
    return quaternion
