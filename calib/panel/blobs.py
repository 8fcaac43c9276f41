"""Bright spots in the infrared image, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import FloatArray
from smoother.linalg import robust_sigma

from ..intrinsics import Intrinsics

#: Brightness over the surroundings from which a spot counts, as fractions of the brightest; tried in turn.
LEVELS = (0.5, 0.25, 0.12, 0.06)
#: A spot is at least so many times as bright as its surroundings.
CONTRAST = 1.35
#: Not more spots than this are looked at, the strongest ones.
MOST = 12
#: A spot is no longer than so many times its width, and no larger than this share of the image.
ELONGATION, LARGEST = 3.5, 0.004
#: Window of the median that the surroundings are taken from, as a share of the image's width.
SURROUNDINGS = 0.08
#: The centroid is taken over what is brighter than this share of the spot's height.
FOOT = 0.15
#: A centroid is not known better than this, pixels: shape of the spot, blur, the lens' model.
FLOOR_PX = 0.04


@dataclass(frozen=True)
class Blobs:
    """Bright spots, the strongest first.

    Attributes
    ----------
    pixels : ndarray, shape (N, 2)
        Centroids.
    rays : ndarray, shape (N, 2)
        Undistorted, x/z and y/z.
    sigmas_px : ndarray, shape (N,), pixels
        Of a centroid, an axis.
    radii_px : ndarray, shape (N,), pixels
        Of a disc of the same area.
    heights : ndarray, shape (N,)
        Peak over the surroundings.
    """

    pixels: FloatArray
    rays: FloatArray
    sigmas_px: FloatArray
    radii_px: FloatArray
    heights: FloatArray

    def __len__(self) -> int:
        return len(self.pixels)


def find_blobs(infrared: FloatArray, lens: Intrinsics) -> Iterator[Blobs]:
    """Bright, compact spots at falling thresholds; a level that adds none is passed over.

    Parameters
    ----------
    infrared : ndarray, shape (height, width)
        In any unit.
    lens : Intrinsics
        For the undistorted rays.

    Yields
    ------
    The spots of a level, at most `MOST`.
    """
    surroundings = _surroundings(infrared)
    over = infrared - surroundings
    noise = float(robust_sigma(over))
    brightest = float(np.percentile(over, 100 * (1 - 5 / over.size)))
    count = -1
    for level in LEVELS:
        threshold = np.maximum(np.maximum(level * brightest, 8 * noise), (CONTRAST - 1) * surroundings)
        found = _spots(infrared, over > threshold, lens)
        if len(found) > count:
            count = len(found)
            yield found


def _surroundings(infrared: FloatArray) -> FloatArray:
    """Running median; taken on a logarithmic scale of 256 steps, which is all that OpenCV's fast one has."""
    import cv2

    low = max(float(np.percentile(infrared, 1)), 1e-4 * float(infrared.max()), 1e-12)
    span = np.log(max(float(infrared.max()) / low, 1.0 + 1e-9))
    steps = np.clip(np.log(np.maximum(infrared, low) / low) / span * 255, 0, 255)
    window = 2 * round(SURROUNDINGS * infrared.shape[1] / 2) + 1
    median = cv2.medianBlur(steps.astype(np.uint8), window)
    return low * np.exp(median.astype(np.float64) / 255 * span)


def _spots(infrared: FloatArray, mask: NDArray[np.bool_], lens: Intrinsics) -> Blobs:
    import cv2

    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    rows = []
    for index in np.argsort(-stats[1:count, cv2.CC_STAT_AREA])[: 20 * MOST] + 1:
        if stats[index, cv2.CC_STAT_AREA] > LARGEST * mask.size:
            continue
        row = _centroid(infrared, stats[index], labels, int(index))
        if row is not None:
            rows.append(row)
    rows = sorted(rows, key=lambda row: -row[4])[:MOST]
    table = np.array(rows).reshape(-1, 5)
    pixels = table[:, :2]
    return Blobs(pixels, lens.rays(pixels), table[:, 2], table[:, 3], table[:, 4])


def _centroid(
    infrared: FloatArray, stats: NDArray, labels: NDArray, index: int
) -> tuple[float, float, float, float, float] | None:
    """x, y, sigma, radius (pixels) and height; None where it is no compact spot inside the image."""
    left, top, width, height, area = (int(value) for value in stats[:5])
    margin = 3 + max(width, height) // 2
    x0, y0 = left - margin, top - margin
    x1, y1 = left + width + margin, top + height + margin
    if left <= 0 or top <= 0 or left + width >= infrared.shape[1] or top + height >= infrared.shape[0]:
        return None  # cut off by the rim: its centre is not known
    x0, y0, x1, y1 = max(x0, 0), max(y0, 0), min(x1, infrared.shape[1]), min(y1, infrared.shape[0])
    window, own = infrared[y0:y1, x0:x1], labels[y0:y1, x0:x1]
    v, u = np.mgrid[y0:y1, x0:x1].astype(np.float64)
    inside = own == index
    centre = np.array([u[inside].mean(), v[inside].mean()])
    reach = max(width, height) / 2 + 2.5
    near = (u - centre[0]) ** 2 + (v - centre[1]) ** 2 <= reach**2
    near &= (own == index) | (own == 0)
    ring = ~near & (own == 0)
    foot = float(np.median(window[ring])) if ring.sum() >= 8 else float(window.min())
    peak = float(window[inside].max())
    over = np.where(near, window - foot - FOOT * (peak - foot), 0.0)
    weight = np.maximum(over, 0.0)
    total = weight.sum()
    x, y = (weight * u).sum() / total, (weight * v).sum() / total
    spread = np.array(
        [
            [(weight * (u - x) ** 2).sum(), (weight * (u - x) * (v - y)).sum()],
            [(weight * (u - x) * (v - y)).sum(), (weight * (v - y) ** 2).sum()],
        ]
    )
    low, high = np.linalg.eigvalsh(spread / total + np.eye(2) / 12)
    if high > ELONGATION**2 * low:
        return None
    # noise of a pixel about 3 % of its value, on the spot's flanks, where the pixel is not saturated
    flank = (weight > 0) & (window < 0.98 * peak)
    lever = (u - x) ** 2 + (v - y) ** 2
    noise = 0.03 * np.sqrt(float((window[flank] ** 2 * lever[flank]).sum()) / 2) / total
    sigma = float(np.hypot(FLOOR_PX, noise))
    radius = float(np.sqrt(max(area, (weight > 0).sum()) / np.pi))
    return float(x), float(y), sigma, radius, peak - foot
