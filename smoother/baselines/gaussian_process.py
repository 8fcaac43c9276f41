"""Baselines `gaussian-process` and `gaussian-process-online`: Feng (thesis, Glasgow 2014), chapter 4.

The published form (online) answers from the last frames that have arrived; the smoother conditions the joint
prior (4.24) on everything in a window about its mean position. Hyper-parameters by maximum likelihood on
visible motion (2.13), but v0: seconds do not show how far a movement goes, so it is the variance over the
whole segment.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from ..array_types import FloatArray
from ..linalg import interpolate
from ..measurements.position_process import (
    FIRST,
    PUBLISHED,
    SECOND,
    STEP_S,
    VALUE,
    Kernel,
    Measurements,
    joint_covariance,
    mapped_covariance,
)
from .rts import white_sigma
from .scene import Path, Scene, no_answer, path_at


class Posterior:
    """The positions given the measurements (4.24; Rasmussen and Williams 2006, algorithm 2.1)."""

    def __init__(self, kernel: Kernel, data: Measurements) -> None:
        self._kernel, self._data = kernel, data
        covariance = joint_covariance(kernel, data.frame_t, data.acc_t)
        self._factor = cho_factor(covariance, lower=True, check_finite=False)
        self._weights = cho_solve(self._factor, data.targets, check_finite=False)

    def position(self, at: FloatArray) -> FloatArray:
        """(k, c) m at times (k,)."""
        return np.asarray(_to_measurements(self._kernel, at, VALUE, self._data) @ self._weights)

    def velocity(self, at: FloatArray) -> FloatArray:
        """(k, c) m/s at times (k,), the first difference about each (4.12)."""
        cross = _to_measurements(self._kernel, at, FIRST, self._data) / STEP_S
        return np.asarray(cross @ self._weights)

    def variance(self, at: FloatArray) -> FloatArray:
        """(k,) m^2 of the positions, the same for all columns."""
        cross = _to_measurements(self._kernel, at, VALUE, self._data)
        explained = np.einsum("ij,ji->i", cross, cho_solve(self._factor, cross.T, check_finite=False))
        return np.maximum(self._kernel.variance - explained, 0.0)


def log_likelihood(kernel: Kernel, data: Measurements) -> float:
    """Log-density of the measurements under the prior (2.13), all columns together."""
    factor = cho_factor(joint_covariance(kernel, data.frame_t, data.acc_t), lower=True, check_finite=False)
    targets = data.targets
    quadratic = float(np.sum(targets * cho_solve(factor, targets, check_finite=False)))
    log_determinant = 2.0 * float(np.sum(np.log(np.diag(factor[0]))))
    count, columns = targets.shape
    return -0.5 * (quadratic + columns * (log_determinant + count * np.log(2.0 * np.pi)))


def _to_measurements(
    kernel: Kernel, at: FloatArray, rows: tuple[tuple[float, float], ...], data: Measurements
) -> FloatArray:
    positions = mapped_covariance(kernel, at, rows, data.frame_t, VALUE)
    return np.hstack([positions, mapped_covariance(kernel, at, rows, data.acc_t, SECOND) * STEP_S**-2])


#: The predictor's frames, the last ones of those that have arrived, and how late they are, s (Feng, 4.5).
ORDER, LATE_S = 5, 0.1


def predict(
    kernel: Kernel, data: Measurements, at: FloatArray
) -> tuple[FloatArray, FloatArray]:  # mean (k, c) m, sigma (k,) m
    """The autoregressive predictor: the position now, from late frames and prompt accelerations (4.3)."""
    mean, sigma = np.full((len(at), data.position.shape[1]), np.nan), np.full(len(at), np.nan)
    arrived = np.searchsorted(data.frame_t + LATE_S, at + 1e-9, side="right")
    for k in np.flatnonzero(arrived):
        frames = slice(max(int(arrived[k]) - ORDER, 0), int(arrived[k]))
        frame_t, position = data.frame_t[frames], data.position[frames]
        first_s = max(frame_t[0], at[k] - LONGEST_S)  # frames before it say nothing any more
        a, b = np.searchsorted(data.acc_t, [first_s - 1e-9, at[k] + 1e-9])
        level = position.mean(axis=0)
        window = Measurements(frame_t, position - level, data.acc_t[a:b], data.acceleration[a:b])
        posterior, now = Posterior(kernel, window), at[k : k + 1]
        mean[k], sigma[k] = posterior.position(now)[0] + level, np.sqrt(posterior.variance(now)[0])
    return mean, sigma


#: Accelerations are averaged to at most this rate, Hz.
HIGHEST_RATE_HZ = 110.0
#: Windows: visible time on both sides, s; where no gap decides their length, s; the longest, s.
MARGIN_S = 1.25
WINDOW_S = 4.0
LONGEST_S = 20.0
#: Maximum likelihood: at most this many excerpts of this many seconds, accelerations averaged to this rate,
#: Hz.
TRAINING_EXCERPTS = 5
TRAINING_S = 3.0
TRAINING_RATE_HZ = 55.0
#: What the likelihood may choose: w 1/s^2, acceleration noise m/s^2.
BOUNDS = np.log([(1.0, 60.0), (0.05, 5.0)])
#: Variances, and the predictor's answers, are computed at this rate and interpolated, Hz.
SIGMA_RATE_HZ = 30.0
LEAST_SIGMA_M = 2e-4


def gaussian_process(scene: Scene, kernel: Kernel | None = None) -> Path:
    """Recover one segment."""
    if scene.visible.sum() < 2:
        return no_answer(scene)
    n = len(scene.t)
    position, velocity, variance = np.full((n, 3), np.nan), np.full((n, 3), np.nan), np.full(n, np.nan)
    data = measurements(scene)
    kernel = kernel or likeliest(scene, data)
    for start_s, end_s in pairwise(borders(scene)):
        rows = (scene.t >= start_s) & (scene.t <= end_s)
        near = data.between(start_s - MARGIN_S, end_s + MARGIN_S)
        nearest = data.position[np.argmin(np.abs(data.frame_t - 0.5 * (start_s + end_s)))]
        level = near.position.mean(axis=0) if len(near.frame_t) else nearest
        near = replace(near, position=near.position - level)
        posterior, t = Posterior(kernel, near), scene.t[rows]
        position[rows], velocity[rows] = level + posterior.position(t), posterior.velocity(t)
        coarse = np.linspace(t[0], t[-1], int((t[-1] - t[0]) * SIGMA_RATE_HZ) + 2)
        variance[rows] = np.interp(t, coarse, posterior.variance(coarse))
    return path_at(scene, np.arange(n), position, velocity, variance[:, None])


def gaussian_process_online(scene: Scene) -> Path:
    """Recover one segment by the predictor; hyper-parameters and orientation are of the whole segment."""
    if scene.visible.sum() < 2:
        return no_answer(scene)
    data = measurements(scene)
    coarse = np.linspace(scene.t[0], scene.t[-1], int((scene.t[-1] - scene.t[0]) * SIGMA_RATE_HZ) + 2)
    mean, sigma = predict(likeliest(scene, data), data, coarse)
    position, variance = interpolate(coarse, mean, scene.t), np.interp(scene.t, coarse, sigma**2)
    velocity = np.gradient(position, scene.t, axis=0)
    return path_at(scene, np.arange(len(scene.t)), position, velocity, variance[:, None])


def measurements(scene: Scene) -> Measurements:
    """What the process gets: the visible points, and accelerations at no more than `HIGHEST_RATE_HZ`."""
    own = Measurements(*scene.visible_points, scene.t, scene.acceleration)
    return _averaged(own, max(int(np.ceil(scene.imu.rate_hz / HIGHEST_RATE_HZ)), 1))


def _averaged(data: Measurements, size: int) -> Measurements:
    """With means over this many neighbouring accelerations; what is left over at the end goes."""
    count = len(data.acc_t) // size
    if size == 1 or not count:
        return data
    t, acc = (
        each[: count * size].reshape(count, size, -1).mean(axis=1) for each in (data.acc_t, data.acceleration)
    )
    return replace(data, acc_t=t[:, 0], acceleration=acc)


def borders(scene: Scene) -> list[float]:
    """Where windows meet, s: in visible time, a margin away from gaps where that is possible."""
    start_s, end_s = float(scene.t[0]), float(scene.t[-1])
    edges = [start_s]
    while end_s - edges[-1] > 1.5 * WINDOW_S:
        edge = edges[-1] + WINDOW_S
        for gap in scene.gaps:
            if gap.start_s - MARGIN_S < edge < gap.end_s + MARGIN_S:
                edge = gap.end_s + MARGIN_S
        edges.append(min(edge, edges[-1] + LONGEST_S))
    if len(edges) > 1 and end_s - edges[-1] < 0.25 * WINDOW_S:
        edges.pop()
    return [*edges, end_s]


def likeliest(scene: Scene, data: Measurements) -> Kernel:
    """The hyper-parameters under which visible excerpts, evenly spread, are likeliest."""
    spread = float(data.position.var(axis=0).mean())
    start = replace(
        PUBLISHED,
        variance=max(PUBLISHED.variance, spread),
        position_sigma=max(white_sigma(scene), LEAST_SIGMA_M),
    )
    excerpts = _training(scene, data)
    if not excerpts:
        return start

    def kernel(x: FloatArray) -> Kernel:
        w, sigma_a = np.exp(np.clip(x, *BOUNDS.T)).tolist()
        return replace(start, rate=w, acceleration_sigma=sigma_a)

    def loss(x: FloatArray) -> float:
        outside = float(np.sum((x - np.clip(x, *BOUNDS.T)) ** 2))
        return 100.0 * outside - sum(log_likelihood(kernel(x), excerpt) for excerpt in excerpts)

    first = np.log([start.rate, start.acceleration_sigma])
    options = {"xatol": 0.05, "fatol": 0.5, "maxfev": 60}
    return kernel(minimize(loss, first, method="Nelder-Mead", options=options).x)


def _training(scene: Scene, data: Measurements) -> list[Measurements]:
    """Visible excerpts, each about its own mean."""
    size = max(round(len(data.acc_t) / (scene.t[-1] - scene.t[0]) / TRAINING_RATE_HZ), 1)
    excerpts = []
    for start_s in np.arange(scene.t[0], scene.t[-1] - TRAINING_S, TRAINING_S):
        if any(gap.start_s < start_s + TRAINING_S and gap.end_s > start_s for gap in scene.gaps):
            continue
        excerpt = data.between(start_s, start_s + TRAINING_S)
        if len(excerpt.frame_t) >= 10 and len(excerpt.acc_t) >= 10 * size:
            level = excerpt.position.mean(axis=0)
            excerpts.append(_averaged(replace(excerpt, position=excerpt.position - level), size))
    return excerpts[:: max(len(excerpts) // TRAINING_EXCERPTS, 1)][:TRAINING_EXCERPTS]
