"""A camera's lens and place: from {K} to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smoother.recording import FloatArray


@dataclass(frozen=True)
class Lens:
    """A pinhole with OpenCV's distortion; its own axes {C} are x right, y down, z forward.

    Attributes
    ----------
    fx, fy, cx, cy : pixels.
    width, height : of the images that these hold for.
    distortion : (k,) OpenCV's coefficients k1, k2, p1, p2, k3 ..; empty for none.
    R_C_K, t_C_K : p_C = R_C_K p_K + t_C_K, (3, 3) and (3,) m.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: FloatArray = field(default_factory=lambda: np.zeros(0))
    R_C_K: FloatArray = field(default_factory=lambda: np.eye(3))
    t_C_K: FloatArray = field(default_factory=lambda: np.zeros(3))

    def _matrix(self) -> FloatArray:
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), m in {K}, and their z in {C} (n,); nan behind the camera."""
        points = points_K @ self.R_C_K.T + self.t_C_K
        z = points[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(z[:, None] > 0.05, points[:, :2] / z[:, None], np.nan)
        if np.any(self.distortion):
            import cv2

            good = np.isfinite(flat).all(axis=1)
            if good.any():
                own = points[good]
                bent, _ = cv2.projectPoints(own, np.zeros(3), np.zeros(3), self._matrix(), self.distortion)
                out = np.full((len(points), 2), np.nan)
                out[good] = bent.reshape(-1, 2)
                return out, z
        return flat * [self.fx, self.fy] + [self.cx, self.cy], z

    def rays(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origin (3,) of the rays in {K}, and their directions (n, 3) with z = 1 in {C}."""
        flat = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        if np.any(self.distortion):
            import cv2

            flat[:] = cv2.undistortPoints(
                pixels.reshape(-1, 1, 2).astype(float), self._matrix(), self.distortion
            ).reshape(-1, 2)
        directions = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return -self.R_C_K.T @ self.t_C_K, directions @ self.R_C_K


@dataclass(frozen=True)
class Depth:
    """A depth image: z of every pixel in the lens's own axes, m; nan where there is none."""

    z_m: NDArray[np.float64]
    lens: Lens

    def at(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the image has where points (n, 3) of {K} fall, and the points' own z, m (nan outside)."""
        pixels, z = self.lens.pixels(points_K)
        inside = np.isfinite(pixels).all(axis=1)
        column = np.where(inside, np.rint(np.nan_to_num(pixels[:, 0])), -1).astype(np.int64)
        row = np.where(inside, np.rint(np.nan_to_num(pixels[:, 1])), -1).astype(np.int64)
        inside &= (column >= 0) & (row >= 0) & (column < self.z_m.shape[1]) & (row < self.z_m.shape[0])
        seen = np.full(len(points_K), np.nan)
        seen[inside] = self.z_m[row[inside], column[inside]]
        return seen, z
