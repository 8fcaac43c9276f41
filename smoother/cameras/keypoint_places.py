"""Where a camera without depth stands and how its clock runs, by joints that a camera with depth saw as well.

A start in closed form (direct linear transformation; Hartley and Zisserman, Multiple View Geometry, 2004,
7.1), then robust Gauss-Newton steps on pose and clock. The covariance is that of blocks of seconds, as for
cameras with depth (`placing`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import nearest_rotation, skew
from ..recording import JOINTS, Camera, CameraPose, JointTracks
from ..rotation import Rotation
from .faults import LEAST_S, Move, moved, never_together
from .placing import OFFSET_M, solved
from .rig import Overlap, RelativeClock, RigCamera, candidate_offsets, overlap

#: Samples of one block share their error, s, and errors of joints in space last this long.
BLOCK_S = 3.0
#: What constant errors of joints, m, leave of a place however long the recording is.
JOINTS_M = 0.01
#: Length of a residual, in sigmas, where its weight is halved.
CAUCHY = 2.5
STEPS = 15
#: Rays that pass the joints in the middle by more than this, m, are not this arm's: of twelve cameras that
#: saw it they passed by 16 to 30 mm, of those that saw another by 62 to 133.
OTHER_M = 0.045
#: Clock offsets between cameras whose places are known are tried in these steps, up to these, s.
COARSE_S, FARTHEST_S = 0.1, 60.0


@dataclass(frozen=True)
class KeypointPlacement:
    """A camera without depth as the joints tell it: `R_K_C`, its origin, its clock, by how much it misses."""

    R: FloatArray  # (3, 3) and (3,) m
    p: FloatArray  # (3, 3) and (3,) m
    clock: RelativeClock
    misfit_m: float  # Median distance of the joints from their rays
    covariance: FloatArray  # (7, 7): of a turn about the joints' centre, a shift there, and the clock
    # (5, 3) m: Offset of the first camera's joints from this one's of the same name, in {K}: constant errors
    offset_m: FloatArray


def placed_keypoints(camera: Camera, first: JointTracks, name: str) -> RigCamera:
    """A camera without depth as a row of the table, by what it and the first one see together."""
    best, length_s = None, 0.0
    moves: list[Move] = []
    for offset_s in candidate_offsets(first, camera.arm):
        clock = RelativeClock(offset_s)
        together = overlap(first, camera.arm, clock)
        if together.length_s < LEAST_S:
            continue
        found = _placed(first, camera.arm, clock)
        if found is None:
            continue
        if (move := _moved(first, camera.arm, found)) is not None:
            moves.append(move)
        if best is None or found.misfit_m < best.misfit_m:
            best, length_s = found, together.length_s
    if best is None:
        return RigCamera(camera.name, reason=never_together(name))
    variance = np.diag(best.covariance)
    sigma_m = float(np.sqrt(variance[3:6].mean() + JOINTS_M**2))
    pose = CameraPose(best.R, best.p, float(np.sqrt(variance[:3].mean())), sigma_m)
    clock = replace(best.clock, sigma_s=float(np.sqrt(variance[6])))
    reason = ""
    move = min(moves, key=lambda each: each.misfit_m, default=None)
    if move is not None:
        reason = move.sentence(name)
    elif best.misfit_m > OTHER_M:
        reason = (
            f"its rays pass {name}'s joints by {100 * best.misfit_m:.0f} cm for any pose and clock: it saw"
            " another person or the other arm, is mirrored, was moved, or its lens is wrong"
        )
    moved_s = None if move is None else move.between_s
    row = RigCamera(camera.name, pose, clock, misfit_m=best.misfit_m, together_s=length_s, reason=reason)
    return replace(row, moved_s=moved_s)


def _placed(first: JointTracks, other: JointTracks, clock: RelativeClock) -> KeypointPlacement | None:
    together = overlap(first, other, clock)
    started = _linear(together)
    if started is None:
        return None
    R, p = started
    covariance, offset = np.eye(7), np.zeros((len(JOINTS), 3))
    for _ in range(STEPS):
        together = overlap(first, other, clock)
        if len(together) < 20:
            return None
        R, p, change, covariance, _ = _step(together, R, p, _pixel(other), offset)
        clock = replace(clock, offset_s=clock.offset_s + float(np.clip(change[6], -0.05, 0.05)))
        offset = offset + change[7:].reshape(-1, 3)
        if np.abs(change[:6]).max() < 1e-4 and abs(change[6]) < 1e-4:
            break
    return KeypointPlacement(R, p, clock, _misfit(together, R, p), covariance[:7, :7], offset)


def _moved(first: JointTracks, other: JointTracks, found: KeypointPlacement) -> Move | None:
    """Whether it stood elsewhere from a time on: each part of what both saw is placed by itself."""
    together = overlap(first, other, found.clock)
    return moved(together, lambda part: _part(part, found, _pixel(other)), OTHER_M)


def _part(
    together: Overlap, whole: KeypointPlacement, pixel_rad: float
) -> tuple[FloatArray, FloatArray, float] | None:
    """A part's turn and shift (6,) where the arm is, against the whole, their variances, and its misfit."""
    if together.both.sum() < 40 or (started := _linear(together)) is None:
        return None
    found = []
    for R, p in ((whole.R, whole.p), started):
        for _ in range(8):
            R, p, _, covariance, centre = _step(together, R, p, pixel_rad, whole.offset_m)
        turn = R @ whole.R.T
        shifted = turn @ (centre - whole.p) + p - centre
        value = np.concatenate([Rotation.from_matrix(turn).as_rotvec(), shifted])
        found.append((value, np.diag(covariance)[:6], _misfit(together, R, p)))
    return min(found, key=lambda each: each[2])


