"""What the camera's residuals tell: the noise of each joint, and how long it remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ..array_types import FloatArray
from ..linalg import nonnegative_pair
from ..measurements.outliers import JointNoise, noise_key
from ..measurements.rays import OF_THREE
from ..recording import JOINTS
from ..window.problem import Window
from ..window.solution import Solution

#: Autocorrelation is followed up to this lag, s, where this many pairs of samples speak.
LONGEST_LAG_S = 1.5
FEWEST_PAIRS = 100
#: Memories that are tried, s: a skeleton's slow errors last up to a second.
TIMES_S = np.geomspace(0.03, 1.0, 12)
#: A share with a memory counts when it is this many times its standard error.
SIGNIFICANT = 4.0
#: Residuals count no more than this many robust sigmas.
CLIP = 4.0
#: A joint's noise is never taken for less, m.
SMALLEST_SIGMA_M = 5e-4


def joint_noise(windows: list[Window], solutions: list[Solution]) -> dict[str, JointNoise]:
    """Noise of each forearm joint, by camera, from its residuals (camera minus answer) in all windows."""
    found: dict[str, list[FloatArray]] = {}
    times: dict[str, list[FloatArray]] = {}
    for window, solution in zip(windows, solutions, strict=True):
        for measured in window.joint_measurements:
            residual = solution.residuals[measured.key]
            if measured.origin_m is not None:  # across the ray it has two directions of three
                residual = np.sqrt(OF_THREE) * residual
            found.setdefault(measured.key, []).append(residual)
            times.setdefault(measured.key, []).append(measured.t_s)
    memory = _memory(found, times)
    return {joint: _noise(np.vstack(found[joint]), memory) for joint in found}


def in_common(windows: list[Window], solutions: list[Solution]) -> float:
    """Variance of the sum of a camera's joint errors over that of independent errors; at least 1.

    A skeleton that is fitted to an image is displaced as a whole. Residuals of elbow and wrist of a Kinect v1
    correlate by 0.1 to 0.8; those of independent errors by -0.2 to 0.
    """
    together = apart = 0.0
    for window, solution in zip(windows, solutions, strict=True):
        for camera in {measured.camera for measured in window.joint_measurements}:
            own = [measured for measured in window.joint_measurements if measured.camera == camera]
            whitened = [solution.residuals[each.key] / each.sigma_m[:, None] for each in own]
            clipped = [np.clip(x / _robust(x), -CLIP, CLIP) for x in whitened]
            _, frame = np.unique(np.concatenate([each.t_s for each in own]), return_inverse=True)
            total = np.zeros((frame.max() + 1, 3))
            np.add.at(total, frame, np.vstack(clipped))
            together += float((total**2).sum())
            apart += sum(float((x**2).sum()) for x in clipped)
    return max(together / apart, 1.0) if apart else 1.0


@dataclass(frozen=True)
class _Memory:
    """Pooled over the joints; white noise by default."""

    long_run: float = 1.0
    hidden: float = 1.0
    neighbours: float = 0.0


def _robust(residual: FloatArray) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), SMALLEST_SIGMA_M)


def _noise(residual: FloatArray, memory: _Memory) -> JointNoise:
    limit = CLIP * _robust(residual)
    sample = max(float(np.sqrt(np.mean(np.clip(residual, -limit, limit) ** 2))), SMALLEST_SIGMA_M)
    return JointNoise(
        sample_m=sample,
        effective_m=sample * float(np.sqrt(memory.hidden * memory.long_run)),
        memory_m=sample * float(np.sqrt(memory.neighbours)),
    )


def _memory(found: dict[str, list[FloatArray]], times: dict[str, list[FloatArray]]) -> _Memory:
    """Autocorrelation of all joints together: one joint alone would talk itself out of the solution."""
    spacing = np.concatenate([np.diff(t) for each in times.values() for t in each])
    step = float(np.median(spacing)) if len(spacing) else 1.0
    lags = max(round(LONGEST_LAG_S / step), 1)
    lag_s = step * np.arange(lags + 1)
    sums, counts = np.zeros(lags + 1), np.zeros(lags + 1)
    for joint, series in found.items():
        robust = _robust(np.vstack(series))
        for residual, t in zip(series, times[joint], strict=True):
            x = np.clip(residual / robust, -CLIP, CLIP)
            # each sample with those after it: nothing follows the last ones
            later_x = sliding_window_view(np.pad(x, ((0, lags), (0, 0))), lags + 1, axis=0)
            later_t = sliding_window_view(np.pad(t, (0, lags), constant_values=np.inf), lags + 1)
            near = np.abs(later_t - t[:, None] - lag_s) < 0.5 * step
            sums += (near * (x[:, None] @ later_x)[:, 0]).sum(axis=0)
            counts += 3 * near.sum(axis=0)
    covariance = sums / np.maximum(counts, 1.0)
    return _fitted(covariance / max(covariance[0], 1e-12), counts, step)


def _fitted(rho: FloatArray, counts: FloatArray, step_s: float) -> _Memory:
    """White noise and a share `a` with a memory, exp(-lag / tau), behind an autocorrelation."""
    lag_s = step_s * np.arange(1, len(rho))
    known = counts[1:] >= FEWEST_PAIRS
    if known.sum() < 3:
        return _Memory()
    y, weight = rho[1:][known], np.sqrt(counts[1:][known])
    best, found = np.inf, _Memory()
    for tau_s in TIMES_S:
        decay = np.exp(-lag_s[known] / tau_s)
        columns = weight[:, None] * np.stack([decay, -np.ones_like(decay)], axis=1)
        (a, b), misfit = nonnegative_pair(columns, weight * y)
        if misfit < best:
            # neighbours are no news of a slow error, so the share's own error goes by its memory
            independent = counts[0] * step_s / (step_s + 2.0 * tau_s)
            best = misfit
            if a * np.sqrt(independent) < SIGNIFICANT:
                found = _Memory()
                continue
            hidden, share = 1.0 + b, a / (1.0 + b)
            ratio = np.exp(-step_s / tau_s)
            found = _Memory(
                1.0 + 2.0 * share * ratio / (1.0 - ratio), hidden, float(np.clip(y[:3].mean(), 0, 1))
            )
    return found


def sigma_by_camera(noise: dict[str, JointNoise], fallback_m: float, cameras: int) -> FloatArray:
    """Effective sigma of each camera's joints (c, 5), m per axis; see `sigma_by_joint`."""
    rows = []
    for camera in range(cameras):
        by_joint = {joint: noise[key] for joint in JOINTS if (key := noise_key(joint, camera)) in noise}
        rows.append(sigma_by_joint(by_joint or noise, fallback_m))
    return np.array(rows)


def sigma_by_joint(noise: dict[str, JointNoise], fallback_m: float) -> FloatArray:
    """Effective sigma in the order of `JOINTS` (5,), m per axis."""
    known = {joint: each.effective_m for joint, each in noise.items()}
    best = min(known.values(), default=fallback_m)
    return np.array([known.get(joint, best) for joint in JOINTS])
