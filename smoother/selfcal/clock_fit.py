"""Finds the camera's clock against the IMU's from the residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..measurements.clock import LARGEST_OFFSET_S, OFFSET_SIGMA_S, Clock
from ..recording import FloatArray, IntArray
from ..window.problem import Solution, Window

#: Offsets of made-up stamps are estimated over cells of this length, s; others a window at a time.
SYNTHETIC_CELL_S = 0.5
#: How fast the offset may wander, s/sqrt(s): the likeliest is taken, if clearly likelier than a constant
#: (log-likelihood). Stamps of a camera drift slowly; stamps that somebody made up hide dropped frames.
WALKS = (0.0, 0.0003, 0.001)
WALKS_SYNTHETIC = (0.0, 0.001, 0.003, 0.01, 0.02, 0.04)
WALK_GAIN = 6.0
WALK_GAIN_SYNTHETIC = 0.0
#: How far a single frame's made-up stamp is off, s: about a third of a dropped frame.
SYNTHETIC_SIGMA_S = 0.015
#: Crystals differ by some hundred parts in a million; it takes a while to show, s.
SKEW_SIGMA = 5e-4
SKEW_SPAN_S = 30.0
SKEW_GAIN = 3.0
#: An offset step is never longer than this, s; information is never taken for less than a part of its bound.
LONGEST_STEP_S = 0.06
SMALLEST_PART = 0.02


def refined_clock(clock: Clock, score: ClockScore, made_up: bool) -> Clock:
    """The clock that the residuals' pulls ask for; `made_up`: the stamps are (`stamps_made_up`)."""
    if not score.information.sum() > 0:
        return clock
    t = score.t - clock.mean_s  # back to the camera's clock, near enough to place knots
    cell = np.floor(t / SYNTHETIC_CELL_S).astype(int) if made_up else score.window
    _, cell = np.unique(cell, return_inverse=True)
    information = np.bincount(cell, weights=score.information)
    seen = information > 1e-6 * information.max()
    information = information[seen]
    pull = np.bincount(cell, weights=score.slope)[seen]
    middle = (np.bincount(cell, weights=t) / np.bincount(cell))[seen]
    now = clock.at(middle)
    local = now + np.clip(pull / information, -LONGEST_STEP_S, LONGEST_STEP_S)
    line, drift, skew = _line(middle, local, information), np.zeros(len(local)), 0.0
    (loglik, offset, sigma, local_sigma), walk = _likeliest(middle, local, 1.0 / information, made_up)
    if line is not None and line[0] > loglik + SKEW_GAIN:
        (_, drift, skew, local_sigma), offset, walk = line, np.zeros(len(local)), 0.0
        # and what wanders about the line
        wander, again = _likeliest(middle, local - drift, 1.0 / information, made_up)
        if again > 0.0:
            (_, offset, _, local_sigma), walk = wander, again
    if made_up:
        local_sigma = np.hypot(local_sigma, SYNTHETIC_SIGMA_S)
    return Clock(
        middle,
        np.clip(drift + offset, -LARGEST_OFFSET_S, LARGEST_OFFSET_S),
        float(sigma),
        walk,
        float(np.hypot(sigma, local_sigma)),
        skew,
    )


class ClockFit:
    """Improves the clocks of several recordings, round by round.

    Parameters
    ----------
    clocks : where to start, one a recording.
    made_up : whether the camera's stamps were made up, one a recording.
    """

    def __init__(self, clocks: Sequence[Clock], made_up: Sequence[bool]) -> None:
        self.clocks, self._made_up = list(clocks), list(made_up)

    def step(self, windows: Sequence[Window], solutions: Sequence[Solution], owner: IntArray) -> None:
        """Move every clock by what the residuals of another round say."""
        for number in np.unique(owner).tolist():
            chosen = np.flatnonzero(owner == number).tolist()
            score = clock_score([windows[k] for k in chosen], [solutions[k] for k in chosen])
            self.clocks[number] = refined_clock(self.clocks[number], score, self._made_up[number])


@dataclass(frozen=True)
class ClockScore:
    """Sample by sample, (n,) each: time, fall of the loss for a later offset, information, window.

    The loss falls by residual . velocity / sigma^2 a second (envelope theorem). Information is
    velocity^2 / sigma^2 less what the states follow of a shift (`offset.offset_information`).
    """

    t: FloatArray
    slope: FloatArray
    information: FloatArray
    window: IntArray

    def gathered(self) -> ClockScore:
        """The pulls of one window summed up over cells of half a second."""
        _, cell = np.unique(np.floor(self.t / SYNTHETIC_CELL_S), return_inverse=True)
        count = np.bincount(cell)
        return ClockScore(
            np.bincount(cell, weights=self.t) / count,
            np.bincount(cell, weights=self.slope).astype(float),
            np.bincount(cell, weights=self.information).astype(float),
            np.full(len(count), self.window[0] if len(self.window) else 0),
        )


