"""Rejects camera samples that are marked as tracked and are wrong, and keeps the reason.

By what the camera alone says (frozen, interpolated, jump, bone length), by what the inertial attitude says
(Jatesiktat and Ang 2017, II-J: direction, viewing ray, strap), and by what a first solution leaves
(residual).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..calibration import ArmCalibration
from ..filters import moving_median
from ..linalg import runs, unit
from ..recording import JOINTS
from .alignment import Alignment, align, pairs
from .clock import Clock
from .rays import across
from .segment import Segment
from .visibility import Rejection


@dataclass(frozen=True)
class JointNoise:
    """Noise of a joint's samples, one standard deviation of each axis."""

    sample_m: float  # Of one sample
    # Of a white noise with the same long-run variance, which a graph of independent samples needs
    effective_m: float
    memory_m: float  # The part that neighbours share


def noise_key(joint: str, camera: int = 0) -> str:
    """What a joint's samples by one camera are called: its name where that is the first."""
    return joint if camera == 0 else f"{joint}@{camera}"


#: A fourth difference is treated as none below this part of the joint's usual one, and of the step from
#: sample to sample: cameras that smooth (Kinect v1) are nearly free of noise where an arm rests, not where it
#: moves.
PART, PART_OF_STEP = 0.02, 0.01
#: This many in a row are not a coincidence.
IN_A_ROW = 4
#: Samples that the fourth difference is made of.
STENCIL = 5
#: Stencils that reach farther than this, in usual ones, are left out.
LONGEST = 1.5
#: A joint whose usual fourth difference is smaller has no noise to tell by, m.
NOISELESS_M = 1e-5


def interpolated(t_s: FloatArray, position: FloatArray, accepted: BoolArray) -> BoolArray:
    """Samples (f,) of one joint, at positions (f, 3) m, that were filled in."""
    filled = np.zeros(len(t_s), dtype=bool)
    rows = np.flatnonzero(accepted)
    if len(rows) < 4 * STENCIL:
        return filled
    x, t = position[rows], t_s[rows]
    step = np.linalg.norm(np.diff(x, axis=0), axis=1)
    usual_step = sliding_window_view(step, STENCIL - 1).mean(axis=1)
    reach = t[STENCIL - 1 :] - t[: 1 - STENCIL]
    broken = reach > LONGEST * np.median(reach)  # over a gap a difference by time is small for its own reason
    by_time = x  # for uneven times: divided differences at the usual spacing
    for order in range(1, STENCIL):
        spans = (t[order:] - t[:-order]) / (order * float(np.median(np.diff(t))))
        by_time = np.diff(by_time, axis=0) / spans[:, None]
    for difference in (np.diff(x, STENCIL - 1, axis=0), by_time):
        size = np.where(broken, np.inf, np.abs(difference).max(axis=1))
        usual = float(np.median(size))
        if usual < NOISELESS_M:
            continue
        for run in runs(np.asarray(size < np.minimum(PART * usual, PART_OF_STEP * usual_step))):
            first, last = run.start, run.stop + STENCIL - 2  # samples on the polynomial, both ends its own
            if run.stop - run.start >= IN_A_ROW:
                filled[rows[first + 1 : last]] = True
    return filled


#: No depth camera sees a person farther away, m.
FARTHEST_M = 20.0
#: A value that repeats exactly this often is frozen, if the sensor turns or is moved meanwhile.
FROZEN_REPEATS = 2
FROZEN_RATE = 0.15
FROZEN_FORCE = 0.5
#: Farther than this from the median of seven neighbours is a jump, m.
JUMP_M = 0.15
JUMP_FRAMES = 7
BONE_PART = 0.30
DIRECTION_DEG = 30.0
RAY_DEG = 15.0
RAY_BONE_PART = 0.15
RAY_DIRECTION_DEG = 15.0
STRAP_M = 0.05
#: A residual longer than this (m, and in deviations of a sample) is rejected.
RESIDUAL_M = 0.05
RESIDUAL_SIGMAS = 5.0

ELBOW, WRIST, HAND, STRAP_COLUMN = (JOINTS.index(joint) for joint in ("elbow", "wrist", "hand", "strap"))
_FOREARM = [ELBOW, WRIST, HAND]


