"""What is measured of an angle: range, extremes, percentiles, time in zones, peak speed."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..joint_angles import wrapped_deg
from ..linalg import runs
from .measure import UNKNOWN, Figure, share_of

#: Width of a zone, degrees (Kee and Karwowski's and RULA's tables are coarser; studies differ).
ZONE_DEG = 10
PERCENTILES = (5, 50, 95)
#: An extreme rests on the samples this near to it, degrees; a peak speed on those this near to it, as a part.
NEAR_DEG, NEAR_SHARE = 2.0, 0.05
#: Fewer known samples than this do not determine an angle, s.
SHORTEST_S = 0.3


def centred(angle: FloatArray, centre_deg: float) -> FloatArray:
    """Angles (n,) brought to within half a turn of their centre, so that a range does not jump at 180."""
    return np.asarray(centre_deg + wrapped_deg(angle - centre_deg))


def centre_of(angle: FloatArray) -> float:
    """What angles (n,) are counted from: half a turn from the middle of the widest empty arc, degrees."""
    known = np.sort(wrapped_deg(angle[np.isfinite(angle)]))
    if not len(known):
        return float("nan")
    arcs = np.diff(known, append=known[0] + 360.0)
    widest = int(np.argmax(arcs))
    if arcs[widest] < ZONE_DEG:
        return float("nan")
    return float(wrapped_deg(np.asarray(known[widest] + 0.5 * arcs[widest] + 180.0)))


def angle_figures(
    name: str,
    angle: FloatArray,  # (n,) deg
    occluded: BoolArray,  # bool (n,)
    rate_hz: float,
) -> dict[str, Figure]:
    """Range, extremes, percentiles and peak speed of an angle over some time."""
    keys = [f"{name}_{what}_deg" for what in ("range", "min", "max", *(f"p{p}" for p in PERCENTILES))]
    known = np.isfinite(angle)
    if known.sum() < SHORTEST_S * rate_hz:
        return dict.fromkeys([*keys, f"{name}_peak_speed_deg_s"], UNKNOWN)
    values, hidden = angle[known], occluded[known]
    low, high = float(values.min()), float(values.max())
    share_low = share_of(hidden, values <= low + NEAR_DEG)
    share_high = share_of(hidden, values >= high - NEAR_DEG)
    figures = [
        Figure(high - low, 0.5 * (share_low + share_high)),
        Figure(low, share_low),
        Figure(high, share_high),
    ]
    for percentile in np.percentile(values, PERCENTILES):
        away = np.abs(values - percentile)
        near = away <= max(NEAR_DEG, float(away.min()))
        figures.append(Figure(float(percentile), share_of(hidden, near)))
    speed = np.abs(_speed(angle, known, rate_hz))
    peak = float(np.nanmax(speed))
    with np.errstate(invalid="ignore"):
        quick = speed >= (1.0 - NEAR_SHARE) * peak
    figures.append(Figure(peak, share_of(occluded, quick)))
    return dict(zip([*keys, f"{name}_peak_speed_deg_s"], figures, strict=True))


def zone_figures(
    name: str,
    angle: FloatArray,  # (n,) deg
    occluded: BoolArray,  # bool (n,)
) -> dict[int, Figure]:
    """Percent of the time that an angle is known in which it is in each zone of 10 degrees."""
    known = np.isfinite(angle)
    if not known.any():
        return {}
    lower = (np.floor(wrapped_deg(angle[known]) / ZONE_DEG) * ZONE_DEG).astype(int)
    hidden = occluded[known]
    return {
        int(zone): Figure(100.0 * float((lower == zone).mean()), share_of(hidden, lower == zone))
        for zone in np.unique(lower)
    }


def _speed(angle: FloatArray, known: BoolArray, rate_hz: float) -> FloatArray:
    """Derivative (n,), deg/s, inside runs that are known; the angle may turn over within them."""
    speed = np.full(len(angle), np.nan)
    for run in runs(known):
        if run.stop - run.start >= 3:
            speed[run] = np.gradient(np.unwrap(angle[run], period=360.0), 1.0 / rate_hz)
    return speed if np.isfinite(speed).any() else np.zeros(len(angle))
