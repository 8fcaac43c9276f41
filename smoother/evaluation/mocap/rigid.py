"""Rigid bodies of markers: the body's own shape, and its pose in every frame where enough of it is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...linalg import nearest_rotation

#: A marker this far off its place on the body is mistaken (swapped, or a ghost), m.
MISTAKEN_M = 0.005
#: The seen markers must spread this far across their longest line, m (rms), or the pose could turn about it.
LEAST_WIDTH_M = 0.004
#: Frames that a shape is found from.
_MOST_FRAMES = 2000


@dataclass(frozen=True)
class ClusterMotion:
    """The poses of a rigid cluster.

    Attributes
    ----------
    rotation, position : ndarray, shape (n, 3, 3) and (n, 3), m
        `p_E = rotation p_P + position`; nan where unknown.
    residual_m : ndarray, shape (n,), m
        Rms distance of the seen markers from the body.
    used : ndarray of bool, shape (n, m)
        The marker took part.
    mistaken : int
        Single samples that were rejected.
    """

    rotation: FloatArray
    position: FloatArray
    residual_m: FloatArray
    used: BoolArray
    mistaken: int


def fit_poses(
    shape: FloatArray, observed: FloatArray, weight: FloatArray | BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Least-squares poses (N, 3, 3), (N, 3) that bring a shape to the markers seen (Kabsch 1976).

    Parameters
    ----------
    shape : ndarray, shape (m, 3) or (n, m, 3), m
        The markers on the body.
    observed : ndarray, shape (n, m, 3), m
        The markers as seen; those of weight zero may be nan.
    weight : ndarray, shape (n, m)
        Zero where a marker takes no part.

    Returns
    -------
    rotation, position : ndarray, shape (n, 3, 3) and (n, 3), m
        `p_E = rotation p_P + position`.
    """
    weight = np.asarray(weight, dtype=np.float64)
    shape = np.broadcast_to(np.where(np.isfinite(shape), shape, 0.0), observed.shape)
    observed = np.where(weight[..., None] > 0, observed, 0.0)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    centre_shape = np.einsum("nm,nmi->ni", weight, shape) / total
    centre_seen = np.einsum("nm,nmi->ni", weight, observed) / total
    from_centre, to_centre = shape - centre_shape[:, None], observed - centre_seen[:, None]
    rotation = nearest_rotation(np.einsum("nm,nmi,nmj->nij", weight, to_centre, from_centre))
    return rotation, centre_seen - np.einsum("nij,nj->ni", rotation, centre_shape)


def find_shape(position: FloatArray) -> FloatArray:
    """The shape (M, 3) m of a rigid cluster from its motion, in axes of its own; nan for what never showed.

    It grows from the frame in which the most markers are seen: markers get their places in the body from
    frames whose pose is known by others. The median over the frames keeps swapped labels out.

    Parameters
    ----------
    position : ndarray, shape (n, m, 3), m
        nan where a marker was not seen.
    """
    finite: BoolArray = np.asarray(np.isfinite(position).all(axis=2))
    rows = np.flatnonzero(finite.sum(axis=1) >= 3)
    if not len(rows):
        return np.full(position.shape[1:], np.nan)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_FRAMES)).astype(int)]
    position, finite = position[rows], finite[rows]
    shape = _typical(position, finite)
    for _ in range(8):
        known = np.isfinite(shape).all(axis=1)
        weight = finite & known
        good = (weight.sum(axis=1) >= 3) & (_width(shape, weight) >= LEAST_WIDTH_M)
        if not good.any():
            break
        rotation, origin = fit_poses(shape, position[good], weight[good])
        in_body = np.einsum("nji,nmj->nmi", rotation, position[good] - origin[:, None])
        for marker in np.flatnonzero(finite[good].any(axis=0)):
            shape[marker] = np.nanmedian(in_body[:, marker], axis=0)
    return np.asarray(shape - np.nanmean(shape, axis=0))