def reject_by_camera(segment: Segment) -> Segment:
    """Reject what is wrong by the camera's samples alone: far, frozen, filled in, jump, bone length,
    strap.
    """
    if segment.camera is None:
        return _reject_by_one_camera(segment)
    accepted, reason, origins = segment.accepted.copy(), segment.reason.copy(), segment.ray_origin_m
    for number in np.unique(segment.camera):
        own = segment.camera == number
        origin = None if origins is None else origins[number][None]
        alone = replace(segment.of_frames(own), camera=None, ray_origin_m=origin)
        alone = _reject_by_one_camera(alone)
        accepted[own], reason[own] = alone.accepted, alone.reason
    return replace(segment, accepted=accepted, reason=reason)


def _reject_by_one_camera(segment: Segment) -> Segment:
    with np.errstate(over="ignore", invalid="ignore"):
        segment = _reject(segment, np.linalg.norm(segment.position, axis=2) > FARTHEST_M, Rejection.FAR)
    for why, test in (
        (Rejection.FROZEN, _frozen),
        (Rejection.INTERPOLATED, _filled),
        (Rejection.JUMP, _jumps),
    ):
        wrong = np.stack([test(segment, column) for column in range(len(JOINTS))], axis=1)
        segment = _reject(segment, wrong, why)
    if segment.ray_origin_m is not None and np.isfinite(segment.ray_origin_m).all():
        return segment  # lengths on rays are what their depths were made of
    both = segment.accepted[:, ELBOW] & segment.accepted[:, WRIST]
    elbow, wrist, strap = (segment.position[:, column] for column in (ELBOW, WRIST, STRAP_COLUMN))
    length = np.linalg.norm(wrist - elbow, axis=1)
    if both.sum() >= 10:
        usual = float(np.median(length[both]))
        wrong = both & (np.abs(length - usual) > BONE_PART * usual)
        segment = _reject(segment, _only(wrong, ELBOW, WRIST), Rejection.BONE)
    # a strap that is off the line from elbow to wrist, or nearer the elbow
    along = unit(wrist - elbow)
    at = np.sum((strap - elbow) * along, axis=1)
    off = (np.linalg.norm(strap - elbow - at[:, None] * along, axis=1) > STRAP_M) | (at < 0.5 * length)
    both &= segment.accepted[:, STRAP_COLUMN] & off
    return _reject(segment, _only(both, STRAP_COLUMN), Rejection.STRAP)


def reject_by_attitude(
    segment: Segment, frame_t_imu: FloatArray, alignment: Alignment, along_A: FloatArray
) -> Segment:
    """Reject frames whose forearm does not point where the inertial attitude says.

    Source: Jatesiktat and Ang (2017), II-J.
    """
    both = segment.accepted[:, ELBOW] & segment.accepted[:, WRIST]
    if not both.any():
        return segment
    both &= segment.with_depth[:, ELBOW] & segment.with_depth[:, WRIST]
    inertial = (alignment.at(frame_t_imu) * segment.attitude.at(frame_t_imu)).apply(along_A)
    by_camera = unit(segment.position[:, WRIST] - segment.position[:, ELBOW])
    ray = unit(segment.position[:, WRIST] + segment.position[:, ELBOW])
    off = both & (np.sum(by_camera * inertial, axis=1) < np.cos(np.radians(DIRECTION_DEG)))
    segment = _reject(segment, _only(off, *_FOREARM), Rejection.DIRECTION)
    # pointing at the camera is not a reason by itself: the forearm must also look wrong
    pointing = both & (np.abs(np.sum(ray * inertial, axis=1)) > np.cos(np.radians(RAY_DEG)))
    length = np.linalg.norm(segment.position[:, WRIST] - segment.position[:, ELBOW], axis=1)
    usual = float(np.median(length[both]))
    short = np.abs(length - usual) > RAY_BONE_PART * usual
    turned = np.sum(by_camera * inertial, axis=1) < np.cos(np.radians(RAY_DIRECTION_DEG))
    pointing &= short | turned
    return _reject(segment, _only(pointing, *_FOREARM), Rejection.RAY)


