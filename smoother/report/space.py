"""What is in space, for the page's own canvas: packed numbers, and the view."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..linalg import unit
from ..recording import CameraFrame

#: Largest number of the packed values, and the one that marks a missing value.
_LARGEST, _NOTHING = 32000, -32768


def packed(values: FloatArray) -> dict[str, Any]:
    """Numbers (n, c) as 16 bits each: their scale, one offset per column, base64; nan stays nothing."""
    values = np.asarray(values, float)
    finite = np.isfinite(values)
    low = np.min(np.where(finite, values, np.inf), axis=0, initial=np.inf)
    high = np.max(np.where(finite, values, -np.inf), axis=0, initial=-np.inf)
    some = np.isfinite(low)
    offset = np.where(some, 0.5 * (np.where(some, low, 0.0) + np.where(some, high, 0.0)), 0.0)
    scale = max(float(np.max(np.where(some, high - offset, 0.0), initial=0.0)) / _LARGEST, 1e-9)
    whole = np.where(finite, np.rint((np.where(finite, values, 0.0) - offset) / scale), _NOTHING)
    data = b64encode(whole.astype("<i2").tobytes()).decode("ascii")
    return {"data": data, "scale": scale, "offset": [float(f"{value:.9g}") for value in offset]}


def upwards(frame: CameraFrame | None, gravity: FloatArray | None = None) -> FloatArray:
    """Unit vector (3,) upwards in {K}: by gravity where it is known, else by the camera's convention."""
    if gravity is not None and np.isfinite(gravity).all() and np.linalg.norm(gravity) > 0:
        return -unit(gravity)
    return -(frame or CameraFrame.ZUP).down


def seen_from(points: FloatArray, up: FloatArray, frame: CameraFrame | None) -> FloatArray:
    """Direction (3,) from which to look: from the camera's side, a little from above and beside it."""
    points = points[np.isfinite(points).all(axis=1)]
    back = -np.median(points, axis=0) if len(points) else np.array([1.0, 1.0, 0.5])
    if frame not in (CameraFrame.KINECT, CameraFrame.OPTICAL):
        back = np.array([1.2, -1.4, 0.3])
    back = back - up * (back @ up)
    length = np.linalg.norm(back)
    back = back / length if length > 1e-9 else unit(np.cross(up, [0.3, 0.5, 0.8]))
    return 2.3 * back + 0.7 * up + 0.9 * np.cross(up, back)


def view_of(points: FloatArray, up: FloatArray, eye: FloatArray, aspect: float = 0.56) -> dict[str, Any]:
    """Where to look at points (n, 3) from so that all but a few outliers of them are in sight."""
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        points = np.zeros((1, 3))
    low, high = np.percentile(points, (0.5, 99.5), axis=0)
    center = 0.5 * (low + high)
    away = np.linalg.norm(points - center, axis=1)
    radius = max(1.05 * float(np.percentile(away, 99.5)), 0.05)
    return {
        "up": up.tolist(),
        "eye": eye.tolist(),
        "center": center.tolist(),
        "radius": radius,
        "aspect": aspect,
        "low": float(np.percentile(points @ up, 0.5)),
    }


def switch(name: str, words: str, colour: str) -> str:
    """A box of a legend that switches something off and on; the colour is a CSS one."""
    swatch = f'<span class="swatch" style="background:{escape(colour)}"></span>'
    return f'<label><input type="checkbox" checked value="{escape(name)}">{swatch}{escape(words)}</label>'
