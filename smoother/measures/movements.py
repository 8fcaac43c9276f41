"""Movements of the hand by thresholds of its speed, and repetitions of an exercise."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import masked_correlation, runs
from .measure import MatchingRepetitions, Movement, SegmentingMovements
from .motion import Motion, TimeGrid


# Dynamic time warping with bounded tempo, own: stumpy compares windows of one fixed length, so a round done
# half as fast does not match; dtaidistance has the subsequence search in compiled extras.
def match_cost(
    pattern: FloatArray,  # (m, k)
    series: FloatArray,  # (n, k)
) -> tuple[FloatArray, IntArray]:  # cost (n,), start int (n,)
    """Least mean distance of the pattern to a part of the series that ends at each sample.

    Sakoe and Chiba, IEEE Trans Acoust Speech Signal Process 26:43-49 (1978), symmetric form, P = 1 (tempo
    between half and double); the series' start is free (Mueller 2007, section 4.4).
    """
    n, columns = len(series), np.arange(len(series))
    distance = [np.nan_to_num(np.linalg.norm(series - row, axis=1), nan=np.inf) for row in pattern]
    # total cost, weight and start of the best path that ends at (row, column); two rows before are enough
    nowhere = (np.full(n, np.inf), np.ones(n), columns)
    before, last = nowhere, (distance[0], np.ones(n), columns)
    for i in range(1, len(pattern)):
        here, above = distance[i], distance[i - 1]
        diagonal, wide, tall = _moved(last, 1), _moved(last, 2), _moved(before, 1)
        totals = np.stack(
            [
                diagonal[0] + 2.0 * here,
                wide[0] + 2.0 * np.concatenate([[np.inf], here[:-1]]) + here,
                tall[0] + 2.0 * above + here,
            ]
        )
        weights = np.stack([diagonal[1] + 2.0, wide[1] + 3.0, tall[1] + 3.0])
        starts = np.stack([diagonal[2], wide[2], tall[2]])
        choice = np.argmin(totals / weights, axis=0)
        before, last = last, (totals[choice, columns], weights[choice, columns], starts[choice, columns])
    return last[0] / last[1], last[2].astype(np.int64)


def _moved(path: tuple[FloatArray, FloatArray, IntArray], by: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """The entries of this many columns before; where there are none no path ends."""
    total, weight, start = (np.concatenate([part[:by], part[:-by]]) for part in path)
    total[:by] = np.inf
    return total, weight, start


def find_movements(
    speed: FloatArray,  # (n,) m/s
    grid: TimeGrid,
    settings: SegmentingMovements,
) -> list[slice]:
    """Rows of the movements: faster than `start_m_s`, from and to `rest_share` of the peak or `rest_m_s`."""
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


#: Postures are compared at this rate, Hz: an exercise is slower than 2 Hz.
RATE_HZ = 10.0
#: A recording whose posture does not correlate with itself this well after a round has no rounds.
LEAST_CORRELATION = 0.5
#: Two rounds may share this part of their time at most.
OVERLAP = 0.2


def find_repetitions(motion: Motion, settings: MatchingRepetitions) -> tuple[Movement, ...]:
    """Rounds of an exercise, in the order of time."""
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
    hand = motion.hand_from_shoulder
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