def clock_score(windows: Sequence[Window], solutions: Sequence[Solution]) -> ClockScore:
    """What the samples of the windows' own parts say; the solutions state their offset information."""
    t, slope, information, number = [], [], [], []
    for k, (window, solution) in enumerate(zip(windows, solutions, strict=True)):
        own, all_t, all_slope, bound = [], [], [], []
        for measured in window.joint_measurements:
            velocity = solution.states.v[measured.node] + measured.velocity
            residual = solution.residuals[measured.joint]
            size = np.linalg.norm(residual, axis=1) / measured.sigma_m
            weight = 1.0 / (1.0 + (size / window.noise.cauchy) ** 2) / measured.sigma_m**2
            own.append((measured.t_s >= window.core_start_s) & (measured.t_s <= window.core_end_s))
            all_t.append(measured.t_s)
            all_slope.append(weight * np.einsum("ni,ni->n", residual, velocity))
            bound.append(weight * np.einsum("ni,ni->n", velocity, velocity))
        if not own:
            continue
        core, most = np.concatenate(own), np.concatenate(bound)
        part = np.clip(solution.offset_information / max(most.sum(), 1e-12), SMALLEST_PART, 1.0)
        t.append(np.concatenate(all_t)[core])
        slope.append(np.concatenate(all_slope)[core])
        information.append(part * most[core])
        number.append(np.full(int(core.sum()), k))
    if not t:
        return ClockScore(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, int))
    return ClockScore(*(np.concatenate(each) for each in (t, slope, information, number)))


def pooled_score(score: Sequence[ClockScore]) -> ClockScore:
    """The pulls of windows apart, numbered anew."""
    number = [np.full(len(each.t), k) for k, each in enumerate(score)]
    columns = [[getattr(each, name) for each in score] for name in ("t", "slope", "information")]
    return ClockScore(*(np.concatenate(each) for each in (*columns, number)))


def _likeliest(
    t: FloatArray, local: FloatArray, variance: FloatArray, made_up: bool
) -> tuple[tuple[float, FloatArray, float, float], float]:
    """The likeliest walk; zero unless another is clearly likelier."""
    walks, gain = (WALKS_SYNTHETIC, WALK_GAIN_SYNTHETIC) if made_up else (WALKS, WALK_GAIN)
    tries = [_local_level(t, local, variance, walk) for walk in walks]
    best = max(range(len(walks)), key=lambda k: tries[k][0] - (gain if k else 0.0))
    return tries[best], walks[best]


def _line(
    t: FloatArray, x: FloatArray, information: FloatArray
) -> tuple[float, FloatArray, float, float] | None:
    """Log-likelihood, offsets (n,), slope and sigma of a steady drift; None where it is too soon to tell."""
    if len(t) < 5 or np.ptp(t) < SKEW_SPAN_S:
        return None
    centre = float(np.average(t, weights=information))
    basis = np.stack([np.ones_like(t), t - centre], axis=1)
    normal = basis.T @ (information[:, None] * basis) + np.diag([OFFSET_SIGMA_S**-2, SKEW_SIGMA**-2])
    value, slope = np.linalg.solve(normal, basis.T @ (information * x))
    left = x - value - slope * (t - centre)
    # the evidence of the line, by the determinant of its posterior (as the local level's filter has it)
    prior = -0.5 * (value**2 / OFFSET_SIGMA_S**2 + slope**2 / SKEW_SIGMA**2)
    volume = -0.5 * (np.linalg.slogdet(normal)[1] + 2 * np.log(OFFSET_SIGMA_S) + 2 * np.log(SKEW_SIGMA))
    loglik = 0.5 * float(np.sum(np.log(information) - information * left**2)) + prior + volume
    spread = np.linalg.inv(normal)[1, 1] * np.mean((t - centre) ** 2)
    return float(loglik), value + slope * (t - centre), float(slope), float(np.sqrt(spread))


def _local_level(
    t: FloatArray, x: FloatArray, variance: FloatArray, walk: float
) -> tuple[float, FloatArray, float, float]:
    """Log-likelihood, smoothed level (n,), sigma of its mean and of its wandering about the mean."""
    n = len(t)
    level, spread = np.zeros(n), np.zeros(n)
    ahead, ahead_spread = np.zeros(n), np.zeros(n)
    a, p, loglik = 0.0, OFFSET_SIGMA_S**2, 0.0
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
    sigma = float(np.sqrt(1.0 / (1.0 / OFFSET_SIGMA_S**2 + np.sum(1.0 / variance))))
    return loglik, level, sigma, float(np.sqrt(max(spread.mean() - sigma**2, 0.0)))
