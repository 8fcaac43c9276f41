"""Our own measure of a pair: can this IMU be strapped to this limb?

If it is, the limb's direction in the IMU's axes and the rotation between the IMU's level frame and the
camera's hold for some seconds, and both are fitted (`measurements.rigid`) at every shift of the clocks, so
that neither calibration, nor heading, nor common clock is needed. The evidence compares what is left with
what a limb that only keeps its mean direction and does not accelerate would leave: half the independent
samples times the log of the ratio of mean squares, as for Gaussian errors of unknown size, with floors that
the camera's noise sets.
"""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray, IntArray
from ..measurements.rigid import GRID_HZ, best_fits, correlation
from .excerpt_motion import SHORTEST_S, ImuMotion, LimbMotion, MatchExcerpt

#: What remains of a joint's noise after smoothing: of a direction, rad, and an acceleration, m/s^2, an axis.
DIRECTION_SIGMA, ACCELERATION_SIGMA = 0.06, 0.5
#: How much an acceleration counts against a direction.
WEIGHT = (DIRECTION_SIGMA / ACCELERATION_SIGMA) ** 2
#: Gravity in the camera's frame, known to about 0.15 rad, weighs as much as 6 samples of a direction.
GRAVITY_PULL = 6.25 * (DIRECTION_SIGMA / 0.15) ** 2
#: What mounting, soft tissue and stamps spoil, as a part of the motion.
SPOILT = 0.3
#: Independent samples a second, as joints' errors have a memory; and of however many, no more than this many
#: count, as joints' constant errors and the strap's slip do not average out.
INDEPENDENT_HZ, MOST_INDEPENDENT = 2.0, 20.0
#: The search over shifts: coarse step, in grid steps, and how many of the best are refined; rounds of both.
COARSE_STEPS, BEST_SHIFTS = 4, 3
COARSE_ROUNDS, FINE_ROUNDS = 3, 8


def rigid_evidence(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:  # evidence (m,), shift (m,) s
    """Evidence that an IMU is on each limb, at the best shift of its clock."""
    reach = excerpts[0].reach
    limbs = len(excerpts[0].limbs)
    pull = GRAVITY_PULL * np.outer(np.zeros(3) if down is None else -down, [0.0, 0.0, 1.0])
    coarse = np.arange(reach % COARSE_STEPS, 2 * reach + 1, COARSE_STEPS)
    evidence, best = np.zeros(limbs), np.full(limbs, reach)
    for limb in range(limbs):
        moments = [_Moments(one.limbs[limb], one.imus[imu]) for one in excerpts]
        rough = _evidence(moments, coarse, pull, COARSE_ROUNDS) - shift_cost[coarse]
        near = coarse[np.argsort(-rough)[:BEST_SHIFTS]]
        fine = np.unique(np.clip(near[:, None] + np.arange(1 - COARSE_STEPS, COARSE_STEPS), 0, 2 * reach))
        value = _evidence(moments, fine, pull, FINE_ROUNDS) - shift_cost[fine]
        if np.isfinite(value).any():
            k = int(np.argmax(value))
            evidence[limb], best[limb] = value[k], fine[k]
    return evidence, (best - reach) / GRID_HZ


class _Moments:
    """Sums over an excerpt's samples at every shift, counted from the IMU's first grid time."""

    def __init__(self, limb: LimbMotion, imu: ImuMotion) -> None:
        def shifted(x: FloatArray, y: FloatArray) -> FloatArray:
            return correlation(x, y)[len(x) - 1 : len(y)]

        seen, shown = (known[:, None].astype(float) for known in (limb.has_direction, limb.has_point))
        there = imu.there[:, None].astype(float)
        gram = np.einsum("nba,nbc->nac", imu.R_E_A, imu.R_E_A).reshape(-1, 9)
        self.T = shifted(limb.direction, imu.R_E_A.reshape(-1, 9)).reshape(-1, 3, 3, 3)
        self.F = WEIGHT * shifted(limb.acceleration, imu.acceleration)
        self.C = shifted(seen, gram).reshape(-1, 3, 3)
        squares = [_squares(limb.direction), _squares(limb.acceleration)]
        sums = shifted(np.hstack([seen, shown, *squares, limb.direction]), there)[..., 0]
        self.counts, (directions, accelerations) = np.round(sums[:, :2].T), sums[:, 2:4].T
        kept = _squares(sums[:, 4:])[:, 0] / np.maximum(self.counts[0], 1.0)
        self.none = np.stack([directions - kept, accelerations])
        forces = shifted(shown, _squares(imu.acceleration))[:, 0, 0]
        self.whole = np.stack([directions, accelerations + forces])


def _squares(values: FloatArray) -> FloatArray:
    return (values**2).sum(axis=1, keepdims=True)


def _evidence(moments: list[_Moments], rows: IntArray, pull: FloatArray, rounds: int) -> FloatArray:
    """(L,) log-likelihood ratio of being on this limb; -inf where less than a second is shared."""
    counts, none, whole = (
        sum(getattr(each, name)[:, rows] for each in moments) for name in ("counts", "none", "whole")
    )
    T, F = (np.stack([getattr(each, name)[rows] for each in moments], axis=1) for name in ("T", "F"))
    C = np.sum([each.C[rows] for each in moments], axis=0)
    fits = best_fits(T, C, False, F, pull, rounds)
    left = np.maximum(whole - fits / [[1.0], [WEIGHT]], 0.0)
    ratio = np.zeros(len(rows))
    for k, (axes, sigma) in enumerate(((2, DIRECTION_SIGMA), (3, ACCELERATION_SIGMA))):
        number, floor = np.maximum(counts[k], 1.0), axes * sigma**2
        still, match = none[k] / number, left[k] / number
        independent = INDEPENDENT_HZ / GRID_HZ * counts[k]
        independent = independent / (1.0 + independent / MOST_INDEPENDENT)
        spoilt = SPOILT**2 * still
        ratio += 0.5 * axes * independent * np.log((still + spoilt + floor) / (match + spoilt + floor))
    return np.where(counts.max(axis=0) >= SHORTEST_S * GRID_HZ, ratio, -np.inf)
