"""What several baselines do with the camera's samples: interpolate them, and find where the forearm lies."""

from __future__ import annotations

import numpy as np

from ..linalg import interpolate
from ..recording import FloatArray
from .scene import Scene


def between(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation (n, 3) between the finite of the values (f, 3), held beyond the ends.

    nan where no value is finite.
    """
    stated = np.isfinite(values).all(axis=1)
    if not stated.any():
        return np.full((len(at), 3), np.nan)
    return interpolate(t[stated], values[stated], at)


def visible_point(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Times (v,) and the IMU's positions (v, 3) m at the frames that see the forearm."""
    return scene.frame_t[scene.visible], scene.point[scene.visible]
