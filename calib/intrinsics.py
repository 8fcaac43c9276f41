"""A camera's lens, and the camera in its place: from points to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from smoother.array_types import FloatArray

#: A point nearer to the lens than this has no pixel, m.
NEAREST_M = 0.05


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole with OpenCV's distortion (Brown-Conrady); the centre of the first pixel is (0, 0).

    Attributes
    ----------
    width, height : int, pixels
        Of the images that these hold for.
    fx, fy, cx, cy : float, pixels
        Focal lengths and principal point.
    distortion : tuple of float
        k1, k2, p1, p2, k3; fewer where the rest is zero, empty for none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @property
    def focal_px(self) -> float:
        """Mean focal length."""
        return 0.5 * (self.fx + self.fy)

    @property
    def matrix(self) -> FloatArray:
        """The camera matrix (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def resized(self, width: int, height: int) -> Intrinsics:
        """The same lens for images of another size and the same shape."""
        scale = width / self.width
        numbers = {name: scale * getattr(self, name) for name in ("fx", "fy", "cx", "cy")}
        return replace(self, width=width, height=height, **numbers)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Undistorted rays of pixels (OpenCV's `undistortPointsIter`).

        Parameters
        ----------
        pixels : ndarray, shape (n, 2)

        Returns
        -------
        rays : ndarray, shape (n, 2)
            x/z and y/z in the lens's axes, x right, y down, z forward.
        """
        if not any(self.distortion) or len(pixels) == 0:
            return np.asarray((pixels - [self.cx, self.cy]) / [self.fx, self.fy], dtype=np.float64)
        import cv2

        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        straight = cv2.undistortPointsIter(points, self.matrix, self._terms, np.eye(3), np.eye(3), stop)
        return np.asarray(straight, dtype=np.float64).reshape(-1, 2)

    def pixels(self, points: FloatArray) -> FloatArray:
        """Where points appear (OpenCV's `projectPoints`).

        Parameters
        ----------
        points : ndarray, shape (n, 3), m
            In the lens's axes.

        Returns
        -------
        pixels : ndarray, shape (n, 2)
            nan for a point that is not in front of the camera.
        """
        pixels = np.full((len(points), 2), np.nan)
        front = points[:, 2] > NEAREST_M
        if not any(self.distortion):
            flat = points[front, :2] / points[front, 2:]
            pixels[front] = flat * [self.fx, self.fy] + [self.cx, self.cy]
        elif front.any():
            import cv2

            own = np.ascontiguousarray(points[front], dtype=np.float64).reshape(-1, 1, 3)
            bent, _ = cv2.projectPoints(own, np.zeros(3), np.zeros(3), self.matrix, self._terms)
            pixels[front] = bent.reshape(-1, 2)
        return pixels

    def ray_image(self) -> FloatArray:
        """Undistorted rays (height, width, 2) of all pixels."""
        return _ray_image(self)

    @property
    def _terms(self) -> FloatArray:
        return np.array([*self.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5])


@lru_cache(maxsize=4)
def _ray_image(lens: Intrinsics) -> FloatArray:
    u, v = np.meshgrid(np.arange(lens.width, dtype=float), np.arange(lens.height, dtype=float))
    rays = lens.rays(np.column_stack([u.ravel(), v.ravel()])).reshape(lens.height, lens.width, 2)
    rays.setflags(write=False)
    return rays


@dataclass(frozen=True)
class PlacedCamera:
    """A lens and where it is in {K}.

    Attributes
    ----------
    lens : Intrinsics
        Its own axes {C} are x right, y down, z forward.
    R_C_K : ndarray, shape (3, 3)
        Maps a vector from {K} to {C}.
    t_C_K : ndarray, shape (3,), m
        p_C = R_C_K p_K + t_C_K.
    """

    lens: Intrinsics
    R_C_K: FloatArray = field(default_factory=lambda: np.eye(3))
    t_C_K: FloatArray = field(default_factory=lambda: np.zeros(3))

    @property
    def origin(self) -> FloatArray:
        """Where the rays begin, (3,) m in {K}."""
        return np.asarray(-self.R_C_K.T @ self.t_C_K)

    def pixels(self, points_K: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (n, 2) of points (n, 3), m in {K}, and their z in {C} (n,); nan behind the camera."""
        points = points_K @ self.R_C_K.T + self.t_C_K
        return self.lens.pixels(points), points[:, 2]

    def rays(self, pixels: FloatArray) -> FloatArray:
        """Directions (n, 3) in {K} of pixels (n, 2), with z = 1 in {C}."""
        flat = self.lens.rays(pixels)
        return np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ self.R_C_K
