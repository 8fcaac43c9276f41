"""Noise figures of a sensor at rest: the Allan deviation and what a datasheet calls its parts.

Overlapping Allan deviation (IEEE Std 952, annex C); its square is fitted by the sum of white noise N^2/tau,
bias instability (2 ln 2 / pi) B^2 and rate random walk K^2 tau / 3, none negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from smoother.array_types import FloatArray

#: Shortest rest that gives the white noise, and shortest that can give what is slower, s.
WHITE_S = 20.0
SLOW_S = 300.0
#: Averaging times a decade, and how often the longest fits into the rest.
_A_DECADE = 8
_LONGEST_SHARE = 9
#: Averaging times over which white noise is read, s: longer than filters, shorter than drift.
_WHITE_TAU_S = (0.1, 2.0)
_FLICKER = 2.0 * np.log(2.0) / np.pi
#: A part that makes up less of the variance than this wherever one looks was not seen.
_SEEN = 0.25


@dataclass(frozen=True)
class SensorNoise:
    """One triaxial sensor at rest; per axis (3,), in SI: x is m/s^2 or rad/s.

    Attributes
    ----------
    tau_s : ndarray, shape (k,), s
        Averaging times.
    deviation : ndarray, shape (k, 3)
        Allan deviation, x.
    density : ndarray, shape (3,)
        White noise N, x/sqrt(Hz).
    instability : ndarray, shape (3,)
        Bias instability B, x; nan where the rest was too short to show it.
    walk : ndarray, shape (3,)
        Random walk K, x/sqrt(s); nan likewise.
    duration_s : float, s
        Of the rest.
    """

    tau_s: FloatArray
    deviation: FloatArray
    density: FloatArray
    instability: FloatArray
    walk: FloatArray
    duration_s: float


def allan_noise(samples: FloatArray, rate_hz: float) -> SensorNoise | None:
    """Noise figures of a sensor's samples at rest (N, 3); None where they last less than 20 s."""
    duration = len(samples) / rate_hz
    if duration < WHITE_S:
        return None
    tau, deviation = allan_deviation(samples, rate_hz)
    # independent averages at each time: the relative variance of the Allan variance is one over half of them
    weight = np.sqrt(np.maximum(duration / tau - 1.0, 1.0))
    white = (tau >= max(_WHITE_TAU_S[0], 1.0 / rate_hz)) & (tau <= _WHITE_TAU_S[1])
    density, instability, walk = np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan)
    for axis in range(3):
        variance = deviation[:, axis] ** 2
        if not (variance > 0).all():
            density[axis] = 0.0
            continue
        density[axis] = np.exp(np.average(np.log(variance * tau)[white], weights=weight[white] ** 2) / 2.0)
        if duration < SLOW_S:
            continue
        long = tau >= _WHITE_TAU_S[0]
        parts = np.stack([1.0 / tau, np.full(len(tau), _FLICKER), tau / 3.0], axis=1)[long]
        scale = weight[long] / variance[long]
        power, _ = nnls(parts * scale[:, None], weight[long])
        share = parts * power / (parts @ power)[:, None]
        density[axis] = np.sqrt(power[0]) if power[0] > 0 else density[axis]
        if share[:, 1].max() > _SEEN:
            instability[axis] = np.sqrt(power[1])
        if share[:, 2].max() > _SEEN:
            walk[axis] = np.sqrt(power[2])
    return SensorNoise(tau, deviation, density, instability, walk, duration)


def allan_deviation(samples: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Overlapping Allan deviation of samples (N, 3): averaging times (k,) s, and deviations (k, 3)."""
    count = len(samples)
    longest = max(count // _LONGEST_SHARE, 1)
    steps = int(np.ceil(np.log10(longest) * _A_DECADE)) + 1
    m = np.unique(np.round(np.logspace(0.0, np.log10(longest), steps)).astype(int))
    sums = np.vstack([np.zeros(samples.shape[1]), np.cumsum(samples - samples.mean(axis=0), axis=0)])
    deviation = np.empty((len(m), samples.shape[1]))
    for k, n in enumerate(m):
        second = sums[2 * n :] - 2.0 * sums[n:-n] + sums[: -2 * n]
        deviation[k] = np.sqrt(np.mean(second**2, axis=0) / (2.0 * n**2))
    return m / rate_hz, deviation
