"""Pictures of the person beside the moving arm: few, small, and in a page only where they are asked for."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray

#: A picture is no wider than this, pixels, and there are no more a second.
MOST_WIDE, MOST_HZ = 320, 10.0
#: All pictures of a page together, bytes before they are written as text; longer films have fewer a second.
MOST_BYTES = 8_000_000
#: About the size of a picture, bytes: what the rate of a long film is chosen by.
USUAL_BYTES = 9_000
_QUALITY = 60
#: A picture stands for no longer than this, or two of its intervals, s.
_HELD_S = 0.5


@dataclass(frozen=True)
class Film:
    """Pictures on the clock of a page.

    Attributes
    ----------
    times_s : ndarray, shape (n,), s
        Increasing, on the IMU's clock.
    jpeg : list of bytes
        One a time.
    source : str
        Where they are from, in words.
    """

    times_s: FloatArray
    jpeg: list[bytes]
    source: str

    @property
    def words(self) -> str:
        """That the pictures are in the page, for its reader."""
        rate_hz = (len(self.jpeg) - 1) / max(float(self.times_s[-1] - self.times_s[0]), 1e-9)
        return (
            f" The video is {self.source}, reduced to {rate_hz:.2g} pictures per second. It is part of this"
            " page: whoever has the page sees the person."
        )

    def plain(self) -> dict[str, Any]:
        """As the page's player takes it."""
        step = float(np.median(np.diff(self.times_s))) if len(self.jpeg) > 1 else _HELD_S
        return {
            "times": [round(float(t), 3) for t in self.times_s],
            "jpeg": [b64encode(one).decode("ascii") for one in self.jpeg],
            "longest": max(_HELD_S, 2 * step),
        }


def make_film(
    images: Iterable[tuple[float, NDArray]], start_s: float, end_s: float, source: str
) -> Film | None:
    """Choose and shrink pictures.

    Parameters
    ----------
    images : iterable of (float, ndarray)
        Time on the IMU's clock, s, in rising order, and pixels: grey, or as OpenCV has colours (BGR).
    start_s, end_s : float, s
        What is shown.
    source : str
        Where they are from, in words.

    Returns
    -------
    film : Film or None
        None without a picture in that time.
    """
    rate_hz = min(MOST_HZ, MOST_BYTES / USUAL_BYTES / max(end_s - start_s, 1e-9))
    times, jpeg, size = [], [], 0
    for t, pixels in _thinned(images, start_s, end_s, 1.0 / rate_hz):
        packed = _small(pixels)
        size += len(packed)
        if size > 1.5 * MOST_BYTES:
            break
        times.append(t)
        jpeg.append(packed)
    return Film(np.array(times), jpeg, source) if jpeg else None


def _thinned(
    images: Iterable[tuple[float, NDArray]], start_s: float, end_s: float, step_s: float
) -> Iterator[tuple[float, NDArray]]:
    due = start_s
    for t, pixels in images:
        if t > end_s:
            return
        if t + 1e-6 >= due:
            yield t, pixels
            due = max(due + step_s, t + 0.5 * step_s)


def _small(pixels: NDArray) -> bytes:
    """A picture as a small JPEG."""
    import cv2

    if pixels.dtype != np.uint8:  # infrared: the brightest few points are lamps
        top = max(float(np.percentile(pixels, 99)), 1.0)
        pixels = np.clip(pixels * (255.0 / top), 0, 255).astype(np.uint8)
    scale = MOST_WIDE / pixels.shape[1]
    if scale < 1:
        size = (MOST_WIDE, max(1, round(pixels.shape[0] * scale)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, packed = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return bytes(packed.tobytes())
