"""Start values for one camera without depth: the forearm's direction by its IMU, depths by its length.

The forearm lies in the plane of the rays of elbow and wrist: n' Q R a = 0, with n = e x w, the IMU's
attitude R in a frame with z up, that frame's rotation Q to the camera's and the forearm's direction a in
the sensor. Q and a are found on a grid and then by robust Gauss-Newton steps, with the clock; turned half
round the line of sight, with the forearm's direction turned round, both would fit as well: the camera's
rough down decides. Then z_w w - z_e e = l Q R a gives the depths, for a forearm of length l: start
values, whose scale the graph finds with everything else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..errors import SolveError
from ..linalg import sphere, unit
from ..measurements.clock import LARGEST_OFFSET_S
from ..measurements.inertial import InertialAttitude
from ..measurements.segment import AROUND_S, make_segment, traits_of
from ..measurements.timestamps import dejitter, split_at_pauses
from ..recording import JOINTS, JointTracks, Recording
from ..rotation import Rotation
from ..runtime.store import large_array
from .rig import lifted

#: The IMU's heading is taken as constant over this time, s.
BLOCK_S = 40.0
#: Directions and headings that are tried, clock offsets, s, and frames that are looked at.
DIRECTIONS, HEADINGS, FRAMES = 300, 24, 400
OFFSETS_S = np.arange(-0.3, 0.301, 0.1)
#: So many of the best ones are refined.
REFINED, STEPS = 12, 12
#: A keypoint's direction is off by about this, rad; down by this, and the clock by this, s.
RAY_RAD, DOWN_RAD, CLOCK_S = 0.01, np.radians(20.0), 0.15
#: Frames that have to see elbow and wrist.
FEWEST = 60
#: No more of them may see the forearm point the wrong way, and its plane be off by more than this, rad (rms).
WRONG_WAY, OFF_RAD = 0.2, np.radians(20.0)
#: Depths are averaged over this time, s.
SMOOTH_S = 0.7
#: A hand is beyond the wrist by this part of the forearm, and a strap before it.
HAND_PART, STRAP_PART = 0.3, -0.2
#: The upper arm is this many times as long as the forearm.
UPPER_ARM_RATIO = 1.27
#: Shoulders are behind elbows rather than before them: so much of the loss, m, a metre.
BEHIND = 0.1
#: Arms are no nearer or farther, m.
NEAREST_M, FARTHEST_M = 0.4, 12.0

ELBOW, WRIST = JOINTS.index("elbow"), JOINTS.index("wrist")


@dataclass(frozen=True)
class Hypothesis:
    """How the inertial frame stands to the camera, the forearm to the sensor, and the camera's clock."""

    Q: FloatArray  # (3, 3): `R_K_E`
    along_A: FloatArray  # (3,): unit vector elbow to wrist in {A}
    offset_s: float  # t_imu = t_camera + offset
    misfit: float = np.inf  # Mean robust loss


@dataclass(frozen=True)
class RayBlock:
    """Frames of a camera without depth, and the IMU's attitude at their time."""

    rows: IntArray  # int (f,): of the recording's frames
    t: FloatArray  # (f,) s: on the camera's clock
    elbow: FloatArray  # (f, 3): rays
    wrist: FloatArray  # (f, 3): rays
    attitude: InertialAttitude

    @property
    def normal(self) -> FloatArray:
        """Across the plane of both rays, (f, 3), as long as the angle between them."""
        return np.cross(self.elbow, self.wrist)

    @property
    def information(self) -> float:
        """How much the forearm turns in view, over its frames."""
        turned = self.attitude.at(self.t).as_matrix().reshape(-1, 9)
        return float(len(self.t) * turned.std(axis=0).mean())

    def thinned(self) -> RayBlock:
        """At most `FRAMES` of them."""
        some = np.unique(np.linspace(0, len(self.t) - 1, min(len(self.t), FRAMES)).astype(int))
        return RayBlock(self.rows[some], self.t[some], self.elbow[some], self.wrist[some], self.attitude)

    def along_K(self, found: Hypothesis) -> FloatArray:
        """The forearm's direction (f, 3) in the camera's axes."""
        return self.attitude.at(self.t + found.offset_s).apply(found.along_A) @ found.Q.T


