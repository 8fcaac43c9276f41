"""The camera's lens: pixels to rays and back (Brown-Conrady, as OpenCV has it)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ...array_types import FloatArray


@dataclass(frozen=True)
class RenderLens:
    """Intrinsics of the depth and infrared camera; the centre of the first pixel is (0, 0).

    Attributes
    ----------
    width, height : int, pixels
    fx, fy, cx, cy : float, pixels
        Focal lengths and principal point.
    distortion : tuple of float
        k1, k2, p1, p2, k3.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    def to_toml(self) -> dict[str, Any]:
        """Plain values under the names that `intrinsics.toml` has."""
        return asdict(self) | {"distortion": list(self.distortion)}

    @property
    def matrix(self) -> FloatArray:
        """The camera matrix (3, 3)."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    def project(self, points_K: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) in {K} in front of the camera (Brown 1971, as in OpenCV)."""
        x, y = (points_K[:, :2] / points_K[:, 2:]).T
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.column_stack([self.fx * xd + self.cx, self.fy * yd + self.cy])

    def rays(self) -> FloatArray:
        """Directions (height, width, 2): x and y of the ray with z = 1 through every pixel's centre."""
        return _rays(self)


@lru_cache(maxsize=4)
def _rays(lens: RenderLens) -> FloatArray:
    """By Newton's method on the distortion; good to 1e-10."""
    u, v = np.meshgrid(np.arange(lens.width, dtype=float), np.arange(lens.height, dtype=float))
    target = np.column_stack([u.ravel(), v.ravel()])
    ray = (target - [lens.cx, lens.cy]) / [lens.fx, lens.fy]
    step = 1e-6
    right, down = np.array([step, 0.0]), np.array([0.0, step])
    for _ in range(20):
        one = np.ones((len(ray), 1))
        at = lens.project(np.hstack([ray, one]))
        miss = target - at
        if np.abs(miss).max() < 1e-9:
            break
        du = (lens.project(np.hstack([ray + right, one])) - at) / step
        dv = (lens.project(np.hstack([ray + down, one])) - at) / step
        jacobian = np.stack([du, dv], axis=2)
        ray = ray + np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    else:
        raise ValueError("this distortion cannot be undone over the whole image; make it smaller")
    rays = ray.reshape(lens.height, lens.width, 2)
    rays.flags.writeable = False
    return rays
