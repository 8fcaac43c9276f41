"""Finds the camera's clock against the IMU's from the residuals.

A camera that is late by d shows every joint where it was d ago, so residuals lie along the velocity.
Their projection, summed over a second or less, is a local estimate of the offset; how fast the offset may
wander is what makes these estimates most likely (a local-level model; Harvey, Forecasting, structural time
series models, 1989), and their smoothed mean is the clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..measurements.clock import LARGEST_OFFSET_S, OFFSET_SIGMA_S, Clock
from ..measurements.rays import AT_M
from ..window.problem import Window
from ..window.solution import Solution

#: Offsets are estimated this far apart, s; those of synthetic stamps, which hide dropped frames, closer.
SPACING_S, SYNTHETIC_SPACING_S = 15.0, 0.5
#: How fast the offset may wander, s/sqrt(s): the likeliest is taken, if clearly likelier than a constant
#: (log-likelihood). Stamps of a camera drift slowly; synthetic stamps hide dropped frames.
WALKS = (0.0, 0.0003, 0.001)
WALKS_SYNTHETIC = (0.0, 0.001, 0.003, 0.01, 0.02, 0.04)
WALK_GAIN = 6.0
WALK_GAIN_SYNTHETIC = 0.0
#: How far synthetic stamps are off beyond what the offset follows, s: a frame or two that were dropped.
SYNTHETIC_SIGMA_S = 0.06
#: Crystals differ by some hundred parts in a million; it takes a while to show, s.
SKEW_SIGMA = 5e-4
SKEW_SPAN_S = 30.0
SKEW_GAIN = 3.0
#: An offset step is never longer than this, s; information is no less than this share of its bound.
LONGEST_STEP_S = 0.06
SMALLEST_SHARE = 0.02


def refined_clock(clock: Clock, score: ClockScore, synthetic_stamps: bool) -> Clock:
    """Move a clock by what the residuals say, and find how it wanders."""
    if not score.information.sum() > 0:
        return clock
    t = score.t - clock.mean_s  # back to the camera's clock, near enough to place knots
    spacing_s = SYNTHETIC_SPACING_S if synthetic_stamps else SPACING_S
    group = _spaced(t, spacing_s)
    information = np.bincount(group, weights=score.information)
    informed = information > 1e-6 * information.max()
    information = information[informed]
    slope = np.bincount(group, weights=score.slope)[informed]
    middle = (np.bincount(group, weights=t) / np.bincount(group))[informed]
    local = clock.at(middle) + np.clip(slope / information, -LONGEST_STEP_S, LONGEST_STEP_S)
    prior_s = clock.prior_sigma_s
    line, drift, skew = _line(middle, local, information, prior_s), np.zeros(len(local)), 0.0
    (loglik, offset, sigma, local_sigma), walk = _likeliest(
        middle, local, 1.0 / information, synthetic_stamps, prior_s
    )
    if line is not None and line[0] > loglik + SKEW_GAIN:
        (_, drift, skew, local_sigma), offset, walk = line, np.zeros(len(local)), 0.0
        # and what wanders about the line
        wander, again = _likeliest(middle, local - drift, 1.0 / information, synthetic_stamps, prior_s)
        if again > 0.0:
            (_, offset, _, local_sigma), walk = wander, again
    if synthetic_stamps:
        local_sigma = np.hypot(local_sigma, SYNTHETIC_SIGMA_S)
    return Clock(
        middle,
        np.clip(drift + offset, -LARGEST_OFFSET_S, LARGEST_OFFSET_S),
        float(sigma),
        walk,
        float(np.hypot(sigma, local_sigma)),
        skew,
        prior_s,
    )


def _spaced(t: FloatArray, spacing_s: float) -> IntArray:
    """Groups (n,) of times, each shorter than the spacing; one begins with what the one before leaves."""
    starts = [-np.inf]
    for each in np.unique(t).tolist():
        if each - starts[-1] >= spacing_s:
            starts.append(each)
    return np.searchsorted(starts, t, side="right") - 2


@dataclass(frozen=True)
class ClockScore:
    """Evidence of camera samples on the clock offset: their likelihood's score, and its Fisher
    information.
    """

    t: FloatArray  # (n,) s: on the IMU's clock
    slope: FloatArray  # (n,) 1/s: fall of the loss for a later offset
    information: FloatArray  # (n,) 1/s^2: of the offset

    def condensed(self) -> ClockScore:
        """The same summed up over half a second at a time."""
        _, group = np.unique(np.floor(self.t / SYNTHETIC_SPACING_S), return_inverse=True)
        count = np.bincount(group)
        return ClockScore(
            np.bincount(group, weights=self.t) / count,
            np.bincount(group, weights=self.slope).astype(float),
            np.bincount(group, weights=self.information).astype(float),
        )


def clock_score(windows: Iterable[tuple[Window, Solution]]) -> ClockScore:
    """The score of the samples in the windows' own time."""
    scores = []
    for window, solution in windows:
        if not window.joint_measurements:
            continue
        t, slope, bound = (
            np.concatenate(each) for each in zip(*_joint_scores(window, solution), strict=True)
        )
        core = (t >= window.core_start_s) & (t <= window.core_end_s)
        share = np.clip(solution.offset_information / max(bound.sum(), 1e-12), SMALLEST_SHARE, 1.0)
        scores.append(ClockScore(t[core], slope[core], share * bound[core]))
    return joined_scores(scores)


