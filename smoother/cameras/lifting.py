"""Depths on the rays of cameras without depth, so that every joint has a place to start from.

Only what is across a ray was measured (`measurements.rays`): depths are start values, and decide how far a
pixel is. They come from a camera with depth at the same moments, or from the rays of a second one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..recording import JOINTS, CameraPose, JointTracks
from .overlap import APART_S
from .rig import RelativeClock

#: Rays with a smaller angle between them, rad, do not determine a depth.
PARALLEL = 0.05


def depth_by_points(
    flat: JointTracks, pose: CameraPose, clock: RelativeClock, with_depth: JointTracks
) -> FloatArray:
    """Depths (F, 5) m of a camera's joints by those that a camera with depth saw in {K}, bridged between."""
    t = clock.to_first(np.asarray(flat.t_s))
    depth = np.full(flat.state.shape, np.nan)
    for column, joint in enumerate(JOINTS):
        rows = np.flatnonzero(with_depth.tracked(joint))
        if len(rows) < 2:
            continue
        seen_t = np.asarray(with_depth.t_s)[rows]
        points = (np.asarray(with_depth.position)[rows, column] - pose.p_K_C_m) @ pose.R_K_C
        depth[:, column] = np.interp(t, seen_t, points[:, 2])
    return _filled(depth)


def depth_by_rays(
    flat: JointTracks, pose: CameraPose, clock: RelativeClock, other: JointTracks, other_pose: CameraPose
) -> tuple[FloatArray, BoolArray]:
    """Depths (F, 5) m of a camera's joints where the rays of another one meet them, and where they do."""
    t, other_t = clock.to_first(np.asarray(flat.t_s)), np.asarray(other.t_s)
    after = np.clip(np.searchsorted(other_t, t), 1, max(len(other_t) - 1, 1))
    before = after - 1
    depth = np.full(flat.state.shape, np.nan)
    dt = other_t[after] - other_t[before]
    share = np.clip((t - other_t[before]) / np.maximum(dt, 1e-6), 0.0, 1.0)[:, None]
    apart = pose.p_K_C_m - other_pose.p_K_C_m
    for column, joint in enumerate(JOINTS):
        seen = other.tracked(joint)
        known = flat.tracked(joint) & seen[before] & seen[after] & (dt > 0) & (dt < APART_S)
        known &= (t >= other_t[0]) & (t <= other_t[-1])
        of_other = np.asarray(other.position)[:, column]
        b = (of_other[before] + share * (of_other[after] - of_other[before])) @ other_pose.R_K_C.T
        a = np.asarray(flat.position)[:, column] @ pose.R_K_C.T
        # the point of the first ray that is nearest to the second
        aa, ab, bb = np.sum(a * a, axis=1), np.sum(a * b, axis=1), np.sum(b * b, axis=1)
        determinant = aa * bb - ab**2
        z = (ab * (b @ apart) - bb * (a @ apart)) / np.where(determinant > 0, determinant, np.inf)
        with np.errstate(invalid="ignore"):
            known &= (determinant > PARALLEL**2 * aa * bb) & (z > 0.2) & (z < 20.0)
        depth[known, column] = z[known]
    met = np.isfinite(depth)
    own_t = np.asarray(flat.t_s)
    for column in range(len(JOINTS)):
        rows = np.flatnonzero(met[:, column])
        if len(rows) > 1:
            depth[:, column] = np.interp(own_t, own_t[rows], depth[rows, column])
    return _filled(depth), met


def _filled(depth: FloatArray) -> FloatArray:
    """Joints without a depth of their own take the mean of the others, 2 m where there is none."""
    with np.errstate(invalid="ignore"):
        known = np.isfinite(depth)
        mean = np.where(known, depth, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean[~known.any(axis=1)] = 2.0
    return np.where(known, np.maximum(depth, 0.2), mean[:, None])


def lifted(flat: JointTracks, depth_m: FloatArray) -> JointTracks:
    """The frames with a place for every joint in the camera's axes, where their rays begin."""
    points = np.asarray(flat.position) * depth_m[:, :, None]
    return replace(flat, position=points, pixel_rad=None, ray_origin_m=np.zeros((1, 3)))
