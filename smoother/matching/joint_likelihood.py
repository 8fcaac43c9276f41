"""Feng's matching: the joint likelihood of positions and accelerations under one Gaussian process.

Feng (Glasgow thesis, 2014), section 5.3, equations 5.1 to 5.5: positions have a Gaussian-process prior,
accelerations are a linear map of them, and the pair whose joint log-likelihood is largest is the match. As
in the thesis' experiments with a pocket and with walking, the vertical axis alone is compared: a device's
heading is not known. What is ours:
each excerpt's positions have their mean removed; the joint log-likelihood less those of either alone is
what is compared, so that limbs that move much and little compare; small shifts of the clocks are tried. The
likelihood is as published, with 100 mm/s^2 for what the accelerations may differ by: far more sure of
itself than a strap some centimetres from the joint allows.
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..errors import UnoccludeError
from ..linalg import unit
from ..measurements.position_process import Kernel, joint_covariance
from .excerpt_motion import GRID_HZ, SHORTEST_S, MatchExcerpt

#: Section 5.3.2: v0 = 4.69e3 mm^2, w = 7.85 1/s^2, 8 mm, 100 mm/s^2.
PUBLISHED_FOR_MATCHING = Kernel(4.69e3 * 1e-6, 7.85, 0.008, 0.100)
#: The published methods take clocks as common: shifts up to this are tried, s.
PUBLISHED_REACH_S = 0.2
#: The published method has no `none`: an IMU's best limb gets this evidence against it.
BEST_AGAINST_NONE = 10.0


def joint_likelihood(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence that an IMU is on each limb by Feng's joint likelihood (5.3)."""
    if down is None:
        raise UnoccludeError(
            "the method joint-likelihood compares vertical motion and needs the camera's axes; "
            "state the camera's frame in the recording, or use the method motion"
        )
    up, reach = unit(-down), excerpts[0].reach
    steps = min(reach, round(PUBLISHED_REACH_S * GRID_HZ))
    shifts = np.arange(reach - steps, reach + steps + 1)
    value = np.zeros((len(excerpts[0].limbs), len(shifts)))
    count = np.zeros_like(value)
    for excerpt in excerpts:
        sensor, n = excerpt.imus[imu], len(excerpt.t)
        there = np.stack([sensor.there[shift : shift + n] for shift in shifts])
        rows: BoolArray = np.asarray(there.all(axis=0))
        acceleration = np.stack([sensor.measured[shift : shift + n, 2] for shift in shifts], axis=1)[rows]
        for limb, arm in enumerate(excerpt.limbs):
            seen = arm.has_point
            if seen.sum() < SHORTEST_S * GRID_HZ or rows.sum() < SHORTEST_S * GRID_HZ:
                continue
            height = arm.measured[seen] @ up
            value[limb] += _log_ratio(excerpt.t, seen, rows, height - height.mean(), acceleration)
            count[limb] += (seen & rows).sum()
    value = np.where(count >= SHORTEST_S * GRID_HZ, value - shift_cost[shifts], -np.inf)
    best = np.argmax(value, axis=1)
    evidence = value[np.arange(len(value)), best]
    if np.isfinite(evidence).any():
        evidence = evidence - evidence.max() + BEST_AGAINST_NONE
    return np.where(np.isfinite(evidence), evidence, 0.0), (shifts[best] - reach) / GRID_HZ


def _log_ratio(
    t: FloatArray, seen: BoolArray, there: BoolArray, height: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """(L,) log L(p, a) (5.3) - log L(p) - log L(a), for accelerations (n, L) at L shifts."""
    f = len(height)
    C = joint_covariance(PUBLISHED_FOR_MATCHING, t[seen], t[there])
    targets = np.vstack([np.tile(height[:, None], acceleration.shape[1]), acceleration])
    total = np.zeros(acceleration.shape[1])
    for rows, sign in ((slice(None), 1.0), (slice(0, f), -1.0), (slice(f, None), -1.0)):
        M = targets[rows]
        root = np.linalg.cholesky(C[rows, rows])
        quadratic = (np.linalg.solve(root, M) ** 2).sum(axis=0)
        # the terms N log(2 pi) cancel: the parts have as many rows as the whole
        total += sign * -0.5 * (quadratic + 2.0 * np.log(np.diag(root)).sum())
    return total
