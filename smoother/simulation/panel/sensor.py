"""What a camera like a Kinect v2 makes of ideal images: blur, saturation, noise, flying pixels, no depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from .config import PanelSimulation
from .render import IdealImages

FULL_SCALE = 65535
#: Depths are had from here to there, m.
RANGE_M = (0.4, 4.5)
_REFERENCE_M = 1.5
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
