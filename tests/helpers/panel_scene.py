"""A panel by hand: rays, spots and depth without a renderer, so that the truth is exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from calib.images import Blobs, Panel, Plane, fit_plane, on_plane
from calib.intrinsics import Intrinsics

LENS = Intrinsics(512, 424, 365.0, 366.0, 254.0, 205.0)
PANEL = Panel(
    np.array([[0.0, 0.0], [0.2, 0.0], [0.5, 0.0], [0.0, 0.35]]), np.array([[-0.05, -0.05], [0.55, 0.40]])
)


@dataclass(frozen=True)
class Held:
    """A pose of the panel in {K}."""

    R: np.ndarray
    origin: np.ndarray

    @property
    def theta(self) -> np.ndarray:
        """Of the plane theta . p = 1."""
        normal = self.R[:, 2]
        return normal / (normal @ self.origin)

    def points(self, xy: np.ndarray) -> np.ndarray:
        """Panel points (n, 2) in {K}."""
        return self.origin + np.asarray(xy) @ self.R[:, :2].T

    def depth(self) -> np.ndarray:
        """(height, width) depth of the plane on all pixels, m."""
        return on_plane(self.theta, LENS.ray_image())[..., 2]


def held(roll_deg: float = 0.0, tilt_deg: float = 0.0, tilt_to_deg: float = 0.0, z: float = 1.5) -> Held:
    """The panel facing the camera, its middle on the optical axis, turned and tilted."""
    facing = np.diag([1.0, -1.0, -1.0])
    axis = [np.cos(np.radians(tilt_to_deg)), np.sin(np.radians(tilt_to_deg)), 0.0]
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * np.array(axis)).as_matrix()
    R = tilt @ Rotation.from_euler("z", roll_deg, degrees=True).as_matrix() @ facing
    return Held(R, np.array([0, 0, z]) - R[:, :2] @ PANEL.extent_P.mean(axis=0))


def blobs_of(points_K: np.ndarray, sigma_px: float = 0.04) -> Blobs:
    """Bright spots at points (n, 3)."""
    pixels, count = LENS.pixels(points_K), len(points_K)
    return Blobs(pixels, LENS.rays(pixels), np.full(count, sigma_px), np.full(count, 2.0))


def seen_plane(pose: Held, rng: np.random.Generator, noise_m: float = 0.0015, offset_m: float = 0.0) -> Plane:
    """A plane fitted to noisy depth on every fourth pixel of the panel."""
    v, u = (part.ravel() for part in np.mgrid[100:320:4, 150:360:4])
    rays = LENS.ray_image()[v, u]
    depth = on_plane(pose.theta, rays)[:, 2] + offset_m + noise_m * rng.normal(size=len(u))
    return fit_plane(np.column_stack([u, v]).astype(float), rays, depth)
