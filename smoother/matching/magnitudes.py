"""Lengths alone: |specific force| against |joint's acceleration - gravity|, and rates.

No frame has to be solved for, so it needs least data to be computed and tells least: whatever turns a
motion as a whole leaves the lengths as they are. The gyroscope's rate can only be larger than the limb's
turning rate, which does not see the rotation about the limb itself.
"""

from __future__ import annotations

import numpy as np

from ..recording import FloatArray
from ..units import GRAVITY
from .excerpt_motion import GRID_HZ, LOW_PASS_HZ, SHORTEST_S, MatchExcerpt

#: What the camera's noise leaves of an acceleration and of a turning rate, m/s^2 and rad/s.
FORCE_SIGMA, RATE_SIGMA = 0.3, 0.15
#: What mounting and stamps spoil, as a part of the motion; part of the band's samples that are independent.
SPOILT, INDEPENDENT = 0.2, 0.5


def magnitudes(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence that an IMU is on each limb by lengths alone; parameters and returns as `rigid_evidence`.

    Without a direction of gravity only the rates are compared.
    """
    reach = excerpts[0].reach
    limbs = len(excerpts[0].limbs)
    evidence, best = np.zeros(limbs), np.zeros(limbs)
    for limb in range(limbs):
        value = np.full(2 * reach + 1, -np.inf)
        for shift in range(2 * reach + 1):
            found = _at(excerpts, imu, limb, down, shift)
            if found is not None:
                value[shift] = found - shift_cost[shift]
        if np.isfinite(value).any():
            evidence[limb] = value.max()
            best[limb] = (int(np.argmax(value)) - reach) / GRID_HZ
    return evidence, best


def _at(
    excerpts: list[MatchExcerpt], imu: int, limb: int, down: FloatArray | None, shift: int
) -> float | None:
    """Evidence at one shift; None where less than a second is shared."""
    force: list[tuple[FloatArray, FloatArray]] = []
    rate: list[tuple[FloatArray, FloatArray]] = []
    for excerpt in excerpts:
        arm, sensor = excerpt.limbs[limb], excerpt.imus[imu]
        rows = slice(shift, shift + len(excerpt.t))
        there = sensor.there[rows]
        turning = np.linalg.norm(np.gradient(arm.direction, 1 / GRID_HZ, axis=0), axis=1)
        seen = there & arm.has_direction
        seen[1:-1] &= arm.has_direction[2:] & arm.has_direction[:-2]
        rate.append((sensor.rate[rows][seen], turning[seen]))
        if down is not None:
            size = np.linalg.norm(arm.acceleration - GRAVITY * down, axis=1)
            seen = there & arm.has_point
            force.append((sensor.force[rows][seen], size[seen]))
    count = max(sum(len(a) for a, _ in pairs) for pairs in (force, rate))
    if count < SHORTEST_S * GRID_HZ:
        return None
    total = 0.0
    for pairs, sigma, usual, one_sided in (
        (force, FORCE_SIGMA, GRAVITY, False),
        (rate, RATE_SIGMA, 0.0, True),
    ):
        sensed = np.concatenate([a for a, _ in pairs]) if pairs else np.empty(0)
        seen_by_camera = np.concatenate([b for _, b in pairs]) if pairs else np.empty(0)
        if not len(sensed):
            continue
        left = seen_by_camera - sensed
        match = np.mean((np.maximum(left, 0.0) if one_sided else left) ** 2)
        none = np.mean((seen_by_camera - usual) ** 2)
        ratio = ((1 + SPOILT**2) * none + sigma**2) / (match + SPOILT**2 * none + sigma**2)
        total += 0.5 * INDEPENDENT * 2 * LOW_PASS_HZ / GRID_HZ * len(sensed) * float(np.log(ratio))
    return total