def joined_scores(scores: Sequence[ClockScore]) -> ClockScore:
    """Several scores as one."""
    columns = [[getattr(score, name) for score in scores] for name in ("t", "slope", "information")]
    return ClockScore(*(np.concatenate([np.zeros(0), *each]) for each in columns))


def _joint_scores(window: Window, solution: Solution) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Times, slopes, and information where the states would not follow, joint by joint."""
    for measured in window.joint_measurements:
        body = solution.of(measured.segment)
        assert body is not None
        velocity = body.states.v[measured.node] + measured.velocity
        residual, rays = solution.residuals[measured.key], measured.rays
        if rays is not None and (distance_m := measured.distance_m) is not None:
            velocity = velocity - np.sum(velocity * rays, axis=1, keepdims=True) * rays
            velocity *= (AT_M / distance_m)[:, None]  # as residuals and their noise are
        size = np.linalg.norm(residual, axis=1) / measured.sigma_m
        weight = 1.0 / (1.0 + (size / window.noise.cauchy) ** 2) / measured.sigma_m**2
        slope = weight * np.einsum("ni,ni->n", residual, velocity)
        yield measured.t_s, slope, weight * np.einsum("ni,ni->n", velocity, velocity)


def _likeliest(
    t: FloatArray,
    local: FloatArray,
    variance: FloatArray,
    synthetic_stamps: bool,
    prior_s: float = OFFSET_SIGMA_S,
) -> tuple[tuple[float, FloatArray, float, float], float]:
    """The likeliest walk; zero unless another is clearly likelier."""
    walks, gain = (WALKS_SYNTHETIC, WALK_GAIN_SYNTHETIC) if synthetic_stamps else (WALKS, WALK_GAIN)
    tries = [_local_level(t, local, variance, walk, prior_s) for walk in walks]
    best = max(range(len(walks)), key=lambda k: tries[k][0] - (gain if k else 0.0))
    return tries[best], walks[best]


def _line(
    t: FloatArray, x: FloatArray, information: FloatArray, prior_s: float
) -> tuple[float, FloatArray, float, float] | None:
    """Log-likelihood, offsets (n,), slope and sigma of a steady drift; None where it is too soon to tell."""
    if len(t) < 5 or np.ptp(t) < SKEW_SPAN_S:
        return None
    centre = float(np.average(t, weights=information))
    basis = np.stack([np.ones_like(t), t - centre], axis=1)
    normal = basis.T @ (information[:, None] * basis) + np.diag([prior_s**-2, SKEW_SIGMA**-2])
    value, slope = np.linalg.solve(normal, basis.T @ (information * x))
    left = x - value - slope * (t - centre)
    # the evidence of the line, by the determinant of its posterior (as the local level's filter has it)
    prior = -0.5 * (value**2 / prior_s**2 + slope**2 / SKEW_SIGMA**2)
    volume = -0.5 * (np.linalg.slogdet(normal)[1] + 2 * np.log(prior_s) + 2 * np.log(SKEW_SIGMA))
    loglik = 0.5 * float(np.sum(np.log(information) - information * left**2)) + prior + volume
    spread = np.linalg.inv(normal)[1, 1] * np.mean((t - centre) ** 2)
    return float(loglik), value + slope * (t - centre), float(slope), float(np.sqrt(spread))


def _local_level(
    t: FloatArray, x: FloatArray, variance: FloatArray, walk: float, prior_s: float = OFFSET_SIGMA_S
) -> tuple[float, FloatArray, float, float]:
    """Log-likelihood, smoothed level (n,), sigma of its mean and of its wandering about the mean."""
    n = len(t)
    level, spread = np.zeros(n), np.zeros(n)
    ahead, ahead_spread = np.zeros(n), np.zeros(n)
    a, p, loglik = 0.0, prior_s**2, 0.0
    for k in range(n):
        if k:
            p += walk**2 * (t[k] - t[k - 1])
        ahead[k], ahead_spread[k] = a, p
        f = p + variance[k]
        loglik -= 0.5 * (np.log(f) + (x[k] - a) ** 2 / f)
        gain = p / f
        a, p = a + gain * (x[k] - a), p * (1.0 - gain)
        level[k], spread[k] = a, p
    for k in range(n - 2, -1, -1):
        back = spread[k] / ahead_spread[k + 1]
        level[k] += back * (level[k + 1] - ahead[k + 1])
        spread[k] += back**2 * (spread[k + 1] - ahead_spread[k + 1])
    sigma = float(np.sqrt(1.0 / (1.0 / prior_s**2 + np.sum(1.0 / variance))))
    return loglik, level, sigma, float(np.sqrt(max(spread.mean() - sigma**2, 0.0)))
