"""Movements of the hand, by thresholds of its speed."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..linalg import runs
from .low_pass import TimeGrid
from .movement import Movement
from .settings import SegmentingMovements


def find_movements(speed: FloatArray, grid: TimeGrid, settings: SegmentingMovements) -> list[slice]:
    """Rows of the movements, in the order of time.

    A movement is a run in which the hand gets faster than `start_m_s`; it starts and ends where the speed
    falls below 5 % of its peak (as is usual in reaching: Alt Murphy et al. 2011 take 2 %, others 5 or 10 %)
    or below `rest_m_s`, whichever is more, so that the noise of a resting hand does not prolong it.

    Parameters
    ----------
    speed : ndarray, shape (n,), m/s
        Of the hand.
    grid : TimeGrid
        Its times.
    settings : SegmentingMovements
        The thresholds.

    Returns
    -------
    movements : list of slice
        From onset to offset; two that touch are one.
    """
    places: list[slice] = []
    quick = np.nan_to_num(speed)
    for run in grid.runs:
        inside = quick[run]
        for core in runs(inside > settings.start_m_s):
            peak = float(inside[core].max())
            rest = inside <= min(max(settings.rest_m_s, settings.rest_share * peak), settings.start_m_s)
            before, after = np.flatnonzero(rest[: core.start]), np.flatnonzero(rest[core.stop :])
            onset = run.start + (int(before[-1]) if len(before) else 0)
            offset = run.start + (core.stop + int(after[0]) + 1 if len(after) else len(inside))
            if places and onset < places[-1].stop:  # the hand did not come to rest between them
                onset = places.pop().start
            places.append(slice(onset, offset))
    return [place for place in places if place.stop - place.start >= settings.shortest_s * grid.rate_hz]


def as_movements(places: list[slice], grid: TimeGrid) -> tuple[Movement, ...]:
    """Rows as times."""
    return tuple(
        Movement(float(grid.t_s[place.start]), float(grid.t_s[place.stop - 1]), "movement")
        for place in places
    )
