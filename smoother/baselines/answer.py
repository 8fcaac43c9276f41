"""A baseline's `Recovery`: the paths of all scenes together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..array_types import FloatArray
from ..linalg import interpolate, rotate_covariance, skew
from ..measurements.alignment import lever_of
from ..recording import JOINTS, Recording
from ..result import Estimates, Recovery
from .scene import Path, Scene

#: What of the graph's figures a baseline gets, and its result repeats.
GRAPH_ESTIMATES = (
    "camera_sigma_m",
    "camera_effective_sigma_m",
    "joint_bias_m",
    "joint_bias_sigma_m",
    "trusted",
    "reasons",
    "cautions",
    "cause",
    "remedies",
    "untrusted",
    "pairing",
)
#: The note of every baseline's result.
GRAPH_NOTE = (
    "calibration, clock, gravity and what is occluded are the graph's, which every method to compare with is"
    " told; only the path between is this method's"
)


def recovery_of(
    recording: Recording,
    graph: Recovery,
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
    recording : Recording
        One arm and its forearm IMU.
    graph : Recovery
        The graph's recovery of this very recording, see `scenes_of`.
    scenes : sequence of Scene
        The segments, see `scenes_of`.
    paths : sequence of Path
        The baseline's answers, one for each scene.
    method : str
        The baseline's name.
    settings : dict, optional
        The baseline's options by name; they are kept in the result's figures.

    Returns
    -------
    recovery : Recovery
    """
    assert graph.residuals is not None
    n, frames = len(recording.imu), len(graph.arm)
    names = [joint for joint in JOINTS if joint in recording.arm.present and joint != "strap"]
    recovery = replace(
        graph,
        method=method,
        t_s=recording.imu.t_s,
        position=np.full((n, 3), np.nan),
        quaternion=np.full((n, 4), np.nan),
        velocity=np.full((n, 3), np.nan),
        pose_covariance=np.full((n, 6, 6), np.nan),
        velocity_covariance=np.full((n, 3, 3), np.nan),
        joints={joint: np.full((n, 3), np.nan) for joint in names},
        joint_covariance={joint: np.full((n, 3, 3), np.nan) for joint in names},
        residuals=replace(
            graph.residuals, t_s=graph.arm.t_s, residual=np.full((frames, len(JOINTS), 3), np.nan)
        ),
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=tuple(
            dict.fromkeys((*(note for path in paths for note in path.notes), GRAPH_NOTE, *graph.notes))
        ),
        estimates=Estimates(
            **{name: getattr(graph.estimates, name) for name in GRAPH_ESTIMATES}, further=settings or {}
        ),
    )
    for scene, path in zip(scenes, paths, strict=True):
        _write(recovery, recording, scene, path)
    return recovery


def _write(recovery: Recovery, recording: Recording, scene: Scene, path: Path) -> None:
    """Write a scene's path into its rows, from the scene's even times to the IMU's own stamps."""
    assert recovery.residuals is not None
    rows, frame_t = scene.rows, recovery.arm.t_s
    stamps = recovery.t_s[rows]
    same = np.array_equal(scene.t, stamps)

    def at_stamps(values: FloatArray) -> FloatArray:
        return values if same else interpolate(scene.t, values, stamps)

    R = scene.R_K_A if path.R_K_A is None else path.R_K_A
    pose_covariance = _pose_covariance(scene, path)
    recovery.position[rows] = at_stamps(path.position)
    recovery.quaternion[rows] = _quaternion(scene.t, R, stamps)
    recovery.pose_covariance[rows] = at_stamps(pose_covariance)
    if path.velocity is not None:
        recovery.velocity[rows] = at_stamps(path.velocity)
    joints = {"strap": _strap(scene, path, R)}
    for joint in recovery.joints:
        joints[joint], covariance = _joint(joint, scene, path, R, pose_covariance)
        recovery.joints[joint][rows] = at_stamps(joints[joint])
        recovery.joint_covariance[joint][rows] = at_stamps(covariance)
    frames = (frame_t >= scene.t[0]) & (frame_t <= scene.t[-1])
    for joint, position in joints.items():
        column = JOINTS.index(joint)
        at_frames = interpolate(scene.t, position, frame_t[frames])
        recovery.residuals.residual[frames, column] = recording.arm.position[frames, column] - at_frames


def _pose_covariance(scene: Scene, path: Path) -> FloatArray:
    """(n, 6, 6) of position and orientation, independent of each other; nan where the path states none."""
    covariance = np.full((len(scene.t), 6, 6), np.nan)
    if path.covariance is not None:
        covariance[:, :3, :3] = path.covariance
    if path.attitude_covariance is not None:
        covariance[:, 3:, 3:] = path.attitude_covariance
    if path.covariance is not None and path.attitude_covariance is not None:
        covariance[:, :3, 3:] = covariance[:, 3:, :3] = 0.0
    return covariance


def _joint(
    joint: str, scene: Scene, path: Path, R: FloatArray, pose_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A joint's position (n, 3) and covariance (n, 3, 3) at the scene's times."""
    unknown = np.full((len(scene.t), 3, 3), np.nan)
    if joint in path.joints:
        return path.joints[joint], unknown
    if joint == "shoulder":
        return scene.shoulder, unknown
    lever = lever_of(scene.calibration, joint)
    if lever is None:
        return unknown[:, 0], unknown
    arm = R @ lever
    attitude_covariance = pose_covariance[:, 3:, 3:]
    if path.attitude_covariance is None:  # the scene's orientation, with the sigma that the scene states
        attitude_covariance = np.tile(np.eye(3) * scene.attitude_sigma_rad**2, (len(arm), 1, 1))
    covariance = pose_covariance[:, :3, :3] + rotate_covariance(skew(arm), attitude_covariance)
    if joint in scene.calibration.lever_arms:
        sigma = scene.calibration.lever_arms[joint].sigma_m
        covariance = covariance + rotate_covariance(R, np.diag(sigma**2))
    return path.position + arm, covariance


def _strap(scene: Scene, path: Path, R: FloatArray) -> FloatArray:
    """The strap's position (n, 3), also where a path without orientation has the IMU's position alone."""
    lever = lever_of(scene.calibration, "strap")
    return path.position if lever is None or not lever.any() else path.position + R @ lever


def _quaternion(t: FloatArray, R: FloatArray, stamps: FloatArray) -> FloatArray:
    """qw, qx, qy, qz (n, 4) at the stamps; nan where there is no orientation."""
    known = np.isfinite(R).all(axis=(1, 2))
    quaternion = np.full((len(stamps), 4), np.nan)
    if not known.any():
        return quaternion
    rotation = Rotation.from_matrix(R[known])
    if not np.array_equal(t, stamps):
        rotation = Slerp(t[known], rotation)(np.clip(stamps[known], t[known][0], t[known][-1]))
    quaternion[known] = rotation.as_quat(scalar_first=True)
    return quaternion