def lift_alone(recording: Recording, forearm_m: float) -> Recording:
    """A recording of one camera without depth whose joints have depths to start from."""
    arm, down = recording.arm, traits_of(recording).down
    blocks = list(_blocks(recording))
    if not blocks:
        raise SolveError(
            f"{recording.name}: one camera without depth needs elbow and wrist in view for some seconds while"
            " the IMU measures: nothing else shows how far away the arm is"
        )
    best = max(blocks, key=lambda block: block.information)
    found = _found(best.thinned(), down)
    if found is None:
        raise SolveError(
            f"{recording.name}: the forearm in the image does not turn as the IMU does, so nothing shows how"
            " far away it is: check that keypoints and IMU are of the same arm and time, that --intrinsics"
            " are this camera's, and that the arm turns in view"
        )
    depth = np.full(arm.state.shape, np.nan)
    along = np.full((len(arm), 3), np.nan)
    for block in blocks:
        own = found if block is best else _turned_to(block.thinned(), found)
        direction = block.along_K(own)
        along[block.rows] = direction
        depth[block.rows, ELBOW] = _elbow_depth(block, direction, forearm_m)
    t = np.asarray(arm.t_s)
    known = np.flatnonzero(np.isfinite(depth[:, ELBOW]))
    z = np.interp(t, t[known], depth[known, ELBOW])
    forward = forearm_m * np.interp(t, t[known], along[known, 2])
    depth[:, ELBOW], depth[:, WRIST] = z, z + forward
    depth[:, JOINTS.index("hand")] = z + (1.0 + HAND_PART) * forward
    depth[:, JOINTS.index("strap")] = z + (1.0 + STRAP_PART) * forward
    depth[:, JOINTS.index("shoulder")] = _shoulder_depth(arm, z, UPPER_ARM_RATIO * forearm_m)
    points = lifted(arm, np.clip(depth, NEAREST_M, FARTHEST_M))
    position = large_array(points.position.shape)
    position[:] = points.position
    return replace(recording, arm=replace(points, position=position), cameras=())


def _blocks(recording: Recording) -> Iterator[RayBlock]:
    """The recording in blocks in which elbow and wrist are seen."""
    traits, arm, imu = traits_of(recording), recording.arm, recording.imu
    arm_t = np.asarray(arm.t_s)
    for samples in split_at_pauses(imu):
        start_s, end_s = float(imu.t_s[samples.start]), float(imu.t_s[samples.stop - 1])
        even_t = dejitter(np.asarray(imu.t_s[samples]))
        count = max(round((end_s - start_s) / BLOCK_S), 1)
        edges = np.linspace(start_s, end_s, count + 1)
        for first_s, last_s in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            rows = np.searchsorted(even_t, [first_s - AROUND_S, last_s + AROUND_S])
            own = slice(samples.start + int(rows[0]), samples.start + int(rows[1]))
            frames = slice(*np.searchsorted(arm_t, [first_s, last_s]).tolist())
            if own.stop - own.start < FEWEST or frames.stop - frames.start < FEWEST:
                continue
            segment = make_segment(
                imu.select(own), even_t[slice(*rows.tolist())], arm.select(frames), frames, traits
            )
            if segment is None:
                continue
            t = segment.frame_t_camera
            first, last = segment.signal.start_s + LARGEST_OFFSET_S, segment.signal.end_s - LARGEST_OFFSET_S
            accepted = segment.accepted[:, ELBOW] & segment.accepted[:, WRIST]
            both = np.flatnonzero(accepted & (t > first) & (t < last))
            if len(both) >= FEWEST:
                position, frame = np.asarray(segment.position)[both], both + segment.frames.start
                rays = position[:, ELBOW], position[:, WRIST]
                yield RayBlock(frame, t[both], *rays, segment.attitude)


def _upright(down: FloatArray) -> FloatArray:
    """Some rotation (3, 3) that takes z up to the camera's up; the usual camera's where nothing is known."""
    up = -unit(down) if np.linalg.norm(down) > 0.5 else np.array([0.0, -1.0, 0.0])
    aside = unit(np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0]))
    return np.stack([aside, np.cross(up, aside), up], axis=1)


