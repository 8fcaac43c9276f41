"""Images of a scene: depth and infrared without error, then as a camera like a Kinect v2 makes them.

Inside a surface a pixel is one ray. Where surfaces meet, and on markers, a pixel is the mean over a fine
grid of rays: an infrared blob is then true to hundredths of a pixel, and a depth on a rim is a mixture, as
a time-of-flight camera sees it (Kolb and Pece, Range Imaging, 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray
from .config import PanelSimulation
from .placing import RenderLens
from .scene import Hits, PanelScene

#: Rays per axis in a pixel where surfaces meet.
FINE = 10
#: A white surface at 1.5 m shows this fraction of the infrared image's full scale.
_DIFFUSE = 0.1
_REFERENCE_M = 1.5


@dataclass(frozen=True)
class IdealImages:
    """What a perfect sensor would measure; all of shape (height, width).

    Attributes
    ----------
    z : ndarray, m
        Depth; inf where nothing reflects.
    spread : ndarray, m
        Standard deviation of the depths that meet in a pixel.
    infrared : ndarray
        In full scales of the sensor; beyond 1 where it saturates.
    cosine : ndarray
        Between normal and ray.
    marker : ndarray
        Share of the pixel that a marker fills.
    """

    z: FloatArray
    spread: FloatArray
    infrared: FloatArray
    cosine: FloatArray
    marker: FloatArray


def render(scene: PanelScene, lens: RenderLens) -> IdealImages:
    """Cast a ray through every pixel, and many through those where surfaces meet."""
    rays = lens.rays()
    hits = scene.cast(rays.reshape(-1, 2))
    z, infrared = hits.z.copy(), _shade(scene, rays.reshape(-1, 2), hits)
    spread, marker = np.zeros(len(z)), hits.marker.astype(float)
    mixed = np.flatnonzero(_mixed(scene, lens, hits))
    inside = _fine_rays(rays, mixed)
    fine = scene.cast(inside.reshape(-1, 2))
    bright = _shade(scene, inside.reshape(-1, 2), fine).reshape(len(mixed), -1)
    infrared[mixed] = bright.mean(axis=1)
    marker[mixed] = fine.marker.reshape(len(mixed), -1).mean(axis=1)
    # What is brighter counts for more in the mixture; a marker's own glare is held down by the sensor.
    weight = np.minimum(bright, 1.0) + 1e-9
    depth = np.minimum(fine.z, 50.0).reshape(len(mixed), -1)
    mean = (weight * depth).sum(axis=1) / weight.sum(axis=1)
    z[mixed] = np.where(mean < 49, mean, np.inf)
    spread[mixed] = np.sqrt((weight * (depth - mean[:, None]) ** 2).sum(axis=1) / weight.sum(axis=1))
    shape = (lens.height, lens.width)
    return IdealImages(*(part.reshape(shape) for part in (z, spread, infrared, hits.cosine, marker)))


def _shade(scene: PanelScene, rays: FloatArray, hits: Hits) -> FloatArray:
    """Infrared brightness (N,) in full scales; the lamp sits at the camera."""
    secant2 = 1 + (rays**2).sum(axis=1)
    fading = (_REFERENCE_M / np.where(np.isfinite(hits.z), hits.z, np.inf)) ** 2 / secant2
    vignette = 1 / secant2
    diffuse = _DIFFUSE * hits.albedo * hits.cosine
    return fading * vignette * np.where(hits.marker, scene.config.marker_gain, diffuse)


def _mixed(scene: PanelScene, lens: RenderLens, hits: Hits) -> BoolArray:
    """Pixels (N,) that may hold more than one surface, or an edge of a marker."""
    import cv2

    shape = (lens.height, lens.width)
    kinds = hits.surface.reshape(shape).astype(np.float32) + 1
    around = np.ones((3, 3), np.uint8)
    edges = cv2.dilate(kinds, around) != cv2.erode(kinds, around)
    size = scene.config.marker_diameter_m
    spots = np.array([*scene.config.markers, *scene.config.extra_markers])
    centres = np.column_stack([spots, np.zeros(len(spots))]) @ scene.R_K_P.T + scene.p_K_P
    near = hits.marker.reshape(shape).astype(np.uint8)
    for (u, v), z in zip(lens.project(centres), centres[:, 2], strict=True):
        reach = int(np.ceil(0.6 * size * max(lens.fx, lens.fy) / z)) + 2
        row, column = round(v), round(u)
        near[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 1
    return np.asarray((edges | (cv2.dilate(near, around) > 0)).ravel())


def _fine_rays(rays: FloatArray, pixels: np.ndarray) -> FloatArray:
    """Rays (n, FINE^2, 2) on a grid in each pixel, by the first derivatives of the lens' rays."""
    width = rays.shape[1]
    row, column = np.divmod(pixels, width)
    by_row, by_column = np.gradient(rays, axis=0), np.gradient(rays, axis=1)
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    v, u = (grid.ravel()[None, :, None] for grid in np.meshgrid(offset, offset, indexing="ij"))
    centre = rays[row, column][:, None, :]
    return np.asarray(centre + v * by_row[row, column][:, None, :] + u * by_column[row, column][:, None, :])


