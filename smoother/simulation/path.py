"""Smooth curves: minimum-jerk movements through poses, and band-limited noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..array_types import FloatArray

#: Knots a second of a motion; the spline between them is quintic, so C^4.
KNOT_RATE_HZ = 100.0
#: How far a motion is defined beyond its start and end, s.
PAD_S = 0.5


@dataclass(frozen=True)
class PlannedMovement:
    """One movement from rest to rest.

    Attributes
    ----------
    through : ndarray, shape (V, D)
        Points passed without a stop; the last is where it ends.
    duration_s : float, s
        From the start of the movement to its end.
    hold_s : float, s
        Rest after it.
    label : str
        What the movement and its hold are for.
    """

    through: FloatArray
    duration_s: float
    hold_s: float
    label: str = ""

    @property
    def length_s(self) -> float:
        """Movement and hold, s."""
        return self.duration_s + self.hold_s


def knot_times(duration_s: float) -> FloatArray:
    """Times (N,) of the knots of a motion, s, from `-PAD_S` to `duration_s + PAD_S`."""
    count = int(np.ceil((duration_s + 2 * PAD_S) * KNOT_RATE_HZ)) + 1
    return -PAD_S + np.arange(count) / KNOT_RATE_HZ


def follow(start: FloatArray, movements: list[PlannedMovement], t_s: FloatArray) -> FloatArray:
    """Points (N, D) at `t_s` of a path that starts at `start` (D,) at time 0 and moves with minimum jerk.

    Minimum jerk: Flash and Hogan, J. Neuroscience 5:1688-1703 (1985). A movement through via points is the
    quintic spline through them that is at rest at both ends; the time between two points grows with the
    square root of their distance.
    """
    out = np.tile(start, (len(t_s), 1))
    at, begin = start, 0.0
    for movement in movements:
        points = np.vstack([at, movement.through])
        step = np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1) + 1e-9)
        share = np.concatenate([[0.0], np.cumsum(step)])
        curve = wander(begin + movement.duration_s * share / share[-1], points)
        end = begin + movement.duration_s
        moving = (t_s >= begin) & (t_s <= end)
        out[moving] = curve(t_s[moving])
        at, begin = points[-1], begin + movement.length_s
        out[t_s > end] = at
    return out


def wander(times: FloatArray, points: FloatArray) -> BSpline:
    """The minimum-jerk curve through `points` (P, D) at `times` (P,), at rest at both ends."""
    still = np.zeros(points.shape[1])
    rest = [(1, still), (2, still)]
    return make_interp_spline(times, points, k=5, bc_type=(rest, rest))


def band_noise(
    t_s: FloatArray, low_hz: float, high_hz: float, size: int, rng: np.random.Generator
) -> FloatArray:
    """Smooth noise (N, size) of unit expected rms, a sum of eight sinusoids in the band for each column."""
    frequency = rng.uniform(low_hz, high_hz, (8, size))
    phase = rng.uniform(0, 2 * np.pi, (8, size))
    total = np.zeros((len(t_s), size))
    for f, p in zip(frequency, phase, strict=True):
        total += np.sin(2 * np.pi * t_s[:, None] * f + p)
    return total / 2.0  # eight terms of variance 1/2 each


def ramp(t_s: FloatArray, begin_s: float, length_s: float) -> FloatArray:
    """Smooth step (N,) from 0 to 1 that starts at `begin_s` and takes `length_s`."""
    x = np.clip((t_s - begin_s) / length_s, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)
