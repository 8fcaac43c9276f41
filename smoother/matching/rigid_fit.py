"""Our own measure of a pair: can this IMU be strapped to this limb?

A strap fixes the limb's direction in the IMU's axes, d_A, and the rotation between the IMU's level frame
and the camera's, R, holds for some seconds. If the IMU is on the limb, then at all times

    direction in {K} = R R_E_A d_A,    acceleration in {K} = R (acceleration in {E}),

with the same R and d_A. Both are solved in turn (Wahba's problem, SIAM Review 1965, for R; a mean for d_A)
from sums of products over the excerpt, at every shift of the clocks, so that neither calibration, nor
heading, nor common clock is needed. The evidence compares what is left with what a limb that only keeps its
mean direction and does not accelerate would leave: half the independent samples times the log of the ratio
of mean squares, as for Gaussian errors of unknown size, with floors that the camera's noise sets.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..array_types import FloatArray
from ..linalg import nearest_rotation, unit
from .excerpt_motion import (
    GRID_HZ,
    LOW_PASS_HZ,
    SHORTEST_S,
    ImuMotion,
    LimbMotion,
    MatchExcerpt,
    independent_samples,
)

#: What remains of a joint's noise after the low-pass: of a direction, rad, and an acceleration, m/s^2, an
#: axis.
DIRECTION_SIGMA, ACCELERATION_SIGMA = 0.06, 0.5
#: What mounting, soft tissue and stamps spoil, as a part of the motion.
SPOILT = 0.3
#: The camera's gravity is known to about this, rad; it is treated as one more vector.
GRAVITY_SIGMA = 0.15
#: Shifts are tried in steps of this many grid steps, then all near the best few.
COARSE_STEPS, BEST_SHIFTS = 4, 3
_FIRST_DIRECTIONS = unit(np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)]))
_AXES = _FIRST_DIRECTIONS[np.abs(_FIRST_DIRECTIONS).max(axis=1) > 0.99]


@dataclass
class _Sums:
    """Sums over one excerpt's samples for m limbs at L shifts."""

    turn: FloatArray
    force: FloatArray
    shape: FloatArray
    mean: FloatArray
    directions: FloatArray
    direction_count: FloatArray
    accelerations: FloatArray
    forces: FloatArray
    force_count: FloatArray


def _sums(limbs: list[LimbMotion], imu: ImuMotion, shifts: np.ndarray) -> _Sums:
    """All sums at shifts (L,), counted from the IMU's first grid time."""
    m, n, L = len(limbs), len(limbs[0].direction), len(shifts)
    rows = shifts[:, None] + np.arange(n)
    there = imu.there[rows].astype(float)
    turn = imu.R_E_A.reshape(-1, 9)[rows].transpose(0, 2, 1)  # (L, 9, n), zero where there is none
    force = imu.acceleration[rows].transpose(0, 2, 1)
    direction = np.stack([limb.direction for limb in limbs], axis=1)  # (n, m, 3), zero where not seen
    acceleration = np.stack([limb.acceleration for limb in limbs], axis=1)
    has_direction = np.stack([limb.has_direction for limb in limbs], axis=1).astype(float)
    has_point = np.stack([limb.has_point for limb in limbs], axis=1).astype(float)
    squares = np.einsum("nba,nbc->nac", imu.R_E_A, imu.R_E_A).reshape(-1, 9)
    lengths = (imu.acceleration**2).sum(axis=1)
    return _Sums(
        (turn @ direction.reshape(n, -1)).reshape(L, 3, 3, m, 3).transpose(3, 0, 4, 1, 2),
        (force @ acceleration.reshape(n, -1)).reshape(L, 3, m, 3).transpose(2, 0, 3, 1),
        (squares[rows].transpose(0, 2, 1) @ has_direction).reshape(L, 3, 3, m).transpose(3, 0, 1, 2),
        (there @ direction.reshape(n, -1)).reshape(L, m, 3).transpose(1, 0, 2),
        (there @ (direction**2).sum(axis=2)).T,
        (there @ has_direction).T,
        (there @ (acceleration**2).sum(axis=2)).T,
        (lengths[rows] @ has_point).T,
        (there @ has_point).T,
    )


def _solve(
    turn: FloatArray, linear: FloatArray, first: FloatArray, rounds: int
) -> tuple[FloatArray, FloatArray]:
    """R (..., E, 3, 3) of each excerpt and the common d_A (..., 3) that fit best."""
    d = np.broadcast_to(first, (*turn.shape[:-4], len(first), 3))
    for _ in range(rounds):
        B = np.einsum("...eabc,...kc->...keab", turn, d) + linear[..., None, :, :, :]
        R = nearest_rotation(B)
        pull = np.einsum("...eabc,...keab->...kc", turn, R)
        length = np.linalg.norm(pull, axis=-1, keepdims=True)
        d = np.where(length > 1e-9, pull / np.maximum(length, 1e-9), d)
    fit = (d * pull).sum(axis=-1) + np.einsum("...eab,...keab->...k", linear, R)
    best = np.argmax(fit, axis=-1)
    take = np.expand_dims(best, axis=-1)
    return (
        np.take_along_axis(R, take[..., None, None, None], axis=-4)[..., 0, :, :, :],
        np.take_along_axis(d, take[..., None], axis=-2)[..., 0, :],
    )


