"""Baseline `gaussian-process`: Feng (Glasgow thesis, 2014), chapter 4, as a smoother over gaps and their margins.

The published form answers live from the last frames (`kernel.predict`); here the same joint prior (4.24) is
conditioned on everything in a window, before and after a gap: its best within what was published. Windows
hold a gap and its margins, or some seconds of visible motion, so that cost grows with the length only. The
process is about the window's mean position.

Hyper-parameters by maximum likelihood on visible stretches (2.13), started from the published ones. A few
seconds say nothing of how far a movement goes in the end, so v0 is the points' variance over the whole
stretch, and no less than published; w and the acceleration's noise, a wrong orientation included, are the
likeliest. The camera's noise is the scene's.

Order of the method: on error-free sensors half a millimetre, what a smooth prior leaves of a movement.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize

from ..recording import FloatArray
from .error_state import white_sigma
from .kernel import PUBLISHED, Kernel, Measurements, Posterior, log_likelihood
from .scene import Path, Scene

#: Accelerations are averaged to at most this rate, Hz.
HIGHEST_RATE_HZ = 110.0
#: Windows: visible time on both sides, s; where no gap decides their length, s; the longest, s.
MARGIN_S = 1.25
WINDOW_S = 4.0
LONGEST_S = 20.0
#: Maximum likelihood: at most so many stretches of so many seconds, accelerations averaged to this rate, Hz.
TRAINING_STRETCHES = 5
TRAINING_S = 3.0
TRAINING_RATE_HZ = 55.0
#: What the likelihood may choose: w 1/s^2, acceleration noise m/s^2.
BOUNDS = np.log([(1.0, 60.0), (0.05, 5.0)])
#: Variances are computed at this rate and interpolated, Hz.
SIGMA_RATE_HZ = 30.0
LEAST_SIGMA_M = 2e-4


def gaussian_process(scene: Scene, kernel: Kernel | None = None) -> Path:
    """Recover one stretch.

    Parameters
    ----------
    scene : one stretch; see `Scene`.
    kernel : hyper-parameters; the likeliest where None.
    """
    n = len(scene.t)
    position, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    variance = np.full(n, np.nan)
    if scene.visible.sum() < 2:
        return Path(position, velocity, notes=("The camera saw too little of this stretch.",))
    seen = measurements(scene)
    kernel = kernel or likeliest(scene, seen)
    for start_s, end_s in pairwise(borders(scene)):
        rows = np.flatnonzero((scene.t >= start_s) & (scene.t <= end_s))
        near = seen.between(start_s - MARGIN_S, end_s + MARGIN_S)
        level = near.position.mean(axis=0) if len(near.frame_t) else _nearest(seen, 0.5 * (start_s + end_s))
        near = replace(near, position=near.position - level)
        posterior, t = Posterior(kernel, near), scene.t[rows]
        position[rows], velocity[rows] = level + posterior.position(t), posterior.velocity(t)
        some = np.linspace(t[0], t[-1], int((t[-1] - t[0]) * SIGMA_RATE_HZ) + 2)
        variance[rows] = np.interp(t, some, posterior.variance(some))
    return Path(position, velocity, variance[:, None, None] * np.eye(3))


def measurements(scene: Scene) -> Measurements:
    """What the process is told: the visible points, and accelerations at no more than `HIGHEST_RATE_HZ`."""
    size = max(int(np.ceil(scene.imu.rate_hz / HIGHEST_RATE_HZ)), 1)
    acc_t, acceleration = _averaged(scene.t, scene.acceleration, size)
    seen = scene.visible
    return Measurements(scene.frame_t[seen], scene.point[seen], acc_t, acceleration)


def _averaged(t: FloatArray, values: FloatArray, size: int) -> tuple[FloatArray, FloatArray]:
    """Means over so many neighbours; what is left over at the end goes."""
    count = len(t) // size
    if size == 1 or not count:
        return t, values
    return (
        t[: count * size].reshape(count, size).mean(axis=1),
        values[: count * size].reshape(count, size, -1).mean(axis=1),
    )


def _nearest(seen: Measurements, time_s: float) -> FloatArray:
    return np.asarray(seen.position[int(np.argmin(np.abs(seen.frame_t - time_s)))])


def borders(scene: Scene) -> list[float]:
    """Where windows meet: in visible time, a margin away from gaps where there is room."""
    start_s, end_s = float(scene.t[0]), float(scene.t[-1])
    found = [start_s]
    while end_s - found[-1] > 1.5 * WINDOW_S:
        latest = found[-1] + LONGEST_S
        place = found[-1] + WINDOW_S
        for gap in scene.gaps:
            if gap.start_s - MARGIN_S < place < gap.end_s + MARGIN_S:
                place = gap.end_s + MARGIN_S
        found.append(min(place, latest))
    found[-1] = end_s if len(found) > 1 and end_s - found[-1] < 0.25 * WINDOW_S else found[-1]
    return found if found[-1] == end_s else [*found, end_s]


def likeliest(scene: Scene, seen: Measurements) -> Kernel:
    """The hyper-parameters under which visible stretches, evenly spread, are likeliest."""
    spread = float(seen.position.var(axis=0).mean())
    start = replace(
        PUBLISHED,
        variance=max(PUBLISHED.variance, spread),
        position_sigma=max(white_sigma(scene), LEAST_SIGMA_M),
    )
    stretches = _training(scene, seen)
    if not stretches:
        return start

    def kernel(x: FloatArray) -> Kernel:
        w, sigma_a = np.exp(np.clip(x, BOUNDS[:, 0], BOUNDS[:, 1]))
        return replace(start, rate=float(w), acceleration_sigma=float(sigma_a))

    def loss(x: FloatArray) -> float:
        outside = float(np.sum((x - np.clip(x, BOUNDS[:, 0], BOUNDS[:, 1])) ** 2))
        return 100.0 * outside - sum(log_likelihood(kernel(x), stretch) for stretch in stretches)

    first = np.log([start.rate, start.acceleration_sigma])
    options = {"xatol": 0.05, "fatol": 0.5, "maxfev": 60}
    return kernel(minimize(loss, first, method="Nelder-Mead", options=options).x)


def _training(scene: Scene, seen: Measurements) -> list[Measurements]:
    """Visible stretches, each about its own mean."""
    size = max(round(len(seen.acc_t) / (scene.t[-1] - scene.t[0]) / TRAINING_RATE_HZ), 1)
    found = []
    for start_s in np.arange(scene.t[0], scene.t[-1] - TRAINING_S, TRAINING_S):
        if any(gap.start_s < start_s + TRAINING_S and gap.end_s > start_s for gap in scene.gaps):
            continue
        part = seen.between(start_s, start_s + TRAINING_S)
        if len(part.frame_t) >= 10 and len(part.acc_t) >= 10 * size:
            level = part.position.mean(axis=0)
            averaged = _averaged(part.acc_t, part.acceleration, size)
            found.append(Measurements(part.frame_t, part.position - level, *averaged))
    return found[:: max(len(found) // TRAINING_STRETCHES, 1)][:TRAINING_STRETCHES]