FULL_SCALE = 65535
#: Depths are had from here to there, m.
RANGE_M = (0.4, 4.5)
#: Depths farther apart than this in one pixel make it a rim, m.
_RIM_M = 0.008
_FADES_PX = 1.5  # of the depth error beside a marker
_DARK = 0.0008  # noise of a dark pixel, full scales


def infrared_image(
    ideal: IdealImages, config: PanelSimulation, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """The infrared image: blurred by the lens, clipped at full scale."""
    light = _blurred(ideal.infrared, config.blur_px)
    noise = rng.normal(size=light.shape)
    if config.infrared_noise > 0:
        light = light + noise * (config.infrared_noise * np.minimum(light, 1.0) + _DARK)
    return np.rint(np.clip(light, 0, 1) * FULL_SCALE).astype(np.uint16)


def depth_image(
    ideal: IdealImages, config: PanelSimulation, rng: np.random.Generator
) -> NDArray[np.uint16] | FloatArray:
    """The depth image, mm, 0 where there is none (float where the simulation does not quantise).

    Noise grows with distance squared and with the angle to the surface. Markers have none, since their glare
    saturates every phase image, and pull at the depths around them. Of the pixels on rims some show a depth
    in between, the others are dropped.
    """
    noise, luck = rng.normal(size=ideal.z.shape), rng.random(ideal.z.shape)
    seen = np.isfinite(ideal.z)
    z = np.where(seen, ideal.z, 0.0)
    sigma = config.depth_noise_m * (z / _REFERENCE_M) ** 2 / np.maximum(ideal.cosine, 0.15)
    rim = ideal.spread > _RIM_M
    valid = seen & ~(rim & (luck > config.flying))
    glare = _blurred(ideal.infrared, config.blur_px)
    no_depth, beside = _around_markers(glare, ideal.marker)
    if config.halo_m > 0:
        z = z + config.halo_m * beside
        no_depth |= (beside > 0.6) & (luck < 0.5)
    z = z + sigma * noise + config.depth_offset_m
    valid &= ~no_depth & (z > RANGE_M[0]) & (z < RANGE_M[1])
    millimetres = np.where(valid, z * 1000, 0.0)
    return np.rint(millimetres).astype(np.uint16) if config.quantised else millimetres


def _around_markers(glare: FloatArray, marker: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Pixels without depth, and how near (1 to 0) the others are to a marker."""
    import cv2

    no_depth = (glare >= 1.0) | (marker > 0.02)
    away = cv2.distanceTransform((~no_depth).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return no_depth, np.where(no_depth, 0.0, np.exp(-(away - 1.0) / _FADES_PX))


def _blurred(image: FloatArray, sigma_px: float) -> FloatArray:
    import cv2

    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px)) if sigma_px > 0 else image
