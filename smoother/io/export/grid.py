"""A recovery at times with a constant step, as motion formats want it, and ready to be written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...result import Recovery

#: Stamps this near to a constant step are treated as constant, s.
STEADY_S = 1e-6
#: Samples farther apart than this, in steps, are not joined.
MOST_STEPS = 2.5


@dataclass(frozen=True)
class Export:
    """An arm in a format: all that can fail for the data's sake is behind us."""

    rows: int  # In the file
    write: Callable[[Path, bool], None]  # Writes it to a path; the second argument is `force`
    rate_hz: float | None = None  # Rows per second where the step is constant
    frame: str | None = None  # Axes of the positions
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each


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


def at_grid(
    t_s: FloatArray,  # (n,) s
    values: FloatArray,  # (n, ..)
    grid: Grid,
    has: BoolArray | None = None,  # (n,): what there is; None for the finite ones
) -> FloatArray:  # (G, ..)
    """Values at the grid's times, nan where there are none.

    Samples of a recovery by cubic splines; a camera's frames, stated by `has`, by straight lines, and one
    alone at the time that is nearest.
    """
    from scipy.interpolate import CubicSpline

    if grid.same and has is None:
        return values
    flat = values.reshape(len(values), -1)
    out = np.full((len(grid.t_s), flat.shape[1]), np.nan)
    for run in unbroken(t_s, np.asarray(np.isfinite(flat).all(axis=1)) if has is None else has):
        own, first_s = t_s[run], t_s[run.start]
        first, last = np.searchsorted(grid.t_s, [first_s - STEADY_S, own[-1] + STEADY_S])
        at = grid.t_s[first:last]
        if has is None and len(own) > 1:
            out[first:last] = CubicSpline(own, flat[run])(at)
        elif len(at):
            for column, of_run in enumerate(flat[run].T):
                out[first:last, column] = np.interp(at, own, of_run)
        elif has is not None:
            place = int(np.abs(grid.t_s - first_s).argmin())
            if abs(grid.t_s[place] - first_s) <= 0.5 / grid.rate_hz:
                out[place] = flat[run.start]
    return out.reshape(len(grid.t_s), *values.shape[1:])


def unbroken(t_s: FloatArray, has: BoolArray) -> list[slice]:
    """Runs of samples that all have a value and follow each other in time."""
    step = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
    index = np.flatnonzero(has)
    apart = (np.diff(index) > 1) | (np.diff(t_s[index]) > MOST_STEPS * step)
    parts = np.split(index, np.flatnonzero(apart) + 1)
    return [slice(int(part[0]), int(part[-1]) + 1) for part in parts if len(part)]
