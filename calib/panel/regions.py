"""The three parts of the panel without markers (JA fig. 1b): along x, along y, and all of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from smoother.array_types import BoolArray, FloatArray

from ..intrinsics import Intrinsics
from .blobs import Blobs
from .definition import Panel
from .frame import Frame

#: Left out along the rim, where pixels are mixed with what lies behind: pixels.
RIM_PX = 3.0
#: Left out about a bright spot, beyond its own radius: its light disturbs the depth there, pixels.
ABOUT_SPOT_PX = 5.0
#: Half the width of the strips along the arms, m, as far as the panel reaches to both sides.
STRIP_M = 0.03


@dataclass(frozen=True)
class Regions:
    """Depth pixels of the panel.

    Attributes
    ----------
    pixels : ndarray, shape (N, 2)
        Whole pixels of the plane group.
    rays : ndarray, shape (N, 2)
        Theirs, undistorted.
    depth_m : ndarray, shape (N,), m
        Theirs.
    panel_P : ndarray, shape (N, 2), m
        Where they lie on the panel by the first pose.
    along_x, along_y : ndarray of bool, shape (N,)
        Those of the strips.
    covered : float
        Share of the panel's usable pixels that have a depth.
    cell_m : float, m
        Two pixels on the panel.
    """

    pixels: FloatArray
    rays: FloatArray
    depth_m: FloatArray
    panel_P: FloatArray
    along_x: BoolArray
    along_y: BoolArray
    covered: float
    cell_m: float


def panel_regions(depth_m: FloatArray, lens: Intrinsics, blobs: Blobs, panel: Panel, frame: Frame) -> Regions:
    """Choose the panel's depth pixels, away from its rim and from every bright spot.

    Parameters
    ----------
    depth_m : ndarray, shape (height, width), m
        nan where there is none.
    blobs : Blobs
        All bright spots, the panel's or not.
    frame : Frame
        The panel in {K}; good to some millimetres.

    Returns
    -------
    Regions
    """
    v, u, xy = _panel_pixels(lens, panel, frame)
    pixels = np.column_stack([u, v]).astype(np.float64)
    # metres that a pixel covers on the panel, in its worse direction
    middle = frame.origin + frame.R[:, :2] @ panel.extent_P.mean(axis=0)
    distance = float(np.linalg.norm(middle))
    facing = abs(frame.R[:, 2] @ middle) / distance
    pixel_m = distance / lens.focal_px / max(facing, 0.2)
    low, high = panel.extent_P + RIM_PX * pixel_m * np.array([[1.0], [-1.0]])
    inside = ((xy > low) & (xy < high)).all(axis=1)
    for centre, radius in zip(blobs.pixels, blobs.radii_px, strict=True):
        inside &= np.hypot(*(pixels - centre).T) > radius + ABOUT_SPOT_PX
    depth = depth_m[v, u]
    seen = inside & np.isfinite(depth)
    covered = float(seen.sum() / max(inside.sum(), 1))
    pixels, xy = pixels[seen], xy[seen]
    return Regions(
        pixels=pixels,
        rays=lens.ray_image()[v, u][seen],
        depth_m=depth[seen],
        panel_P=xy,
        along_x=_strip(xy, panel, 0),
        along_y=_strip(xy, panel, 1),
        covered=covered,
        cell_m=2 * pixel_m,
    )


def _panel_pixels(lens: Intrinsics, panel: Panel, frame: Frame) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows and columns of the pixels about the panel and where they meet its plane, (N, 2) in {P}."""
    xmin, ymin = panel.extent_P[0]
    xmax, ymax = panel.extent_P[1]
    corners = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]])
    at = lens.pixels(np.clip(frame.origin + corners @ frame.R[:, :2].T, [-9, -9, 0.1], None))
    left, top = np.clip(np.floor(at.min(axis=0)), 0, [lens.width, lens.height]).astype(int)
    right, bottom = np.clip(np.ceil(at.max(axis=0)) + 1, 0, [lens.width, lens.height]).astype(int)
    v, u = (part.ravel() for part in np.mgrid[top:bottom, left:right])
    rays = np.concatenate([lens.ray_image()[v, u], np.ones((len(v), 1))], axis=1)
    normal = frame.R[:, 2]
    along = rays @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = rays * ((normal @ frame.origin) / along)[:, None]
    xy = (meets - frame.origin) @ frame.R[:, :2]
    xy[~(meets[:, 2] > 0)] = np.inf
    return v, u, xy


def on_plane(regions: Regions, inliers: BoolArray, panel: Panel) -> Regions:
    """The same with strips of pixels that lie on the plane, alike to both sides of the arm's line.

    Where a pixel is missing (a marker, a hand), the one across the line is left out too: else the principal
    component would turn towards it.
    """
    strips = []
    for axis, strip in enumerate((regions.along_x, regions.along_y)):
        chosen = strip & inliers
        along = np.floor(regions.panel_P[chosen, axis] / regions.cell_m).astype(int).tolist()
        away = regions.panel_P[chosen, 1 - axis] - panel.markers_P[0, 1 - axis]
        side = np.floor(away / regions.cell_m).astype(int).tolist()
        cells = set(zip(along, side, strict=True))
        chosen[chosen] = [(a, -1 - b) in cells for a, b in zip(along, side, strict=True)]
        strips.append(chosen)
    return replace(regions, along_x=strips[0], along_y=strips[1])


def _strip(xy: FloatArray, panel: Panel, axis: int) -> BoolArray:
    """Pixels along an arm of the L, from its first to its last marker."""
    arm = panel.arms()[axis]
    across = 1 - axis
    middle = float(panel.markers_P[0, across])
    margin = min(middle - panel.extent_P[0, across], panel.extent_P[1, across] - middle)
    half = min(STRIP_M, max(margin, 0.01))
    low, high = float(arm[:, axis].min()), float(arm[:, axis].max())
    if high - low < 0.02:  # no arm in this direction: take the panel's whole length
        low, high = float(panel.extent_P[0, axis]), float(panel.extent_P[1, axis])
    return (np.abs(xy[:, across] - middle) <= half) & (xy[:, axis] >= low) & (xy[:, axis] <= high)
