"""A recovery at times with a constant step, as motion formats want it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import linalg
from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...result import Recovery

#: Stamps this near to a constant step are treated as constant, s.
STEADY_S = 1e-6
#: Samples farther apart than this, in steps, are not joined.
MOST_STEPS = 2.5


@dataclass(frozen=True)
class Grid:
    """Times with a constant step."""

    t_s: FloatArray  # (G,) s: after the recovery's origin
    rate_hz: float  # Rows per second
    same: bool  # The times are the recovery's own: nothing is interpolated


def constant_step(recovery: Recovery, rate_hz: float | None = None) -> Grid:
    """The recovery's own times where their step is constant, else a grid from the first to the last."""
    t_s = recovery.t_s
    if len(t_s) < 2:
        raise UnoccludeError(
            f"{recovery.name}: {len(t_s)} samples are too few to export with a constant step"
        )
    mean = (len(t_s) - 1) / (t_s[-1] - t_s[0])
    even = t_s[0] + np.arange(len(t_s)) / mean
    steady = bool(np.abs(even - t_s).max() <= STEADY_S)
    if steady and (rate_hz is None or abs(rate_hz / mean - 1) < 1e-9):
        return Grid(t_s, float(mean), same=True)
    if rate_hz is None:
        # A sensor's rate is a round number where its stamps jitter.
        rate_hz = round(float(1.0 / np.median(np.diff(t_s))), 3)
    count = int(np.floor((t_s[-1] - t_s[0]) * rate_hz + 1e-9)) + 1
    return Grid(t_s[0] + np.arange(count) / rate_hz, rate_hz, same=False)


def at_grid(t_s: FloatArray, values: FloatArray, grid: Grid) -> FloatArray:
    """A recovery's values (N, ..) at the grid's times, by cubic splines; nan where there is none."""
    from scipy.interpolate import CubicSpline

    if grid.same:
        return values
    flat = values.reshape(len(values), -1)
    out = np.full((len(grid.t_s), flat.shape[1]), np.nan)
    for run in unbroken(t_s, np.asarray(np.isfinite(flat).all(axis=1))):
        inside = (grid.t_s >= t_s[run.start] - STEADY_S) & (grid.t_s <= t_s[run.stop - 1] + STEADY_S)
        if run.stop - run.start < 2:
            out[inside] = flat[run.start]
        else:
            out[inside] = CubicSpline(t_s[run], flat[run])(grid.t_s[inside])
    return out.reshape(len(grid.t_s), *values.shape[1:])


def nearest(t_s: FloatArray, grid: Grid) -> np.ndarray:
    """(G,) index of the sample nearest to each of the grid's times."""
    return np.arange(len(t_s)) if grid.same else linalg.nearest(t_s, grid.t_s)


def frames_at_grid(
    t_s: FloatArray,  # (F,) s
    values: FloatArray,  # (F, C)
    has: BoolArray,  # bool (F,)
    grid: Grid,
) -> FloatArray:  # (G, C)
    """A camera's values (F, C) at the grid's times: straight lines between frames that follow each other."""
    out = np.full((len(grid.t_s), values.shape[1]), np.nan)
    if not len(grid.t_s):
        return out
    for run in unbroken(t_s, has):
        first, last = np.searchsorted(grid.t_s, [t_s[run.start] - STEADY_S, t_s[run.stop - 1] + STEADY_S])
        for column in range(values.shape[1] if last > first else 0):
            out[first:last, column] = np.interp(grid.t_s[first:last], t_s[run], values[run, column])
        if last == first:  # between two times of the grid
            place = min(first, len(grid.t_s) - 1)
            place -= bool(place and t_s[run.start] - grid.t_s[place - 1] < grid.t_s[place] - t_s[run.start])
            if abs(grid.t_s[place] - t_s[run.start]) <= 0.5 / grid.rate_hz:
                out[place] = values[run.start]
    return out


def unbroken(t_s: FloatArray, has: BoolArray) -> list[slice]:
    """Runs of samples that all have a value and follow each other in time."""
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    index = np.flatnonzero(has)
    apart = (np.diff(index) > 1) | (np.diff(t_s[index]) > MOST_STEPS * step)
    parts = np.split(index, np.flatnonzero(apart) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts if len(part)]