def reject_by_residual(segment: Segment, residual: FloatArray, noise: dict[str, JointNoise]) -> Segment:
    """Reject samples far from a first solution, by residuals (f, 5, 3) m."""
    length = np.linalg.norm(across(residual, segment.position, segment.frame_origins), axis=2)
    numbers = np.zeros(1, int) if segment.camera is None else np.asarray(segment.camera).astype(int)
    sigma_m = np.full((int(numbers.max(initial=0)) + 1, len(JOINTS)), np.inf)
    for camera, column in np.ndindex(sigma_m.shape):
        if (own := noise.get(noise_key(JOINTS[column], camera))) is not None:
            sigma_m[camera, column] = own.sample_m
    limit = np.maximum(RESIDUAL_M, RESIDUAL_SIGMAS * sigma_m)[numbers]
    with np.errstate(invalid="ignore"):
        return _reject(segment, length > limit, Rejection.RESIDUAL)


def _reject(segment: Segment, wrong: BoolArray, why: Rejection) -> Segment:
    """The segment without the wrong samples (f, 5), the reason noted for those that were accepted."""
    wrong = wrong & segment.accepted
    if not wrong.any():
        return segment
    reason = np.where(wrong, np.uint8(why), segment.reason)
    return replace(segment, accepted=segment.accepted & ~wrong, reason=reason)


def _only(frames: BoolArray, *columns: int) -> BoolArray:
    wrong = np.zeros((len(frames), len(JOINTS)), dtype=bool)
    for column in columns:
        wrong[:, column] = frames
    return wrong


def _frozen(segment: Segment, column: int) -> BoolArray:
    """Frames that repeat the one before, in runs of repeats during which the sensor moved."""
    x, accepted = segment.position[:, column], segment.accepted[:, column]
    same = np.zeros(len(x), dtype=bool)
    same[1:] = accepted[1:] & accepted[:-1] & (x[1:] == x[:-1]).all(axis=1)
    frozen = np.zeros(len(x), dtype=bool)
    for rows in runs(same):
        start_s, end_s = segment.frame_t_camera[rows.start - 1], segment.frame_t_camera[rows.stop - 1]
        if rows.stop - rows.start >= FROZEN_REPEATS and _moved(segment, start_s, end_s):
            frozen[rows] = True
    return frozen


def _moved(segment: Segment, start_s: float, end_s: float) -> bool:
    """Whether the sensor turned or was moved between two times."""
    edges = np.linspace(start_s, max(end_s, start_s + 0.05), 12)
    rate = segment.signal.mean(edges[:-1], edges[1:])
    turning = float(np.linalg.norm(rate[:, 3:] - segment.attitude.gyroscope_bias, axis=1).max())
    return turning > FROZEN_RATE or float(np.ptp(np.linalg.norm(rate[:, :3], axis=1))) > FROZEN_FORCE


def _filled(segment: Segment, column: int) -> BoolArray:
    return interpolated(segment.frame_t_camera, segment.position[:, column], segment.accepted[:, column])


def _jumps(segment: Segment, column: int) -> BoolArray:
    """Samples far from the running median of the accepted ones, near in time."""
    rows = np.flatnonzero(segment.accepted[:, column])
    wrong = np.zeros(len(segment.accepted), dtype=bool)
    if len(rows) < JUMP_FRAMES:
        return wrong
    x = segment.position[rows, column]
    middle = moving_median(x, JUMP_FRAMES)
    half = JUMP_FRAMES // 2
    t = segment.frame_t_camera[rows]
    spread = np.full(len(rows), np.inf)
    spread[half:-half] = t[2 * half :] - t[: -2 * half]
    usual = float(np.median(np.diff(t))) * (JUMP_FRAMES - 1)
    wrong[rows] = (np.linalg.norm(x - middle, axis=1) > JUMP_M) & (spread < 1.7 * usual)
    return wrong


def reject_by_direction(
    segment: Segment, calibration: ArmCalibration, clock: Clock
) -> tuple[Segment, Alignment | None]:
    """Reject the frames whose forearm does not point where the inertial attitude says."""
    along_A = calibration.forearm_direction
    if along_A is None:
        return segment, None
    frame_t = segment.frame_t_imu(clock)
    vectors = pairs(segment, frame_t, segment.with_depth, calibration)
    if not vectors:
        return segment, None
    alignment = align(vectors, segment.start_s, segment.end_s, segment.down)
    inlier = reject_by_attitude(segment, frame_t, alignment, along_A)
    return inlier, alignment if inlier is segment else None
