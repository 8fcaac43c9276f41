"""How much of the space about the shoulder the hand reaches: convex hull, alpha shape, part of the sphere."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from .figure import UNKNOWN, Figure, share_of

LITRES = 1000.0
KEYS = ("hand_reach_hull_l", "hand_reach_alpha_l", "hand_reach_sphere_percent")


def reach_figures(
    place: FloatArray, occluded: BoolArray, arm_m: float, voxel_m: float, alpha_m: float
) -> dict[str, Figure]:
    """Volume of the hand's places, from the shoulder where there is one.

    Convex hull: Barber, Dobkin, Huhdanpaa, ACM Trans Math Softw 22:469-483 (1996). Alpha shape:
    Edelsbrunner and Muecke, ACM Trans Graph 13:43-72 (1994). The part of the sphere is the hull's volume over
    that of a ball with the arm's length as its radius, so that people of different size compare (as the
    reachable workspace of Kurillo et al., Hum Mov Sci 32:1191-1200, 2013, is divided by the arm's).

    Parameters
    ----------
    place : ndarray, shape (n, 3), m
        Of the hand; nan where it is not known.
    occluded : ndarray of bool, shape (n,)
        Not seen by the camera.
    arm_m : float, m
        From the shoulder to the hand along the bones; nan where it is not known.
    voxel_m : float, m
        Of the places in a cube of this size one counts, for the alpha shape.
    alpha_m : float, m
        Largest radius of a ball that goes round a tetrahedron of the alpha shape.

    Returns
    -------
    figures : dict of str to Figure
        `hand_reach_hull_l`, `hand_reach_alpha_l` (litres) and `hand_reach_sphere_percent`.
    """
    from scipy.spatial import ConvexHull, QhullError

    known = np.isfinite(place).all(axis=1)
    points, hidden = place[known], occluded[known]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # fewer than four places, or all in a plane
        return dict.fromkeys(KEYS, UNKNOWN)
    share = share_of(hidden[hull.vertices])
    sphere = 4.0 / 3.0 * np.pi * arm_m**3
    places = voxel_means(points, voxel_m)
    return {
        KEYS[0]: Figure(LITRES * float(hull.volume), share),
        KEYS[1]: Figure(LITRES * alpha_volume(places, alpha_m), share),
        KEYS[2]: Figure(100.0 * float(hull.volume) / sphere, share),
    }


def alpha_volume(points: FloatArray, alpha_m: float) -> float:
    """Volume of the alpha shape of points (n, 3): the Delaunay tetrahedra that a ball of that radius holds.

    Parameters
    ----------
    points : ndarray, shape (n, 3), m
        Four or more, not in a plane.
    alpha_m : float, m
        Largest radius of the ball through a tetrahedron's corners.

    Returns
    -------
    volume : float, m^3
        nan where the points have no volume.
    """
    from scipy.spatial import Delaunay, QhullError

    try:
        corners = points[Delaunay(points).simplices]
    except (QhullError, ValueError):
        return float("nan")
    edges = corners[:, 1:] - corners[:, :1]
    six_volumes = np.abs(np.linalg.det(edges))
    solid = six_volumes > 1e-15
    # the centre c of the ball is as far from all corners: 2 edges c = |edges|^2
    centre = np.linalg.solve(2.0 * edges[solid], (edges[solid] ** 2).sum(axis=2)[..., None])[..., 0]
    inside = np.linalg.norm(centre, axis=1) <= alpha_m
    return float(six_volumes[solid][inside].sum() / 6.0)


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points (n, 3) in each cube of that size, (k, 3)."""
    _, cube = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0, return_inverse=True)
    cube = cube.reshape(-1)
    count = np.bincount(cube)
    return np.stack([np.bincount(cube, points[:, axis]) / count for axis in range(3)], axis=1)
