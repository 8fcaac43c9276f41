"""What the camera's residuals tell: the noise of each joint, and how long it remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..measurements.joint_noise import JointNoise
from ..recording import JOINTS, FloatArray
from ..window.problem import Solution, Window

#: Autocorrelation is followed up to this lag, s.
LONGEST_LAG_S = 1.0
#: Residuals count no more than so many robust sigmas.
CLIP = 4.0
#: A joint's noise is never taken for less, m.
SMALLEST_SIGMA_M = 5e-4


def joint_noise(windows: list[Window], solutions: list[Solution]) -> dict[str, JointNoise]:
    """Noise of each forearm joint from its residuals (camera minus answer) in all windows."""
    found: dict[str, list[FloatArray]] = {}
    times: dict[str, list[FloatArray]] = {}
    for window, solution in zip(windows, solutions, strict=True):
        for measured in window.joint_measurements:
            found.setdefault(measured.joint, []).append(solution.residuals[measured.joint])
            times.setdefault(measured.joint, []).append(measured.t_s)
    memory = _memory(found, times)
    return {joint: _noise(np.vstack(found[joint]), memory) for joint in found}


@dataclass(frozen=True)
class _Memory:
    """Pooled over the joints: long-run variance over the variance, and the share that neighbours share."""

    long_run: float
    neighbours: float


def _robust(residual: FloatArray) -> float:
    return max(1.4826 * float(np.median(np.abs(residual))), SMALLEST_SIGMA_M)


def _noise(residual: FloatArray, memory: _Memory) -> JointNoise:
    limit = CLIP * _robust(residual)
    sample = max(float(np.sqrt(np.mean(np.clip(residual, -limit, limit) ** 2))), SMALLEST_SIGMA_M)
    return JointNoise(
        sample_m=sample,
        effective_m=sample * float(np.sqrt(memory.long_run)),
        memory_m=sample * float(np.sqrt(memory.neighbours)),
    )


def _memory(found: dict[str, list[FloatArray]], times: dict[str, list[FloatArray]]) -> _Memory:
    """Autocorrelation of all joints together: one joint alone would talk itself out of the solution."""
    spacing = np.concatenate([np.diff(t) for each in times.values() for t in each])
    step = float(np.median(spacing)) if len(spacing) else 1.0
    lags = max(round(LONGEST_LAG_S / step), 1)
    sums, counts = np.zeros(lags + 1), np.zeros(lags + 1)
    for joint, series in found.items():
        robust = _robust(np.vstack(series))
        for residual, t in zip(series, times[joint], strict=True):
            x = np.clip(residual / robust, -CLIP, CLIP)
            for lag in range(min(lags + 1, len(x))):
                near = np.abs(t[lag:] - t[: len(t) - lag] - lag * step) < 0.5 * step
                sums[lag] += np.sum(x[lag:][near] * x[: len(x) - lag][near])
                counts[lag] += 3 * near.sum()
    covariance = sums / np.maximum(counts, 1.0)
    rho = covariance[1:] / max(covariance[0], 1e-12)
    ends = np.flatnonzero(rho < 0.05)
    rho = rho[: ends[0]] if len(ends) else rho
    neighbours = float(np.clip(rho[:3].mean(), 0.0, 1.0)) if len(rho) >= 3 else 0.0
    return _Memory(1.0 + 2.0 * float(rho.sum()), neighbours)


def sigma_by_joint(noise: dict[str, JointNoise], fallback_m: float) -> FloatArray:
    """Effective sigma in the order of `JOINTS` (5,), m an axis; the shoulder as the worst of the others."""
    known = {joint: each.effective_m for joint, each in noise.items()}
    worst = max(known.values(), default=fallback_m)
    return np.array([known.get(joint, worst) for joint in JOINTS])
