"""`hold`: the last visible pose, kept."""

from __future__ import annotations

import numpy as np

from .scene import Path, Scene, between


def hold(scene: Scene) -> Path:
    """The pose of the last visible frame until the forearm is visible again; while it is visible, its own.

    Last observation carried forward (LOCF; Little and Rubin, Statistical Analysis with Missing Data, 2002),
    which is what a live display shows. Before the first visible frame: that frame's. Position is
    the camera's point, linear between frames; orientation is the filter's, held through a gap with the
    position, so that the joints stand still too.

    Order: without noise and gaps, linear between frames: off by acceleration x (frame period)^2 / 8 and by
    the filter's orientation over the lever arms.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position and orientation, without covariance.
    """
    t, point = scene.visible_points
    position = between(t, point, scene.t)
    pose_of = np.arange(len(scene.t))
    for gap in scene.gaps:
        inside = scene.occluded & (scene.t >= gap.start_s) & (scene.t <= gap.end_s)
        last_s = gap.end_s if gap.open_start else gap.start_s
        if len(t):
            position[inside] = point[np.argmin(np.abs(t - last_s))]
        pose_of[inside] = np.argmin(np.abs(scene.t - last_s))
    return Path(position=position, R_K_A=scene.R_K_A[pose_of])
