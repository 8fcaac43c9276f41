"""Joints of cameras without depth: points on rays, of which only what is across the ray was measured.

A pixel with its lens is a direction. The reprojection error of a joint at p, linearised there as Gauss
and Newton do, is linear in the joint: with d = p / |p| its derivative is (I - d d') / |p|, across the ray
through the joint, not across the measured one, and its value that of the measured ray's point at the
joint's distance. So a keypoint is a point whose errors are angles times distance across d, and `along_m`
along it. It is made anew where the joint has moved (`linearised`) until nothing moves: then the gradient
is the reprojection error's own. Weights that are kept from another distance are not: smaller arms seem to
fit better.
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, CameraNumbers, FloatArray
from ..linalg import unit

#: What a keypoint says along its ray, m: nothing, and no direction is free to the solver.
ALONG_M = 100.0
#: The noise of cameras without depth is stated in m at this distance, m: it is an angle.
AT_M = 2.0
#: No joint is nearer to the camera than this, m, and no ray farther from it than the angle of this cosine.
NEAREST_M, LEAST_COSINE = 0.2, 0.5
#: The shoulder's, which no IMU constrains: the elbow's distance alone leaves a second place near the camera.
#: With one camera alone it must not determine the scale.
SHOULDER_ALONG_M, LONE_SHOULDER_ALONG_M = 0.3, 20.0
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


def is_alone(ray_origin_m: FloatArray | None) -> bool:
    """Whether all rays are of one camera: nothing but the arm's size and the IMU shows how far it is away."""
    return ray_origin_m is not None and len(ray_origin_m) == 1 and bool(np.isfinite(ray_origin_m).all())


def of_rays(origin_m: FloatArray | None, count: int) -> BoolArray:
    """Which frames (f,) have no depth."""
    return np.zeros(count, bool) if origin_m is None else np.asarray(np.isfinite(origin_m[:, 0]))


def directions(position: FloatArray, origin_m: FloatArray) -> FloatArray:
    """Unit vectors (.., 3) along the rays; nan of cameras with depth."""
    return unit(position - origin_m)


def across(residual: FloatArray, position: FloatArray, origin_m: FloatArray | None) -> FloatArray:
    """Residuals (f, .., 3) without what lies along the rays; as they are of cameras with depth."""
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


def linearised(
    position: FloatArray, sigma_m: FloatArray, origin_m: FloatArray, predicted: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:  # position (k, 3) m, sigma_m (k,) m, ray (k, 3)
    """Keypoints as points at the distance of where their joints are now."""
    ray = directions(predicted, origin_m)
    distance = np.maximum(np.linalg.norm(predicted - origin_m, axis=1), NEAREST_M)
    measured = directions(position, origin_m)
    cosine = np.maximum(np.sum(measured * ray, axis=1), LEAST_COSINE)
    return origin_m + (distance / cosine)[:, None] * measured, sigma_m * distance / AT_M, ray
