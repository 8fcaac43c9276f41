"""Repetitions of an exercise: the round that comes again, and where."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..linalg import masked_correlation
from .motion import Motion
from .movement import Movement
from .settings import MatchingRepetitions
from .time_warping import match_cost

#: Postures are compared at this rate, Hz: an exercise is slower than 2 Hz.
RATE_HZ = 10.0
#: A recording whose posture does not correlate with itself this well after a round has no rounds.
LEAST_CORRELATION = 0.5
#: Two rounds may share this part of their time at most.
OVERLAP = 0.2


def find_repetitions(motion: Motion, settings: MatchingRepetitions) -> tuple[Movement, ...]:
    """Rounds of an exercise, in the order of time.

    The length of a round is where the posture (hand from shoulder in {K}, each axis by its standard
    deviation) correlates with itself best after a shift; the round to match is the part of that length whose
    second occurrence is most like it. It is then looked for throughout by dynamic time warping
    (`time_warping.match_cost`), the best first, without overlaps, until the mean distance is more than
    `likeness` standard deviations of the motion.

    Parameters
    ----------
    motion : Motion
        Of the hand and, where it is known, the shoulder.
    settings : MatchingRepetitions
        Where the first round lies, if that is known; lengths and likeness.

    Returns
    -------
    repetitions : tuple of Movement
        Empty where nothing comes again.
    """
    t, posture = _posture(motion)
    if len(t) < 2 * settings.shortest_s * RATE_HZ:
        return ()
    pattern = _given(t, settings) or _round(posture, settings)
    if pattern is None or pattern.stop - pattern.start < settings.shortest_s * RATE_HZ:
        return ()
    cost, start = match_cost(posture[pattern], posture)
    limit = settings.likeness * np.sqrt(posture.shape[1])
    places: list[slice] = []
    for end in np.argsort(cost, kind="stable"):
        if cost[end] > limit:
            break
        place = slice(int(start[end]), int(end) + 1)
        if place.stop - place.start >= 2 and not any(_overlap(place, other) > OVERLAP for other in places):
            places.append(place)
    if len(places) < 2:
        return ()
    places.sort(key=lambda place: place.start)
    return tuple(Movement(float(t[place.start]), float(t[place.stop - 1]), "repetition") for place in places)


def _posture(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Even times (m,), and the hand's place from the shoulder (m, 3) in standard deviations."""
    grid = motion.grid
    if len(grid.t_s) < 2:
        return np.empty(0), np.empty((0, 3))
    hand = motion.hand - motion.joints["shoulder"] if "shoulder" in motion.joints else motion.hand
    t = np.arange(grid.t_s[0], grid.t_s[-1], 1.0 / RATE_HZ)
    nearest = np.clip(np.searchsorted(grid.t_s, t), 0, len(grid.t_s) - 1)
    posture = hand[nearest].copy()
    posture[np.abs(grid.t_s[nearest] - t) > 1.0 / RATE_HZ] = np.nan  # a pause of the IMU
    spread = float(np.sqrt(np.nansum(np.nanvar(posture, axis=0)) / 3.0))
    return t, (posture - np.nanmean(posture, axis=0)) / max(spread, 1e-9)


def _given(t: FloatArray, settings: MatchingRepetitions) -> slice | None:
    if settings.start_s is None or settings.end_s is None:
        return None
    first, last = np.searchsorted(t, [settings.start_s, settings.end_s])
    return slice(int(first), int(last))


def _round(posture: FloatArray, settings: MatchingRepetitions) -> slice | None:
    """The part of the series that comes again most alike; None where nothing does."""
    n = len(posture)
    correlations = [masked_correlation(axis, axis, 1e-6)[0] for axis in posture.T]
    weights = np.nanvar(posture, axis=0)
    by_lag = np.average(correlations, axis=0, weights=weights)[n - 1 :]
    shortest = round(settings.shortest_s * RATE_HZ)
    longest = min(round(settings.longest_s * RATE_HZ), n // 2 + 1, n - 1)
    if longest <= shortest:
        return None
    inside = by_lag[shortest : longest + 1]
    peaks = np.flatnonzero((inside[1:-1] >= inside[:-2]) & (inside[1:-1] >= inside[2:])) + 1
    if not len(peaks) or inside[peaks].max() < LEAST_CORRELATION:
        return None
    # of shifts that are nearly as good the shortest: twice a round is a round as well
    good = peaks[inside[peaks] >= inside[peaks].max() - 0.1]
    length = shortest + int(good[0])
    apart = np.linalg.norm(posture[length:] - posture[:-length], axis=1)
    mean = np.convolve(np.nan_to_num(apart, nan=1e3), np.ones(length) / length, mode="valid")
    begin = int(np.argmin(mean)) if len(mean) else 0
    return slice(begin, begin + length)


def _overlap(a: slice, b: slice) -> float:
    """The time that two share, as a part of the shorter one."""
    shared = min(a.stop, b.stop) - max(a.start, b.start)
    return max(shared, 0) / min(a.stop - a.start, b.stop - b.start)
