"""Error-free images of a scene: depth, infrared before the sensor clips it, and where surfaces meet.

Inside a surface a pixel is one ray. Where surfaces meet, and on markers, a pixel is the mean over a fine
grid of rays: an infrared blob is then true to hundredths of a pixel, and a depth on a rim is a mixture, as
a time-of-flight camera sees it (Kolb and Pece, Range Imaging, 2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...array_types import BoolArray, FloatArray
from .lens import RenderLens
from .scene import Hits, PanelScene

#: Rays an axis in a pixel where surfaces meet.
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
