"""Simulated cameras without depth: where a pose network sees the joints of an arm in the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..recording import CameraFrame, CameraPose, JointState, JointTracks
from ..rotation import Rotation
from .camera import Footage, correlated_noise
from .config import ArmSimulation

#: Pixels of the image, and the focal length.
WIDTH, HEIGHT, FOCAL_PX = 1280, 720, 920.0
#: How well the place of a calibrated camera is known, degrees and m per axis.
CALIBRATED_DEG, CALIBRATED_M = 0.2, 0.005


def is_rgb(config: ArmSimulation, first: bool) -> bool:
    """Whether the first camera, or the further ones, see no depth."""
    return config.rgb == "all" or config.rgb == ("first" if first else "further")


def depth_free(config: ArmSimulation) -> ArmSimulation:
    """The errors of a camera without depth: the joints' constant ones alone, in space."""
    nothing = {"noise_m": 0.0, "noise_depth_m": 0.0, "noise_correlated_m": 0.0, "joint_slow_m": ()}
    return config.model_copy(update=nothing)


def optical_from(frame: CameraFrame) -> FloatArray:
    """Turns vectors of a camera's axes into x right, y down, z forward, (3, 3)."""
    return np.diag([-1.0, -1.0, 1.0]) if frame is CameraFrame.KINECT else np.eye(3)


def photograph(footage: Footage, config: ArmSimulation, rng: np.random.Generator) -> None:
    """Positions become points of their rays a metre in front of the camera, with the network's pixel errors.

    Half of the errors' variance has a memory where the preset's errors have one; what lies outside the image
    is not tracked.
    """
    points = footage.position @ optical_from(config.camera_frame).T
    frames, joints, _ = points.shape
    sigma = config.rgb_noise_px
    slow = sigma / np.sqrt(2.0) if config.noise_correlated_m else 0.0
    noise = np.sqrt(sigma**2 - slow**2) * rng.normal(size=(frames, joints, 2))
    noise += correlated_noise(
        frames, 2 * joints, slow, config.noise_correlated_s, 1.0 / config.frame_rate_hz, rng
    ).reshape(noise.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = FOCAL_PX * points[..., :2] / points[..., 2:] + noise
        inside = (np.abs(pixels) < 0.5 * np.array([WIDTH, HEIGHT])).all(axis=2) & (points[..., 2] > 0.1)
    footage.state[~inside] = JointState.NOT_TRACKED
    forwards = np.where(np.isfinite(pixels).all(axis=2), 1.0, np.nan)
    footage.position = np.concatenate([pixels / FOCAL_PX, forwards[..., None]], axis=2)


def with_pixels(tracks: JointTracks) -> JointTracks:
    """The tracks of a photographed footage."""
    return replace(tracks, pixel_rad=1.0 / FOCAL_PX)


def calibrated(R_K_C: FloatArray, p_K_C_m: FloatArray, rng: np.random.Generator) -> CameraPose:
    """A camera's place by a calibration, with its errors."""
    sigma_rad = float(np.radians(CALIBRATED_DEG))
    turn = Rotation.from_rotvec(sigma_rad * rng.normal(size=3)).as_matrix()
    return CameraPose(R_K_C @ turn, p_K_C_m + CALIBRATED_M * rng.normal(size=3), sigma_rad, CALIBRATED_M)
