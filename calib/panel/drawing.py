"""What was detected, drawn on the images."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import FloatArray

from .blobs import Blobs

#: Pictures are enlarged to at least this width, pixels.
LEAST_WIDTH = 1024
#: OpenCV's order: blue, green, red.
SPOT, MARKER, TEXT = (0, 170, 255), (120, 220, 60), (255, 255, 255)


def drawn_spots(infrared: FloatArray, blobs: Blobs, markers: tuple[int, ...] = ()) -> bytes:
    """PNG of the infrared image with every bright spot ringed, the panel's markers numbered from 1.

    Parameters
    ----------
    infrared : ndarray, shape (height, width)
        In any unit.
    blobs : Blobs
        All bright spots.
    markers : tuple of int
        Which of them are the panel's, in its order; empty where they could not be told.

    Returns
    -------
    bytes
    """
    import cv2

    factor = max(1, -(-LEAST_WIDTH // infrared.shape[1]))
    image = cv2.resize(grey(infrared), None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for index, (pixel, radius) in enumerate(zip(blobs.pixels, blobs.radii_px, strict=True)):
        # the centre of pixel (0, 0) lies in the middle of its enlarged square
        x, y = (factor * (pixel + 0.5) - 0.5).tolist()
        known = index in markers
        colour = MARKER if known else SPOT
        ring = round(factor * (radius + 3))
        cv2.circle(picture, (round(x), round(y)), ring, colour, 2, cv2.LINE_AA)
        cv2.drawMarker(picture, (round(x), round(y)), colour, cv2.MARKER_CROSS, 4 * factor, 1)
        label = f"marker {markers.index(index) + 1}" if known else f"spot {index + 1}" if not markers else ""
        _write(picture, label, (round(x) + ring + 3, round(y) - ring), factor)
    _, packed = cv2.imencode(".png", picture)
    return bytes(packed.tobytes())


def drawn_depth(
    depth_m: FloatArray, pixels: FloatArray, along_x: NDArray, along_y: NDArray, inliers: NDArray
) -> bytes:
    """PNG of the depth about the panel with the pixels that took part coloured by group."""
    import cv2

    near, far = np.nanpercentile(depth_m[pixels[:, 1].astype(int), pixels[:, 0].astype(int)], [2, 98])
    low, high = near - 0.3, far + 0.6
    shade = np.where(np.isfinite(depth_m), np.clip((high - depth_m) / (high - low), 0, 1), 0)
    picture = cv2.cvtColor((40 + 160 * shade).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    picture[~np.isfinite(depth_m)] = 0
    at = pixels.astype(int)
    for chosen, colour in (
        (inliers, (178, 114, 0)),
        (inliers & along_x, (0, 94, 213)),
        (inliers & along_y, (115, 158, 0)),
        (~inliers, (60, 60, 230)),
    ):
        rows = at[chosen]
        picture[rows[:, 1], rows[:, 0]] = (
            0.5 * picture[rows[:, 1], rows[:, 0]] + 0.5 * np.array(colour)
        ).astype(np.uint8)
    factor = max(1, -(-LEAST_WIDTH // depth_m.shape[1]))
    large = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    _, packed = cv2.imencode(".png", large)
    return bytes(packed.tobytes())


def grey(infrared: FloatArray) -> NDArray[np.uint8]:
    """An infrared image in 256 shades, so that both the room and the spots are to be seen."""
    top = max(float(np.percentile(infrared, 98)) * 4, 1e-9)
    return (255 * np.clip(infrared / top, 0, 1) ** 0.6).astype(np.uint8)


def _write(picture: NDArray, text: str, at: tuple[int, int], factor: int) -> None:
    import cv2

    if text:
        size = 0.25 * max(factor, 2)
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, TEXT, 1, cv2.LINE_AA)