def _pixel(tracks: JointTracks) -> float:
    assert tracks.pixel_rad is not None
    return tracks.pixel_rad


def _linear(together: Overlap) -> tuple[FloatArray, FloatArray] | None:
    """Pose `R_K_C`, origin in {K}, of at least six points in closed form; None where it is no camera's."""
    points, rays = together.first[together.both], together.other[together.both]
    if len(points) < 20:
        return None
    some = slice(None, None, max(len(points) // 3000, 1))
    points, rays = points[some], rays[some]
    centre, scale = points.mean(axis=0), points.std()
    X = np.column_stack([(points - centre) / scale, np.ones(len(points))])
    best = None
    weight = np.ones(len(X))
    for _ in range(4):
        zero = np.zeros_like(X)
        across, down = [X, zero, -rays[:, :1] * X], [zero, X, -rays[:, 1:2] * X]
        rows = np.concatenate([np.concatenate(across, axis=1), np.concatenate(down, axis=1)])
        rows *= np.tile(weight, 2)[:, None]
        P = np.linalg.svd(rows.T @ rows)[2][-1].reshape(3, 4)
        if np.median(X @ P[2]) < 0:
            P = -P
        depth = X @ P[2]
        seen = X @ P[:2].T / np.where(np.abs(depth) > 1e-9, depth, 1e-9)[:, None]
        off = np.linalg.norm(seen - rays[:, :2], axis=1)
        sigma = max(float(np.median(off)), 1e-6)
        weight = 1.0 / (1.0 + (off / (CAUCHY * sigma)) ** 2)
        size = np.cbrt(np.abs(np.linalg.det(P[:, :3])))
        if size < 1e-12 or np.linalg.det(P[:, :3]) < 0:
            continue
        R_C_K = nearest_rotation(P[:, :3])
        t = P[:, 3] / size  # in units of the scale
        best = R_C_K.T, centre - scale * R_C_K.T @ t
    return best


def _step(
    together: Overlap, R: FloatArray, p: FloatArray, pixel_rad: float, offset_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The pose after a robust Gauss-Newton step on turn, shift, clock and offsets, the step, its covariance,
    and the joints' centre.
    """
    rows, joints = np.nonzero(together.both)
    points, rays = together.first[rows, joints] - offset_m[joints], together.other[rows, joints]
    late = together.velocity[rows, joints]
    centre = points.mean(axis=0)
    in_C = (points - p) @ R
    depth = np.maximum(in_C[:, 2], 0.2)
    residual = rays[:, :2] - in_C[:, :2] / depth[:, None]
    # derivative of the projection by the point in {C}, then of that by what is solved
    project = np.zeros((len(points), 2, 3))
    project[:, 0, 0] = project[:, 1, 1] = 1.0 / depth
    project[:, :, 2] = -in_C[:, :2] / depth[:, None] ** 2
    by_point = project @ R.T
    of_joint = np.zeros((len(points), 2, len(JOINTS), 3))
    of_joint[np.arange(len(points)), :, joints] = -by_point
    # a later clock of the other camera shows an earlier joint
    of_pose = by_point @ skew(points - centre), -by_point, by_point @ late[:, :, None]
    columns = np.concatenate([*of_pose, of_joint.reshape(len(points), 2, -1)], axis=2)
    size = np.linalg.norm(residual, axis=1)
    sigma = max(float(np.median(size)) / 1.177, 0.3 * pixel_rad)
    weight = 1.0 / (1.0 + (size / (CAUCHY * sigma)) ** 2) / sigma**2
    weighted = columns * weight[:, None, None]
    information = np.einsum("nij,nik->jk", weighted, columns)
    vectors_of = np.einsum("nij,ni->nj", weighted, residual)
    block = np.floor((together.t[rows] - together.t[0]) / BLOCK_S).astype(int)
    vectors = np.zeros((int(block[-1]) + 1, columns.shape[2]))
    np.add.at(vectors, block, vectors_of)
    vectors -= vectors.mean(axis=0)
    prior = np.diag([1e-6] * 6 + [1.0] + [OFFSET_M**-2] * offset_m.size)
    at = np.concatenate([np.zeros(7), offset_m.ravel()])
    scatter, vector = vectors.T @ vectors, vectors_of.sum(axis=0)
    change, covariance = solved(information, vector, scatter, 1.0, prior, at)
    turn = Rotation.from_rotvec(change[:3]).as_matrix()
    return turn @ R, turn @ (p - centre) + centre + change[3:6], change, covariance, centre


def _misfit(together: Overlap, R: FloatArray, p: FloatArray) -> float:
    """Median distance of the joints from their rays, m."""
    in_C = (together.first[together.both] - p) @ R
    rays = together.other[together.both]
    away = np.linalg.norm(in_C[:, :2] - in_C[:, 2:] * rays[:, :2], axis=1)
    return float(np.median(np.where(in_C[:, 2] > 0.0, away, 10.0)))


def clock_of_known_place(camera: Camera, first: JointTracks) -> tuple[RelativeClock, float]:
    """The clock of a camera whose place is known against another without depth, and the rays' distance, m."""
    assert camera.pose is not None
    ranges = np.arange(-FARTHEST_S, FARTHEST_S + 1e-9, COARSE_S)
    loss = np.array([_ray_distance(camera, first, float(offset), 400) for offset in ranges])
    best = float(ranges[int(np.nanargmin(loss))]) if np.isfinite(loss).any() else 0.0
    for step_s in (0.02, 0.004):
        tries = best + step_s * np.arange(-6, 7)
        fine = np.array([_ray_distance(camera, first, float(offset), 2000) for offset in tries])
        if np.isfinite(fine).any():
            best = float(tries[int(np.nanargmin(fine))])
    # the loss is a parabola near its end
    curve = np.array([_ray_distance(camera, first, best + d, 4000) for d in (-0.02, 0.0, 0.02)])
    bend = curve[0] - 2 * curve[1] + curve[2]
    if np.isfinite(bend) and bend > 0:
        best += float(np.clip(0.5 * (curve[0] - curve[2]) / bend, -1.0, 1.0)) * 0.02
    return RelativeClock(best, sigma_s=0.003), float(_ray_distance(camera, first, best, 4000))


def _ray_distance(camera: Camera, first: JointTracks, offset_s: float, most: int) -> float:
    """Root of the mean capped square distance between rays of the same joints at an offset, m; or nan."""
    together = overlap(first, camera.arm, RelativeClock(offset_s), most)
    if together.length_s < LEAST_S:
        return float("nan")
    assert camera.pose is not None
    a = together.first[together.both]
    b = together.other[together.both] @ camera.pose.R_K_C.T
    normal = np.cross(a, b)
    length = np.linalg.norm(normal, axis=1)
    away = np.abs(normal @ camera.pose.p_K_C_m) / np.maximum(length, 1e-6)
    return float(np.sqrt(np.mean(np.minimum(away, 0.3) ** 2)))
