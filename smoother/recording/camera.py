"""Conventions for a depth camera's axes; a further camera that saw the same arm, and where it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ..array_types import FloatArray
from .joint_tracks import JointTracks

#: What the recording's own camera is called beside others.
FIRST_CAMERA = "camera"


class CameraFrame(StrEnum):
    """Conventions for the camera's axes."""

    KINECT = "kinect"  # x left, y up, z forward
    OPTICAL = "optical"  # x right, y down, z forward
    ZUP = "zup"  # any frame with z up

    @property
    def down(self) -> FloatArray:
        """Direction of gravity in a level camera, unit vector (3,)."""
        return {
            CameraFrame.KINECT: np.array([0.0, -1.0, 0.0]),
            CameraFrame.OPTICAL: np.array([0.0, 1.0, 0.0]),
            CameraFrame.ZUP: np.array([0.0, 0.0, -1.0]),
        }[self]


@dataclass(frozen=True)
class CameraPose:
    """Where a camera {C} is in the frame {K} of the recording's first one."""

    R_K_C: FloatArray  # (3, 3): maps a vector from {C} to {K}
    p_K_C_m: FloatArray  # (3,) m: its origin in {K}
    sigma_rad: float  # One standard deviation per axis
    sigma_m: float  # One standard deviation per axis, of the place at which it sees the arm

    def to_first(self, points_C: FloatArray) -> FloatArray:
        """Points (..., 3) m of {C} in {K}."""
        return np.asarray(points_C @ self.R_K_C.T + self.p_K_C_m)


@dataclass(frozen=True)
class Camera:
    """A further camera's joints of the recording's arm, as it saw them."""

    name: str  # In messages and results
    arm: JointTracks  # On its own clock, in its own frame {C}
    camera_frame: CameraFrame | None = None  # The convention of its axes
    gravity_hint: FloatArray | None = None  # (3,): direction of down in {C}, good to some degrees
    pose: CameraPose | None = None  # If that was measured beforehand

    def with_arm(self, arm: JointTracks) -> Camera:
        """The same with other frames."""
        return replace(self, arm=arm)
