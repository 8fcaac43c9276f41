"""Depth and infrared image of one moment: unpacked, with their bright spots, drawn with what was seen."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma
from smoother.runtime.inputs import check_input

from .intrinsics import Intrinsics

#: A larger image is none of a camera; 111 bytes of PNG may state a thousand times as much.
MOST_PIXELS = 1 << 26
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"


def unpacked(
    packed: bytes,
    others: bool = False,
) -> NDArray:  # (height, width) or (height, width, channels)
    """The pixels of a PNG or a JPEG, by OpenCV; of `others` that it knows, too."""
    # What OpenCV itself holds for too large; it looks at it once, when it unpacks its first image.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    import cv2

    if not (others or packed.startswith((_PNG, _JPEG))):
        raise ValueError("neither PNG nor JPEG")
    place = len(_PNG)  # OpenCV takes memory for as much as a PNG's chunks state
    while packed.startswith(_PNG) and place < len(packed):
        if len(packed) < (place := place + 12 + int.from_bytes(packed[place : place + 4], "big")):
            raise ValueError("the image breaks off")
    try:
        image = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED) if packed else None
    except cv2.error as error:
        raise ValueError(f"it is damaged, or larger than {MOST_PIXELS} pixels") from error
    if image is None:
        raise ValueError("it is damaged")
    return np.asarray(image)


@dataclass(frozen=True)
class View:
    """What the camera saw of the panel in one pose."""

    depth_m: FloatArray  # (height, width) m: z of every pixel, m; nan where the camera has none
    infrared: FloatArray  # (height, width): in the image's own unit
    name: str = "the view"  # What to call it in messages


def read_view(depth_png: str | os.PathLike[str], infrared_png: str | os.PathLike[str]) -> View:
    """Read a depth image (16 bit, mm, 0 where there is none) and its infrared image (8 or 16 bit)."""
    depth = _read(depth_png)
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise CalibrationError(
            f"{depth_png} is not a depth image: it must have one channel of 16 bit, depth in millimetres."
        )
    infrared = _read(infrared_png)
    if infrared.ndim == 3:
        infrared = infrared[..., :3].max(axis=2)
    return view(depth, infrared, Path(depth_png).name)


def view(depth_mm: NDArray, infrared: NDArray, name: str) -> View:
    """A view of images as cameras give them: depth in mm, 0 where there is none."""
    depth = np.asarray(depth_mm, dtype=np.float64)
    known = (depth > 0) & (depth < 65535)  # both ends of the range mean "none"
    return View(np.where(known, 1e-3 * depth, np.nan), np.asarray(infrared, dtype=np.float64), name)


def check_size(seen: View, lens: Intrinsics) -> None:
    """Refuse images that the lens does not belong to."""
    for what, image in (("depth", seen.depth_m), ("infrared", seen.infrared)):
        height, width = image.shape
        if (width, height) != (lens.width, lens.height):
            raise CalibrationError(
                f"{seen.name}: the {what} image has {width} x {height} pixels and the intrinsics are of"
                f" {lens.width} x {lens.height}; give the intrinsics of this camera and mode."
            )


def _read(path: str | os.PathLike[str]) -> NDArray:
    check_input(path, CalibrationError)
    try:
        with open(path, "rb") as file:
            packed = file.read()
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        return unpacked(packed, others=True)
    except ValueError as error:
        raise CalibrationError(
            f"{path} is not an image that can be read ({error}); PNG is expected."
        ) from error


#: Brightness over the surroundings from which a spot counts, as fractions of the brightest; tried in turn.
LEVELS = (0.5, 0.25, 0.12, 0.06)
#: A spot is at least this many times as bright as its surroundings.
CONTRAST = 1.35
#: Not more spots than this are looked at, the strongest ones.
MOST = 12
#: A spot is no longer than this many times its width, and no larger than this share of the image.
ELONGATION, LARGEST = 3.5, 0.004
#: Window of the median that the surroundings are taken from, as a share of the image's width.
SURROUNDINGS = 0.08
#: The centroid is taken over what is brighter than this share of the spot's height.
FOOT = 0.15
#: A centroid is not known better than this, pixels: shape of the spot, blur, the lens' model.
FLOOR_PX = 0.04


@dataclass(frozen=True)
class Blobs:
    """Bright spots, the strongest first."""

    pixels: FloatArray  # (N, 2): centroids
    rays: FloatArray  # (N, 2): undistorted, x/z and y/z
    sigmas_px: FloatArray  # (N,) pixels: of a centroid, per axis
    radii_px: FloatArray  # (N,) pixels: of a disc of the same area

    def __len__(self) -> int:
        return len(self.pixels)


def find_blobs(infrared: FloatArray, lens: Intrinsics) -> Iterator[Blobs]:  # infrared (height, width)
    """Bright, compact spots at falling thresholds; a level that adds none is passed over."""
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
    table = np.array(sorted(rows, key=lambda row: -row[4])[:MOST]).reshape(-1, 5)
    return Blobs(table[:, :2], lens.rays(table[:, :2]), *table[:, 2:4].T)


def _centroid(
    infrared: FloatArray, stats: NDArray, labels: NDArray, index: int
) -> tuple[float, float, float, float, float] | None:
    """x, y, sigma, radius (pixels) and height; None where it is not a compact spot inside the image."""
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
    away = np.stack([(u - x).ravel(), (v - y).ravel()])
    spread = (weight.ravel() * away) @ away.T
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


def drawn_spots(infrared: FloatArray, blobs: Blobs) -> bytes:  # infrared (height, width)
    """PNG of the infrared image with every bright spot ringed, enlarged to about 1,000 pixels of width."""
    import cv2

    factor = -(-1024 // infrared.shape[1])
    top = max(float(np.percentile(infrared, 98)) * 4, 1e-9)  # both the room and the spots are to be seen
    grey = (255 * np.clip(infrared / top, 0, 1) ** 0.6).astype(np.uint8)
    image = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)
    rings = [
        cv2.KeyPoint(factor * (u + 0.5) - 0.5, factor * (v + 0.5) - 0.5, 2 * factor * (radius + 3))
        for (u, v), radius in zip(blobs.pixels.tolist(), blobs.radii_px.tolist(), strict=True)
    ]
    picture = cv2.drawKeypoints(
        image, rings, image, (0, 170, 255), cv2.DRAW_MATCHES_FLAGS_DRAW_RICH_KEYPOINTS
    )
    _, packed = cv2.imencode(".png", picture)
    return bytes(packed.tobytes())
