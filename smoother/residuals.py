"""What the camera's residuals tell: noise of each joint, with its memory, and a wrong clock offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .recording import JOINTS, FloatArray
from .window import Solution, Window

#: Autocorrelation is followed up to this lag, s.
LONGEST_LAG_S = 1.0
#: Residuals count no more than so many robust sigmas.
CLIP = 4.0
#: A joint's noise is never taken for less, m.
SMALLEST_SIGMA_M = 5e-4


@dataclass(frozen=True)
class JointNoise:
    """Noise of a joint's samples, m an axis.

    `sample_m` is the deviation of one sample; `effective_m` that of a white noise with the same
    long-run variance, which is what a graph of independent samples must be told; `memory_m` the part
    that neighbours share.
    """

    sample_m: float
    effective_m: float
    memory_m: float


def joint_noise(windows: list[Window], solutions: list[Solution]) -> dict[str, JointNoise]:
    """Noise of each forearm joint from its residuals (camera minus answer) in all windows."""
    found: dict[str, list[FloatArray]] = {}
    times: dict[str, list[FloatArray]] = {}
    for window, solution in zip(windows, solutions, strict=True):
        for sight in window.sights:
            found.setdefault(sight.joint, []).append(solution.residuals[sight.joint])
            times.setdefault(sight.joint, []).append(window.t[sight.node])
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
    sample = float(np.sqrt(np.mean(np.clip(residual, -limit, limit) ** 2)))
    return JointNoise(
        sample_m=sample,
        effective_m=sample * float(np.sqrt(memory.long_run)),
        memory_m=sample * float(np.sqrt(memory.neighbours)),
    )


def _memory(found: dict[str, list[FloatArray]], times: dict[str, list[FloatArray]]) -> _Memory:
    """Autocorrelation of all joints together: one joint alone would talk itself out of the solution."""
    spacing = np.concatenate([np.diff(t) for each in times.values() for t in each])
    step = float(np.median(spacing)) if len(spacing) else 1.0
    lags = max(int(round(LONGEST_LAG_S / step)), 1)
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


@dataclass(frozen=True)
class OffsetSlope:
    """How the windows' loss changes with the camera's clock offset.

    Attributes
    ----------
    t_s : (w,) middle of each window.
    slope : (w,) minus the derivative of half the weighted squares by the offset, 1/s.
    bound : (w,) upper bound of the second derivative, 1/s^2: the states taken as fixed.
    recording : (w,) which recording each belongs to.
    """

    t_s: FloatArray
    slope: FloatArray
    bound: FloatArray


def offset_slope(windows: list[Window], solutions: list[Solution]) -> OffsetSlope:
    """Derivative of the loss by t_imu - t_camera: sum of residual . velocity / sigma^2 (envelope theorem)."""
    t, slope, bound = [], [], []
    for window, solution in zip(windows, solutions, strict=True):
        g = c = 0.0
        states = solution.states
        for sight in window.sights:
            joints = window.priors.layout.joints
            lever = (
                solution.message.shared.mean[window.priors.layout.lever(sight.joint)]
                if sight.joint in joints
                else np.zeros(3)
            )
            path = states.p + states.R @ lever
            velocity = np.gradient(path, window.t, axis=0)[sight.node]
            residual = solution.residuals[sight.joint]
            size = np.linalg.norm(residual, axis=1) / sight.sigma_m
            weight = np.minimum(1.0, window.noise.huber / np.maximum(size, 1e-9)) / sight.sigma_m**2
            g += float(np.sum(weight * np.einsum("ni,ni->n", residual, velocity)))
            c += float(np.sum(weight * np.einsum("ni,ni->n", velocity, velocity)))
        t.append(0.5 * (window.t[0] + window.t[-1]))
        slope.append(g)
        bound.append(c)
    return OffsetSlope(np.array(t), np.array(slope), np.array(bound))


def sigma_by_joint(noise: dict[str, JointNoise], fallback_m: float) -> FloatArray:
    """Effective sigma in the order of `JOINTS` (5,), m an axis; the shoulder as the worst of the others."""
    known = {joint: each.effective_m for joint, each in noise.items()}
    worst = max(known.values(), default=fallback_m)
    return np.array([known.get(joint, worst) for joint in JOINTS])
