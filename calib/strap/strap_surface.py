"""The forearm's surface and core where a depth image shows them."""

from __future__ import annotations

import numpy as np

from smoother.array_types import FloatArray
from smoother.linalg import unit

from ..intrinsics import PlacedCamera
from .strap_camera import Depth

#: The surface is looked for so far before and behind the line, m.
BEFORE_M, BEHIND_M, STEP_M = 0.16, 0.10, 0.002
#: The arm's axis by silhouette: stations (parts of the forearm), how many must agree, how far it may be from
#: the joints' line.
STATIONS = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.9)
FEWEST_STATIONS = 4
LARGEST_TURN_RAD, LARGEST_SHIFT_M = np.radians(12.0), 0.04
#: Depth at a station is taken over so much of the arm on both sides, m.
STATION_M = 0.012
#: The silhouette ends where the depth jumps by this much, and is so wide at most, m.
JUMP_M, REACH_M = 0.04, 0.07


def silhouette_axis(
    camera: PlacedCamera, depth: Depth, elbow: FloatArray, wrist: FloatArray, radius_m: float
) -> tuple[FloatArray, FloatArray] | None:
    """Elbow and wrist moved onto the arm's core as its silhouette shows it; None where it does not.

    At some stations the silhouette's middle and the surface's distance give the core; a straight line is
    fitted to them. Along the arm the joints stay where the camera has them.
    """
    length = float(np.linalg.norm(wrist - elbow))
    y = (wrist - elbow) / length
    origin = camera.origin
    parts, points = [], []
    for at in STATIONS:
        surface = surface_at(camera, depth, elbow, wrist, at, STATION_M)
        if surface is None:
            continue
        into, across = across_arm(surface, origin, y)
        middle = silhouette_middle(depth, surface, across, into, radius_m)
        if middle is not None:
            deep = float(np.sqrt(max(radius_m**2 - middle**2, 0.0)))
            core = surface + middle * across + deep * into
            parts.append(float((core - elbow) @ y) / length)
            points.append(core)
    if len(parts) < FEWEST_STATIONS:
        return None
    s, core = np.array(parts), np.array(points)
    kept = np.ones(len(s), dtype=bool)
    for _ in range(2):
        line = np.polynomial.polynomial.polyfit(s[kept], core[kept], 1)
        left = np.linalg.norm(core - (line[0] + s[:, None] * line[1]), axis=1)
        kept = left < max(2.5 * float(np.median(left)), 0.003)
        if kept.sum() < FEWEST_STATIONS:
            return None
    turned = line[1] @ y / np.linalg.norm(line[1])
    moved = np.linalg.norm(line[0] + 0.5 * line[1] - 0.5 * (elbow + wrist))
    if turned < np.cos(LARGEST_TURN_RAD) or moved > LARGEST_SHIFT_M or np.ptp(s[kept]) < 0.35:
        return None
    along = line[1] / np.linalg.norm(line[1])
    ends = [line[0] + ((joint - line[0]) @ along) * along for joint in (elbow, wrist)]
    return ends[0], ends[1]


def across_arm(surface: FloatArray, origin: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors into the arm (away from the camera) and across it, both at right angles to y."""
    into = surface - origin
    into = unit(into - (into @ y) * y)
    return into, np.cross(y, into)


def surface_at(
    camera: PlacedCamera, depth: Depth, elbow: FloatArray, wrist: FloatArray, at: float, beside_m: float
) -> FloatArray | None:
    """Point (3,) of the surface under a place of the line: where its ray meets what the depth camera saw.

    Black straps swallow infrared light and reflective markers blind it: depth is the median, against the
    elbow-wrist line, of the arm about that point.
    """
    length = float(np.linalg.norm(wrist - elbow))
    parts = at + np.linspace(-beside_m, beside_m, 13) / length
    line = elbow + parts[:, None] * (wrist - elbow)
    pixels, z_line = camera.pixels(line)
    if not np.isfinite(pixels).all():
        return None
    origin, directions = camera.origin, camera.rays(pixels)
    offsets = np.arange(-BEFORE_M, BEHIND_M, STEP_M)
    z = z_line[:, None] + offsets
    points = origin + z[..., None] * directions[:, None, :]
    seen, own = depth.at(points.reshape(-1, 3))
    behind = (own - seen).reshape(z.shape)  # negative before the surface, positive behind it
    found = []
    for row in behind:
        change = np.flatnonzero((row[:-1] < 0) & (row[1:] >= 0))
        if len(change):
            k = int(change[0])
            found.append(offsets[k] + STEP_M * row[k] / (row[k] - row[k + 1]))
    if len(found) < 4:
        return None
    centre = len(parts) // 2
    return np.asarray(origin + (z_line[centre] + float(np.median(found))) * directions[centre])


def silhouette_middle(
    depth: Depth, surface: FloatArray, across: FloatArray, into: FloatArray, radius_m: float
) -> float | None:
    """How far the arm's middle lies across from the surface point, m; None where it has no clear edges."""
    steps = np.arange(-REACH_M, REACH_M + 1e-9, 0.001)
    seen, own = depth.at(surface + steps[:, None] * across)
    arm = np.abs(seen - own) < JUMP_M
    centre = len(steps) // 2
    missing = ~np.isfinite(seen)
    ends = []
    for way in (-1, 1):
        k = centre
        while 0 < k < len(steps) - 1 and (arm[k] or (missing[k] and abs(steps[k]) < 0.6 * radius_m)):
            k += way
        if not 0 < k < len(steps) - 1:
            return None
        ends.append(steps[k])
    wide = ends[1] - ends[0]
    return 0.5 * float(ends[0] + ends[1]) if 1.2 * radius_m < wide < 3.0 * radius_m else None