def _found(block: RayBlock, down: FloatArray) -> Hypothesis | None:
    """The likeliest of all hypotheses; None where none fits."""
    level, normal = _upright(down), block.normal
    directions = sphere(DIRECTIONS)
    headings = 2 * np.pi * np.arange(HEADINGS) / HEADINGS
    cos, sin = np.cos(headings)[:, None, None], np.sin(headings)[:, None, None]
    m = normal @ level  # in the inertial frame's axes, but for the heading
    across = m[:, :2]
    tries: list[tuple[float, Hypothesis]] = []
    for offset_s in OFFSETS_S.tolist():
        R = block.attitude.at(block.t + offset_s).as_matrix()
        u = np.einsum("tij,dj->tdi", R, directions)
        along_m = np.einsum("ti,tdi->td", across, u[..., :2])
        turned = across[:, None, 1] * u[..., 0] - across[:, None, 0] * u[..., 1]
        off = m[:, 2, None] * u[..., 2] + cos * along_m + sin * turned  # (heading, frame, direction)
        loss = np.mean(np.log1p((off / (5 * RAY_RAD)) ** 2), axis=1)
        for k in np.argsort(loss, axis=None)[:REFINED].tolist():
            heading, direction = np.unravel_index(k, loss.shape)
            Q = level @ Rotation.from_rotvec(np.array([0.0, 0.0, headings[heading]])).as_matrix()
            for sign in (1.0, -1.0):
                tries.append((float(loss.flat[k]), Hypothesis(Q, sign * directions[direction], offset_s)))
    tries.sort(key=lambda each: each[0])
    likely = [each for _, each in tries if _wrong_way(block, each) < 0.4][: 4 * REFINED]
    refined = [_refined(block, each, down, True) for each in likely]

    def fits(one: Hypothesis) -> bool:
        # as an angle, rms; frames in which the forearm looks long count more
        off = np.sqrt(np.sum(_coplanarity(block, one) ** 2) / np.sum(normal**2))
        return bool(off < OFF_RAD) and _wrong_way(block, one) < WRONG_WAY

    fitting = [each for each in refined if fits(each)]
    return min(fitting, key=lambda each: each.misfit, default=None)


def _turned_to(block: RayBlock, found: Hypothesis) -> Hypothesis:
    """The same mounting and clock with another block's heading."""
    tries = []
    for heading in (2 * np.pi * np.arange(HEADINGS) / HEADINGS).tolist():
        Q = found.Q @ Rotation.from_rotvec(np.array([0.0, 0.0, heading])).as_matrix()
        one = replace(found, Q=Q)
        loss = float(np.mean(np.log1p((_coplanarity(block, one) / (5 * RAY_RAD)) ** 2)))
        tries.append((loss + 2.0 * _wrong_way(block, one), one))
    return _refined(block, min(tries, key=lambda each: each[0])[1], np.zeros(3), False)


def _coplanarity(block: RayBlock, one: Hypothesis) -> FloatArray:
    """How far the forearm is out of the plane of its rays, (f,): its sine times the angle between them."""
    return np.asarray(np.sum(block.normal * block.along_K(one), axis=1))


def _wrong_way(block: RayBlock, one: Hypothesis) -> float:
    """Share of frames, by how long the forearm looks, in which elbow and wrist would be exchanged."""
    towards = np.sum(np.cross(block.along_K(one), block.elbow) * -block.normal, axis=1)
    size = np.linalg.norm(block.normal, axis=1)
    return float(np.sum(size[towards < 0]) / np.sum(size))