def _typical(position: FloatArray, finite: BoolArray) -> FloatArray:
    """Of the frames with the most markers, the one (M, 3) whose distances are most like the others'."""
    count = finite.sum(axis=1)
    fullest = finite[np.argmax(count)]
    whole = np.flatnonzero((finite == fullest).all(axis=1))
    whole = whole[np.linspace(0, len(whole) - 1, min(len(whole), 200)).astype(int)]
    places = position[whole][:, fullest]
    apart = np.linalg.norm(places[:, :, None] - places[:, None, :], axis=3)
    off = np.abs(apart - np.median(apart, axis=0)).max(axis=(1, 2))
    shape = np.full(position.shape[1:], np.nan)
    shape[fullest] = places[np.argmin(off)]
    return shape


def follow(shape: FloatArray, position: FloatArray) -> ClusterMotion:
    """Poses of a body of known shape (M, 3) in every frame with three markers that span a plane.

    Where four or more do not fit, the one without which the others fit best is rejected, one after another,
    until none is more than 5 mm off; where three are left that do not fit, there is no pose.
    """
    known = np.isfinite(shape).all(axis=1)
    weight: BoolArray = np.asarray(np.isfinite(position).all(axis=2) & known)
    count, mistaken = len(position), 0
    rotation, origin = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan)
    residual = np.full(count, np.nan)
    open_rows = np.flatnonzero(weight.sum(axis=1) >= 3)
    while len(open_rows):
        wide = _width(shape, weight[open_rows]) >= LEAST_WIDTH_M
        open_rows = open_rows[wide & (weight[open_rows].sum(axis=1) >= 3)]
        if not len(open_rows):
            break
        observed, used = position[open_rows], weight[open_rows]
        R, p, off = _fit(shape, observed, used)
        fits = off.max(axis=1) <= MISTAKEN_M
        fitted = open_rows[fits]
        rotation[fitted], origin[fitted] = R[fits], p[fits]
        residual[fitted] = np.sqrt((off[fits] ** 2).sum(axis=1) / used[fits].sum(axis=1))
        # of three markers nothing shows which one is wrong
        open_rows = open_rows[~fits & (used.sum(axis=1) > 3)]
        weight[open_rows, _odd_one(shape, position[open_rows], weight[open_rows])] = False
        mistaken += len(open_rows)
    weight[~np.isfinite(residual)] = False
    return ClusterMotion(rotation, origin, residual, weight, mistaken)


def _fit(
    shape: FloatArray, observed: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses, and how far each used marker (N, M) is off its place, m."""
    R, p = fit_poses(shape, observed, used)
    off = observed - np.einsum("nij,mj->nmi", R, shape) - p[:, None]
    return R, p, np.linalg.norm(np.where(used[..., None], off, 0.0), axis=2)


def _odd_one(shape: FloatArray, observed: FloatArray, used: BoolArray) -> IntArray:
    """The marker (N,) without which the others fit best."""
    error = np.full(used.shape, np.inf)
    for marker in range(used.shape[1]):
        without = used.copy()
        without[:, marker] = False
        rest = (_fit(shape, observed, without)[2] ** 2).sum(axis=1)
        error[:, marker] = np.where(used[:, marker], rest, np.inf)
    return np.asarray(error.argmin(axis=1))


def _width(shape: FloatArray, weight: BoolArray) -> FloatArray:
    """Rms distance (N,) m of the chosen markers from the line through them."""
    shape = np.where(np.isfinite(shape), shape, 0.0)
    weight = weight.astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1.0)
    centre = weight @ shape / total[:, None]
    second = np.einsum("nm,mi,mj->nij", weight, shape, shape) / total[:, None, None]
    spread = np.linalg.eigvalsh(second - centre[:, :, None] * centre[:, None, :])
    return np.sqrt(np.maximum(spread[:, 1], 0.0))


def plate_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes (3, 3) and origin (3,) of {P} in the shape's own axes, as the map of markers defines them.

    Origin: mean of the markers. x: first to second marker; z: x cross the way to the third (the first
    marker that does not lie on that line).
    """
    known = shape[np.isfinite(shape).all(axis=1)]
    x = known[1] - known[0]
    x = x / np.linalg.norm(x)
    ways = known[2:] - known[0]
    off_line = np.linalg.norm(ways - (ways @ x)[:, None] * x, axis=1)
    way = ways[np.argmax(off_line > LEAST_WIDTH_M)]
    z = np.cross(x, way)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z]), known.mean(axis=0)
