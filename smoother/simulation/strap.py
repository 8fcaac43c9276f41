"""Colour and depth images of a forearm with a dark strap, beside the arm's recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import Intrinsics, PlacedCamera

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from .arm import SimulatedArm

#: Brightness of skin, strap and wall.
SKIN, STRAP, WALL = 170.0, 25.0, 110.0
WALL_M = 4.0
#: Light falls from the camera and a little from above; the rest is ambient.
AMBIENT = 0.45


@dataclass(frozen=True)
class Arm:
    """A forearm (a capsule) with its strap, in {K}."""

    elbow: FloatArray  # (3,) m: ends of its core
    wrist: FloatArray
    radius: float = 0.035  # m: of the arm
    strap: float | None = 0.2  # m: distance of the strap's middle from the elbow along the arm
    strap_width: float = 0.03  # m: along the arm

    @property
    def y(self) -> FloatArray:
        """Unit vector (3,) from elbow to wrist."""
        return unit(self.wrist - self.elbow)

    @property
    def strap_core(self) -> FloatArray:
        """(3,) the arm's core under the strap, m in {K}."""
        assert self.strap is not None
        return np.asarray(self.elbow + self.strap * self.y)


#: Errors of the images of a good camera in a lit room: sigma of a pixel's brightness, of a depth at 2 m (it
#: grows with distance squared), of the lens' blur in pixels; share of the strap's pixels without depth.
BRIGHTNESS, DEPTH_M, BLUR_PX, STRAP_HOLES = 4.0, 0.003, 0.7, 0.7
#: Distance along rays, inf where nothing is met, brightness, and where there is no depth, (n,) each.
Met = tuple[FloatArray, FloatArray, BoolArray]
#: What rays (n, 3) from a point meet of something.
Surface = Callable[[FloatArray, FloatArray], Met]


def render(
    arm: Arm, camera: PlacedCamera, rng: np.random.Generator | None = None, *others: Surface
) -> tuple[NDArray[np.uint8], FloatArray]:  # grey (height, width), z (height, width) m
    """Images of the arm and what else is there; depth fails on most of a black strap, and beside glare."""
    import cv2

    column, row = np.meshgrid(np.arange(camera.lens.width), np.arange(camera.lens.height))
    origin, rays = camera.origin, camera.rays(np.stack([column.ravel(), row.ravel()], axis=1).astype(float))
    grey, z = np.full(len(rays), WALL), np.full(len(rays), WALL_M)
    no_depth = np.zeros(len(rays), dtype=bool)
    surfaces: list[Surface] = [partial(_capsule, arm), *others]
    for surface in surfaces:
        reach, shade, blind = surface(origin, rays)
        closer = reach < z
        z[closer], grey[closer], no_depth[closer] = reach[closer], shade[closer], blind[closer]
    shape = (camera.lens.height, camera.lens.width)
    grey, z, no_depth = grey.reshape(shape), z.reshape(shape), no_depth.reshape(shape)
    if rng is not None:
        grey = cv2.GaussianBlur(grey, (0, 0), BLUR_PX)
        grey = grey + rng.normal(0, BRIGHTNESS, shape)
        z = z + rng.normal(0, DEPTH_M, shape) * (z / 2.0) ** 2
        rim = cv2.dilate((grey >= 250).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        no_depth = (no_depth & (rng.random(shape) < STRAP_HOLES)) | rim
        z = np.rint(1000 * z) / 1000  # depth images count millimetres
    return np.clip(grey, 0, 255).astype(np.uint8), np.where(no_depth, np.nan, z)


def _capsule(arm: Arm, origin: FloatArray, rays: FloatArray) -> Met:
    """Depth, brightness and blindness of the arm along rays (n, 3): a cylinder with round ends."""
    y, length = arm.y, float(np.linalg.norm(arm.wrist - arm.elbow))
    start = origin - arm.elbow
    flat, base = rays - (rays @ y)[:, None] * y, start - (start @ y) * y
    a, b = (flat**2).sum(axis=1), flat @ base
    reach = first_met(a, b, float(base @ base) - arm.radius**2)
    along = start @ y + reach * (rays @ y)
    reach = np.where((along >= 0) & (along <= length), reach, np.inf)
    for end in (arm.elbow, arm.wrist):
        off = origin - end
        cap = first_met((rays**2).sum(axis=1), rays @ off, float(off @ off) - arm.radius**2)
        reach = np.minimum(reach, cap)
    met = np.isfinite(reach)
    points = origin + np.where(met, reach, 0.0)[:, None] * rays
    along = (points - arm.elbow) @ y
    normal = points - arm.elbow - np.clip(along, 0, length)[:, None] * y
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    light = -np.einsum("ni,ni->n", normal, unit(rays))
    colour, blind = np.full(len(rays), SKIN), np.zeros(len(rays), dtype=bool)
    if arm.strap is not None:
        blind = np.abs(along - arm.strap) < 0.5 * arm.strap_width
        colour[blind] = STRAP
    return reach, colour * (AMBIENT + (1 - AMBIENT) * np.clip(light, 0, 1)), blind & met


def first_met(a: FloatArray, b: FloatArray, c: float) -> FloatArray:
    """Smaller root of a t^2 + 2 b t + c = 0; inf where there is none before the camera."""
    square = b**2 - a * c
    with np.errstate(invalid="ignore", divide="ignore"):
        reach = (-b - np.sqrt(square)) / a
    return np.where((square > 0) & (reach > 0), reach, np.inf)


#: The skeleton's axes are the Kinect's: x left, y up; images have x right, y down.
_KINECT = np.diag([-1.0, -1.0, 1.0])
#: The colour camera is beside the depth camera, m along x.
BASELINE_M = 0.05
COLOUR = PlacedCamera(
    Intrinsics(480, 270, 400.0, 400.0, 240.0, 135.0), _KINECT, np.array([BASELINE_M, 0.0, 0.0])
)
DEPTH = PlacedCamera(Intrinsics(320, 288, 260.0, 260.0, 160.0, 144.0), _KINECT)
#: The depth image follows the colour image after this, s.
DEPTH_LATER_S = 0.002


@dataclass(frozen=True)
class StrapView:
    """A colour image and the depth image after it."""

    t_s: float  # Of the colour image, on the camera's clock
    grey: NDArray[np.uint8]  # (height, width): brightness
    depth_mm: NDArray[np.uint16]  # (height, width) mm: 0 where there is none


def strap_images(
    simulated: SimulatedArm,
    times: FloatArray,  # (n,) s
    seed: int = 0,
) -> Iterator[StrapView]:
    """Render the arm at some of the camera's times, the strap where the IMU is."""
    rng, truth, measures = np.random.default_rng(seed), simulated.recording.truth, simulated.parameters
    assert truth is not None
    radius_m = strap_radius_m(simulated)
    for t in times.tolist():
        k = int(np.argmin(np.abs(truth.t_s - t)))
        elbow, wrist = truth.joints["elbow"][k], truth.joints["wrist"][k]
        arm = Arm(elbow, wrist, radius_m, measures["forearm_m"] - measures["strap_to_wrist_m"])
        grey, _ = render(arm, COLOUR, rng)
        _, z = render(arm, DEPTH, rng)
        yield StrapView(t, grey, np.nan_to_num(np.rint(1000 * z)).astype(np.uint16))


def strap_radius_m(simulated: SimulatedArm) -> float:
    """From the forearm's core to the IMU, m."""
    elbow, wrist = (simulated.calibration.lever_arms[joint].position_m for joint in ("elbow", "wrist"))
    y = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    return float(np.linalg.norm(elbow - (elbow @ y) * y))
