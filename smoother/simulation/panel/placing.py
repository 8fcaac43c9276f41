"""Where panel, camera, room and mocap frame are, and the camera's lens."""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.intrinsics import Intrinsics

from ...array_types import FloatArray
from ...linalg import unit
from .config import PanelSimulation


class RenderLens(Intrinsics):
    """The lens of the depth and infrared camera; its distortion is computed here, without OpenCV."""

    def to_toml(self) -> dict[str, Any]:
        """Plain values under the names that `intrinsics.toml` has."""
        return asdict(self) | {"distortion": list(self.distortion)}

    def project(self, points_K: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points (N, 3) in {K} in front of the camera (Brown 1971, as in OpenCV)."""
        x, y = (points_K[:, :2] / points_K[:, 2:]).T
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.column_stack([self.fx * xd + self.cx, self.fy * yd + self.cy])

    def all_rays(self) -> FloatArray:
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


#: The whole panel is at least this far inside the image, pixels.
MARGIN_PX = 6.0
#: Height of the floor, the camera at 0, m.
FLOOR_M = -1.1
#: Tries before a range of poses is given up.
_TRIES = 2000


def panel_corners(config: PanelSimulation) -> FloatArray:
    """Corners of the panel, (4, 3) m in {P}, around its rim."""
    (x0, y0), (x1, y1) = config.extent
    return np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]])


def place_panel(
    config: PanelSimulation,
    lens: RenderLens,
    R_W_K: FloatArray,
    rng: np.random.Generator,  # R_W_K (3, 3)
) -> tuple[FloatArray, FloatArray]:  # R_K_P (3, 3), p_K_P (3,) m
    """A pose of the panel above the floor in which the camera sees all of it."""
    corners, rays = panel_corners(config), lens.all_rays()
    middle = corners.mean(axis=0)
    for _ in range(_TRIES):
        distance, tilt, roll = (
            rng.uniform(*r) for r in (config.distance_m, config.tilt_deg, config.roll_deg)
        )
        row, column = rng.integers(lens.height), rng.integers(lens.width)
        ray = unit(np.append(rays[row, column], 1.0))
        R_K_P = facing(ray, np.radians(tilt), rng.uniform(0, 2 * np.pi), np.radians(roll))
        p_K_P = distance * ray - R_K_P @ middle
        seen = corners @ R_K_P.T + p_K_P
        if seen[:, 2].min() > 0.2 and (seen @ R_W_K[2]).min() > FLOOR_M + 0.05:
            pixel = lens.project(seen)
            if (pixel > MARGIN_PX).all() and (
                pixel < np.array([lens.width, lens.height]) - 1 - MARGIN_PX
            ).all():
                return R_K_P, p_K_P
    raise ValueError(
        "the panel does not fit into the image at these distances and tilts; hold it farther away, or take a "
        "smaller panel or a shorter focal length"
    )


def facing(ray: FloatArray, tilt: float, towards: float, roll: float) -> FloatArray:
    """R_K_P of a panel on a ray (unit vector) whose z axis is `tilt` off the way back to the camera."""
    right = unit(np.cross(ray, [0.0, -1.0, 0.0]))
    down = np.cross(ray, right)
    facing_back = np.column_stack([right, -down, -ray])  # z to the camera, x right, y up in the image
    axis = np.array([np.cos(towards), np.sin(towards), 0.0])
    tilted = Rotation.from_matrix(facing_back) * Rotation.from_rotvec(tilt * axis)
    return np.asarray((tilted * Rotation.from_euler("z", roll)).as_matrix())


def place_camera(rng: np.random.Generator) -> FloatArray:
    """R_W_K (3, 3) of a camera on a tripod: any heading, some degrees off level. {W}: z up."""
    level = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # optical axes: z forward is y of {W}
    heading = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    off = Rotation.from_rotvec(np.radians([rng.uniform(-12, 3), 0, 0]))  # about K's x: looks down
    lean = Rotation.from_rotvec(np.radians([0, 0, rng.normal(0, 1.5)]))
    return np.asarray((heading * Rotation.from_matrix(level) * off * lean).as_matrix())


def tilt_camera(R_W_K: FloatArray, most_deg: float, rng: np.random.Generator) -> FloatArray:
    """R_W_K after a turn of the tripod's head: by up to `most_deg` about each of the camera's axes."""
    turn = Rotation.from_rotvec(np.radians(rng.uniform(-most_deg, most_deg, 3)))
    return np.asarray(R_W_K @ turn.as_matrix())


def place_base(rng: np.random.Generator) -> FloatArray:
    """R_K_B (3, 3) of an IMU on top of the camera: any side up, some degrees off."""
    side = Rotation.create_group("O")[int(rng.integers(24))]
    off = Rotation.from_rotvec(np.radians(rng.normal(0, 3, 3)))
    return np.asarray((off * side).as_matrix())


def place_imu(off_deg: float, rng: np.random.Generator) -> FloatArray:
    """R_P_I (3, 3) of an IMU that was lined up with the panel by eye: off by `off_deg` about some axis."""
    axis = unit(rng.normal(size=3))
    return np.asarray(Rotation.from_rotvec(np.radians(off_deg) * axis).as_matrix())


def place_mocap(R_W_K: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """R_K_E (3, 3) and the mocap's origin in {K} (3,), m: on the floor, z up to a degree, any heading."""
    R_W_E = Rotation.from_rotvec(np.radians([rng.normal(0, 0.5), rng.normal(0, 0.5), 0]))
    R_W_E = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)) * R_W_E
    p_W = R_W_K @ np.array([rng.uniform(-1, 1), 0, rng.uniform(1, 3)])
    p_W[2] = FLOOR_M
    return R_W_K.T @ R_W_E.as_matrix(), R_W_K.T @ p_W