def _refined(block: RayBlock, one: Hypothesis, down: FloatArray, with_mounting: bool) -> Hypothesis:
    """Robust Gauss-Newton steps on turn, the forearm's direction and the clock."""
    has_down = bool(np.linalg.norm(down) > 0.5)

    def changed(x: FloatArray) -> Hypothesis:
        Q = Rotation.from_rotvec(x[:3]).as_matrix() @ one.Q
        if not with_mounting:
            return replace(one, Q=Q)
        basis = np.linalg.svd(one.along_A[None])[2][1:]
        return Hypothesis(Q, unit(one.along_A + x[3:5] @ basis), one.offset_s + float(x[5]))

    def residual(x: FloatArray) -> FloatArray:
        at = changed(x)
        rows = [_coplanarity(block, at) / RAY_RAD]
        if has_down:
            rows.append((at.Q @ np.array([0.0, 0.0, -1.0]) - unit(down)) / DOWN_RAD)
        if with_mounting:
            rows.append(np.array([at.offset_s / CLOCK_S]))
        return np.concatenate(rows)

    size, frames, step = (6 if with_mounting else 3), len(block.t), 1e-4
    damping = 1e-3
    for _ in range(STEPS):
        r = residual(np.zeros(size))
        J = np.stack([(residual(step * np.eye(size)[k]) - r) / step for k in range(size)], axis=1)
        weight = np.ones(len(r))
        scale = max(float(np.median(np.abs(r[:frames]))) * 1.48, 1.0)
        weight[:frames] = 1.0 / (1.0 + (r[:frames] / (2.0 * scale)) ** 2) / scale**2
        normal = J.T @ (weight[:, None] * J)
        damped = normal + damping * np.diag(np.diag(normal)) + 1e-9 * np.eye(size)
        x = np.asarray(-np.linalg.solve(damped, J.T @ (weight * r)), float)
        x[:3] *= min(1.0, 0.4 / max(float(np.linalg.norm(x[:3])), 1e-12))
        if with_mounting:
            x[3:5] *= min(1.0, 0.4 / max(float(np.linalg.norm(x[3:5])), 1e-12))
            x[5] = np.clip(one.offset_s + x[5], -LARGEST_OFFSET_S, LARGEST_OFFSET_S) - one.offset_s
        one = changed(x)
        if np.abs(x).max() < 1e-4:
            break
    r = residual(np.zeros(size))
    loss = float(np.mean(np.log1p((r[:frames] / 2.0) ** 2)))
    return replace(one, misfit=loss + float(np.sum(r[frames:] ** 2)) / frames)


def _elbow_depth(block: RayBlock, along_K: FloatArray, forearm_m: float) -> FloatArray:
    """The elbow's depth (f,) m: z_e (w - e) = l (d - d_z w), averaged over some time."""
    seen = (block.wrist - block.elbow)[:, :2]
    wanted = forearm_m * (along_K[:, :2] - along_K[:, 2:] * block.wrist[:, :2])
    weight, value = np.sum(seen**2, axis=1), np.sum(seen * wanted, axis=1)
    usual = float(np.clip(np.sum(value) / np.sum(weight), NEAREST_M, FARTHEST_M))
    away = np.abs(value - usual * weight) / np.maximum(np.sqrt(weight), 1e-6)
    trust = 1.0 / (1.0 + (away / (3.0 * max(float(np.median(away)), 1e-3))) ** 2)
    weight, value = weight * trust, value * trust
    lo, hi = np.searchsorted(block.t, [block.t - SMOOTH_S, block.t + SMOOTH_S])
    totals = (np.concatenate([[0.0], np.cumsum(x)]) for x in (value, weight))
    values, weights = ((total[hi] - total[lo]) / np.maximum(hi - lo, 1) for total in totals)
    # where the forearm points at the camera the mean says more
    mean = 0.2 * float(np.mean(weight))
    return np.asarray((values + mean * usual) / (weights + mean))


def _shoulder_depth(arm: JointTracks, elbow_depth: FloatArray, upper_arm_m: float) -> FloatArray:
    """The shoulder's depth (F,) m: one over the mean of the elbow's where the upper arm keeps its length."""
    both = np.flatnonzero(arm.tracked("shoulder") & arm.tracked("elbow"))
    usual = float(np.median(elbow_depth))
    if len(both) < FEWEST:
        return np.full(len(arm), usual)
    both = both[np.unique(np.linspace(0, len(both) - 1, min(len(both), 2 * FRAMES)).astype(int))]
    shoulder, elbow = arm.joint("shoulder")[both], arm.joint("elbow")[both] * elbow_depth[both, None]
    tries = usual + np.arange(-0.4, 0.61, 0.02)
    length = np.linalg.norm(tries[:, None, None] * shoulder - elbow, axis=2)
    loss = np.mean(np.minimum(np.abs(length - upper_arm_m), 0.1), axis=1)
    loss += BEHIND * np.maximum(usual - tries, 0.0)
    return np.full(len(arm), tries[int(np.argmin(loss))])
