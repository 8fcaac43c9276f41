"""What is in space, for the page's own canvas: packed numbers, the view, items that stand still."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..array_types import FloatArray
from ..linalg import unit
from ..recording import CameraFrame
from .sheet import data_block, headed

#: Largest number of the packed values, and the one that marks a missing value.
_LARGEST, _NOTHING = 32000, -32768
#: Shades of a colour scale.
_SHADES = 64
#: Colour scales, from low to high: dark blue to yellow, and blue over white to red.
_SCALES = {
    "cividis": ("#00204c", "#31446b", "#666870", "#958f78", "#cbba69", "#ffea46"),
    "blue-red": ("#2166ac", "#92c5de", "#d9d9d9", "#f4a582", "#b2182b"),
}


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


def cloud(
    points: FloatArray,
    name: str,
    colour: str,
    size: float,
    *,
    symbol: str = "circle",
    words: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Points (n, 3) of one colour; `words` appear under the pointer."""
    item = {"kind": "points", "name": name, "colour": colour, "size": size, "symbol": symbol}
    return item | {"points": packed(points)} | ({} if words is None else {"words": list(words)})


def shaded_cloud(
    points: FloatArray, name: str, values: ArrayLike, scale: str, limits: tuple[float, float], size_m: float
) -> dict[str, Any]:
    """Points (n, 3) coloured by a value each, on a colour scale between limits; sizes as in space."""
    low, high = limits
    share = (np.asarray(values, float) - low) / max(high - low, 1e-12)
    shade = np.clip(np.rint(share * (_SHADES - 1)), 0, _SHADES - 1).astype(int)
    ramp = _ramp(_SCALES[scale])
    item = {"kind": "points", "name": name, "size_m": size_m, "colour": shade.tolist(), "ramp": ramp}
    return item | {"points": packed(points), "limits": limits}


def polyline(
    points: FloatArray, name: str, colour: str, width: float, *, dash: bool = False
) -> dict[str, Any]:
    """A line (n, 3); nan breaks it."""
    item = {"kind": "line", "name": name, "colour": colour, "size": width, "dash": dash}
    return item | {"points": packed(points)}


def face(corners: FloatArray, name: str, colour: str) -> dict[str, Any]:
    """A flat, translucent face (n, 3)."""
    return {"kind": "face", "name": name, "colour": colour, "points": packed(corners)}


def space(
    heading: str,
    caption: str,
    items: Sequence[dict[str, Any]],
    view: dict[str, Any],
    *,
    axes: Sequence[str] | None = None,
    ball: float | None = None,
    unit_of_values: str = "",
) -> str:
    """A heading, a caption and what is in space, to be turned; its legend switches names off and on.

    Parameters
    ----------
    heading, caption : str
        Above it.
    items : sequence of dict
        As `cloud`, `shaded_cloud`, `polyline` and `face` give them.
    view : dict
        As `view_of` gives it; with axes also `axes_at` and `axes_length`, unless there is a ball.
    axes : sequence of str, optional
        Names of the axes, drawn at their origin.
    ball : float, optional
        Radius of an opaque ball about zero: what lies behind it does not shine through.
    unit_of_values : str
        Of the values that give points their colour.

    Returns
    -------
    html : str
        The section.
    """
    first = {item["name"]: item for item in reversed(items)}
    names = list(dict.fromkeys(item["name"] for item in items if item["name"]))
    legend = "".join(_legend(first[name]) for name in names)
    ramps = "".join(_scale(item, unit_of_values) for item in items if "ramp" in item)
    values = {"view": view, "items": list(items), "axes": axes and list(axes), "ball": ball}
    return (
        f'<div class="together">{headed(heading, caption)}<div class="space still">'
        f'<canvas tabindex="0" role="img" aria-label="{escape(heading)}"></canvas>'
        f'<div class="legend">{legend}{ramps}</div>'
        f'<div class="tip"></div>{data_block(values)}</div></div>'
    )


def switch(name: str, words: str, colour: str) -> str:
    """A box of a legend that switches something off and on; the colour is a CSS one."""
    swatch = f'<span class="swatch" style="background:{escape(colour)}"></span>'
    return f'<label><input type="checkbox" checked value="{escape(name)}">{swatch}{escape(words)}</label>'


def _legend(item: dict[str, Any]) -> str:
    colour = item["ramp"][_SHADES // 2] if "ramp" in item else item["colour"]
    return switch(item["name"], item["name"], "var(--truth)" if colour == "#111111" else colour)


def _scale(item: dict[str, Any], words: str) -> str:
    low, high = item["limits"]
    shades = ", ".join(item["ramp"][::9])
    return (
        f'<span>{low:.3g} <span class="ramp" style="background:linear-gradient(90deg, {shades})"></span>'
        f" {high:.3g} {escape(words)}</span>"
    )


def _ramp(colours: Sequence[str]) -> list[str]:
    rgb = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in colours])
    at = np.linspace(0, len(colours) - 1, _SHADES)
    shades = np.stack([np.interp(at, np.arange(len(colours)), channel) for channel in rgb.T], axis=1)
    return ["#" + "".join(f"{int(value):02x}" for value in shade.round()) for shade in shades]
