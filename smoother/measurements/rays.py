"""Joints of cameras without depth: points on rays, of which only what is across the ray was measured.

A pixel with its lens is a direction. At depth z the reprojection error of a joint, in radians, is its
distance from the ray over z: linear in the joint for a fixed z. So a keypoint is a point on its ray whose
errors are pixels times depth across the ray and `ALONG_M` along it; which point it is does not matter, and an
error of z changes the weight alone, by its own share.
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, CameraNumbers, FloatArray
from ..linalg import unit

#: What a keypoint says along its ray, m: nothing, and no direction is free to the solver.
ALONG_M = 20.0
#: The shoulder's, which no IMU constrains: the elbow's distance alone leaves a second place near the camera.
SHOULDER_ALONG_M = 0.3
#: Residuals across a ray have two directions of three: their mean square over three axes is this much less.
OF_THREE = 1.5


def origins_of(
    ray_origin_m: FloatArray | None, camera: CameraNumbers | None, count: int
) -> FloatArray | None:
    """Where the rays of frames (f,) begin, (f, 3) m, nan of cameras with depth; None where all have depth."""
    if ray_origin_m is None:
        return None
    numbers = np.zeros(count, int) if camera is None else np.asarray(camera).astype(int)
    return np.asarray(ray_origin_m[numbers])


def of_rays(origin_m: FloatArray | None, count: int) -> BoolArray:
    """Which frames (f,) have no depth."""
    return np.zeros(count, bool) if origin_m is None else np.asarray(np.isfinite(origin_m[:, 0]))


def directions(position: FloatArray, origin_m: FloatArray) -> FloatArray:
    """Unit vectors (.., 3) along the rays; nan of cameras with depth."""
    return unit(position - origin_m)


def across(residual: FloatArray, position: FloatArray, origin_m: FloatArray | None) -> FloatArray:
    """Residuals (f, .., 3) without what lies along the rays; as they are of cameras with depth.

    Parameters
    ----------
    residual, position : ndarray, shape (f, .., 3), m
    origin_m : ndarray, shape (f, 3), m, or None
        From `origins_of`.
    """
    if origin_m is None:
        return residual
    origin = origin_m.reshape(len(origin_m), *([1] * (position.ndim - 2)), 3)
    ray = directions(position, origin)
    without = residual - np.sum(residual * ray, axis=-1, keepdims=True) * ray
    return np.where(np.isfinite(origin), without, residual)


def squashed(ray: FloatArray, sigma_m: FloatArray, along_m: float = ALONG_M) -> FloatArray:
    """Square roots of the information (k, 3, 3), 1/m: 1 / sigma across the ray, 1 / `along_m` along it."""
    along = 1.0 / sigma_m - 1.0 / along_m
    return np.asarray(
        np.eye(3) / sigma_m[:, None, None] - along[:, None, None] * ray[:, :, None] * ray[:, None, :]
    )
