"""Lengths alone: |specific force| against |joint's acceleration - gravity|, and rates.

No frame has to be solved for, so it needs least data to be computed and tells least: whatever turns a
motion as a whole leaves the lengths as they are. The gyroscope's rate can only be larger than the limb's
turning rate, which does not see the rotation about the limb itself.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import BoolArray, FloatArray
from ..units import GRAVITY
from .excerpt_motion import GRID_HZ, SHORTEST_S, MatchExcerpt, independent_samples

#: What the camera's noise leaves of an acceleration and of a turning rate, m/s^2 and rad/s.
FORCE_SIGMA, RATE_SIGMA = 0.3, 0.15
#: What mounting and stamps spoil, as a part of the motion.
SPOILT = 0.2


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
        force, rate = _Left(2 * reach + 1), _Left(2 * reach + 1)
        for excerpt in excerpts:
            arm, sensor = excerpt.limbs[limb], excerpt.imus[imu]
            turning = np.linalg.norm(np.gradient(arm.direction, 1 / GRID_HZ, axis=0), axis=1)
            seen = arm.has_direction.copy()
            seen[1:-1] &= arm.has_direction[2:] & arm.has_direction[:-2]
            rate.add(turning, 0.0, seen, sensor.rate, sensor.there, one_sided=True)
            if down is not None:
                size = np.linalg.norm(arm.acceleration - GRAVITY * down, axis=1)
                force.add(size, GRAVITY, arm.has_point, sensor.force, sensor.there)
        enough = np.maximum(force.count, rate.count) >= SHORTEST_S * GRID_HZ
        value = force.evidence(FORCE_SIGMA) + rate.evidence(RATE_SIGMA) - shift_cost
        if enough.any():
            k = int(np.argmax(np.where(enough, value, -np.inf)))
            evidence[limb], best[limb] = value[k], (k - reach) / GRID_HZ
    return evidence, best


class _Left:
    """Squares of what is left at every shift, with the limb and with a limb at rest."""

    def __init__(self, shifts: int) -> None:
        self.match, self.none, self.count = np.zeros(shifts), np.zeros(shifts), np.zeros(shifts)

    def add(
        self,
        camera: FloatArray,
        at_rest: float,
        seen: BoolArray,
        sensed: FloatArray,
        there: BoolArray,
        one_sided: bool = False,
    ) -> None:
        """Take an excerpt: camera (n,), sensor (n + shifts - 1,); one-sided = the sensor's may be larger."""
        both = sliding_window_view(there, len(camera)) & seen
        left = camera - sliding_window_view(sensed, len(camera))
        if one_sided:
            left = np.maximum(left, 0.0)
        self.match += (left**2 * both).sum(axis=1)
        self.none += ((camera - at_rest) ** 2 * both).sum(axis=1)
        self.count += both.sum(axis=1)

    def evidence(self, sigma: float) -> FloatArray:
        """Half the independent samples times the log of the ratio of mean squares, by shift."""
        number = np.maximum(self.count, 1.0)
        none, match = self.none / number, self.match / number
        ratio = ((1 + SPOILT**2) * none + sigma**2) / (match + SPOILT**2 * none + sigma**2)
        return np.asarray(0.5 * independent_samples(self.count) * np.log(ratio))