def _evidence(sums: list[_Sums], down: FloatArray | None, first: FloatArray, rounds: int) -> FloatArray:
    """(m, L) log-likelihood ratio of `on this limb` against `on none`."""

    def gathered(name: str) -> FloatArray:
        return np.stack([getattr(one, name) for one in sums], axis=2)  # (m, L, E, ..)

    turn, force = gathered("turn"), gathered("force")
    weight = (DIRECTION_SIGMA / ACCELERATION_SIGMA) ** 2
    linear = weight * force
    if down is not None:
        # one vector more for each independent sample's worth of data
        strength = (DIRECTION_SIGMA / GRAVITY_SIGMA) ** 2 * GRID_HZ / (2 * LOW_PASS_HZ)
        linear = linear + strength * np.outer(-down, [0.0, 0.0, 1.0])
    R, d = _solve(turn, linear, first, rounds)
    directions, mean, counted = gathered("directions"), gathered("mean"), gathered("direction_count")
    shape, count, force_count = gathered("shape"), counted.sum(axis=2), gathered("force_count").sum(axis=2)
    kept = (mean**2).sum(axis=-1) / np.maximum(counted, 1.0)
    still = (directions - kept).sum(axis=2)
    match = directions.sum(axis=2) + np.einsum("mla,mleab,mlb->ml", d, shape, d)
    match -= 2 * np.einsum("mleabc,mleab,mlc->ml", turn, R, d)
    evidence = _log_ratio(still, match, count, 2, DIRECTION_SIGMA)
    accelerations = gathered("accelerations").sum(axis=2)
    left = accelerations + gathered("forces").sum(axis=2) - 2 * np.einsum("mleab,mleab->ml", R, force)
    return evidence + _log_ratio(accelerations, left, force_count, 3, ACCELERATION_SIGMA)


def _log_ratio(none: FloatArray, match: FloatArray, count: FloatArray, axes: int, sigma: float) -> FloatArray:
    """Half the independent values times the log of the ratio of mean squares."""
    number = np.maximum(count, 1.0)
    none, match, floor = none / number, np.maximum(match, 0.0) / number, axes * sigma**2
    ratio = ((1 + SPOILT**2) * none + floor) / (match + SPOILT**2 * none + floor)
    return np.asarray(0.5 * axes * independent_samples(count) * np.log(ratio))


def rigid_evidence(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:  # evidence (m,), shift (m,) s
    """Evidence that an IMU is on each limb, at the best shift of its clock."""
    reach = excerpts[0].reach
    limbs = len(excerpts[0].limbs)
    coarse = np.arange(reach % COARSE_STEPS, 2 * reach + 1, COARSE_STEPS)
    few = sorted(excerpts, key=lambda one: -_energy(one))[:4]
    rough = _at(few, imu, coarse, down, _AXES, 3) * (len(excerpts) / len(few)) - shift_cost[coarse]
    evidence, best = np.zeros(limbs), np.full(limbs, reach)
    for limb in range(limbs):
        near = coarse[np.argsort(-rough[limb])[:BEST_SHIFTS]]
        fine = np.unique(np.clip(near[:, None] + np.arange(1 - COARSE_STEPS, COARSE_STEPS), 0, 2 * reach))
        value = _at(excerpts, imu, fine, down, _FIRST_DIRECTIONS, 5, [limb])[0]
        if not np.isfinite(value).any():
            continue
        cost = value - shift_cost[fine]
        k = int(np.argmax(cost))
        evidence[limb], best[limb] = cost[k], fine[k]
    return evidence, (best - reach) / GRID_HZ


def _at(
    excerpts: list[MatchExcerpt],
    imu: int,
    shifts: np.ndarray,
    down: FloatArray | None,
    first: FloatArray,
    rounds: int,
    limbs: list[int] | None = None,
) -> FloatArray:
    """(m, L) evidence at shifts; -inf where less than a second is shared."""
    chosen = range(len(excerpts[0].limbs)) if limbs is None else limbs
    sums = [_sums([one.limbs[k] for k in chosen], one.imus[imu], shifts) for one in excerpts]
    shared = sum(np.maximum(one.direction_count, one.force_count) for one in sums)
    return np.where(shared >= SHORTEST_S * GRID_HZ, _evidence(sums, down, first, rounds), -np.inf)


def _energy(excerpt: MatchExcerpt) -> float:
    """How much the limbs move in an excerpt."""
    return sum(float((limb.acceleration**2).sum()) for limb in excerpt.limbs)
