"""`hold`: the last thing that was seen."""

from __future__ import annotations

import numpy as np

from ..recording import FloatArray
from .camera import between, visible_point
from .scene import Path, Scene


def hold(scene: Scene) -> Path:
    """The pose of the last visible frame until the forearm is seen again; while it is seen, its own.

    What a live display shows. Before the first visible frame: that frame's. Position is the camera's
    point, linear between frames; orientation is the filter's, kept through a gap with the position, so
    that the joints stand still too.

    Order: without noise and gaps, linear between frames: off by acceleration x (frame period)^2 / 8 and by
    the filter's orientation over the lever arms.
    """
    t, point = visible_point(scene)
    position = between(t, point, scene.t)
    kept = np.arange(len(scene.t))
    for gap in scene.gaps:
        inside = scene.occluded & (scene.t >= gap.start_s) & (scene.t <= gap.end_s)
        last_s = gap.end_s if gap.open_start else gap.start_s
        position[inside] = _at(t, point, last_s)
        kept[inside] = np.argmin(np.abs(scene.t - last_s))
    return Path(position=position, R_K_A=scene.R_K_A[kept])


def _at(t: FloatArray, point: FloatArray, time_s: float) -> FloatArray:
    """The visible point nearest to a time."""
    if not len(t):
        return np.full(3, np.nan)
    return np.asarray(point[int(np.argmin(np.abs(t - time_s)))])
