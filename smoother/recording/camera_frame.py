"""Conventions for the axes of a depth camera."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from ..array_types import FloatArray


class CameraFrame(StrEnum):
    """Conventions for the camera's axes."""

    KINECT = "kinect"  # x left, y up, z forward
    OPTICAL = "optical"  # x right, y down, z forward
    ZUP = "zup"  # any frame with z up

    @property
    def down(self) -> FloatArray:
        """Direction of gravity in a camera that stands level, unit vector (3,)."""
        return {
            CameraFrame.KINECT: np.array([0.0, -1.0, 0.0]),
            CameraFrame.OPTICAL: np.array([0.0, 1.0, 0.0]),
            CameraFrame.ZUP: np.array([0.0, 0.0, -1.0]),
        }[self]
