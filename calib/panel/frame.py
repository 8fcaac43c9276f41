"""The panel's axes: from camera points by principal components (JA II-F.1), from markers, and fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.linalg import nearest_rotation, unit

from .definition import Panel

#: Fewer points than this make no group for a principal component.
FEWEST = 20
#: Principal components are taken of not more points than this: more say nothing new and cost seconds.
MOST = 20_000
#: Statistical removal of outliers: neighbours looked at, and sigmas allowed.
NEIGHBOURS, SIGMAS = 20, 2.5


@dataclass(frozen=True)
class Frame:
    """Axes of the panel (columns of `R`) and its origin, seen from another frame, m."""

    R: FloatArray
    origin: FloatArray

    def after(self, other: Frame) -> Frame:
        """The transform that takes `other`'s frame to this one's (JA eq 4 and 5)."""
        R = self.R @ other.R.T
        return Frame(R, self.origin - R @ other.origin)


def frame_of_points(
    points_K: FloatArray, along_x: BoolArray, along_y: BoolArray, about_R: FloatArray
) -> Frame | None:
    """The panel in the camera by principal components, as published (JA II-F.1).

    First component of the points along x and along y, third component of all of them; the origin is where
    the two lines come nearest to each other.

    Parameters
    ----------
    points_K : ndarray, shape (N, 3), m
        Those of the plane group.
    along_x, along_y : ndarray of bool, shape (N,)
        Those of the strips along the arms.
    about_R : ndarray, shape (3, 3)
        The axes roughly, for the components' signs.

    Returns
    -------
    The axes; None where a group has too few points.
    """
    if min(along_x.sum(), along_y.sum()) < FEWEST:
        return None
    centre_x, axes_x = principal(points_K[along_x])
    centre_y, axes_y = principal(points_K[along_y])
    axes = np.column_stack([axes_x[:, 0], axes_y[:, 0], principal(points_K)[1][:, 2]])
    axes *= np.sign(np.sum(axes * about_R, axis=0))
    return Frame(nearest_rotation(axes), _meeting(centre_x, axes[:, 0], centre_y, axes[:, 1]))


def frame_of_markers(markers: FloatArray, panel: Panel) -> Frame:
    """The panel from its markers in order, (4, 3) m, as published: axes along the arms, z = x cross y."""
    away = panel.markers_P - panel.markers_P[0]
    axes = np.zeros((3, 3))
    for axis in (0, 1):
        along = np.abs(away[:, axis])
        end = np.argmax(np.where(along > 2 * np.abs(away[:, 1 - axis]), along, -1.0))
        axes[:, axis] = unit((markers[end] - markers[0]) * np.sign(away[end, axis]))
    axes[:, 2] = unit(np.cross(axes[:, 0], axes[:, 1]))
    return Frame(nearest_rotation(axes), markers[0])


def fit_frame(points: FloatArray, panel: Panel) -> Frame:
    """Pose of the panel by least squares on its markers (4, 3), in order; `origin` is {P}'s."""
    return kabsch(np.column_stack([panel.markers_P, np.full(4, panel.height_m)]), points)


def kabsch(source: FloatArray, target: FloatArray) -> Frame:
    """Rotation and shift that take points (N, 3) of one frame to those of another, by least squares."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    R = nearest_rotation((target - b).T @ (source - a))
    return Frame(R, b - R @ a)


def principal(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) and principal components (columns, the largest first) of points (N, 3) less outliers."""
    from smoother.runtime.packages import load_open3d

    open3d = load_open3d()
    points = points[:: -(-len(points) // MOST)]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.ascontiguousarray(points)))
    if len(points) > 2 * NEIGHBOURS:
        cloud, _ = cloud.remove_statistical_outlier(NEIGHBOURS, SIGMAS)
    mean, covariance = cloud.compute_mean_and_covariance()
    axes = np.linalg.eigh(np.asarray(covariance))[1][:, ::-1]
    return np.asarray(mean, dtype=np.float64), np.asarray(axes, dtype=np.float64)


def _meeting(a: FloatArray, x: FloatArray, b: FloatArray, y: FloatArray) -> FloatArray:
    """Middle of the shortest link between the lines a + s x and b + t y."""
    s, t = np.linalg.lstsq(np.column_stack([x, -y]), b - a, rcond=None)[0]
    return np.asarray(0.5 * (a + s * x + b + t * y))
