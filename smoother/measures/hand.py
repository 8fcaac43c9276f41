"""What is measured of the hand's way: length, straightness, speed."""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from .figure import UNKNOWN, Figure, share_of

#: Ends nearer than this make no straight line to compare a path with, m.
NEAREST_ENDS_M = 0.05
#: A peak rests on the samples this near to it, as a part of it.
NEAR_SHARE = 0.05


def way_figures(
    hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float, runs: tuple[slice, ...]
) -> dict[str, Figure]:
    """Path length, peak and mean speed of the hand over some time.

    The length is the sum of the distances between low-passed positions; the mean speed is taken over all of
    the time, rests included.

    Parameters
    ----------
    hand : ndarray, shape (n, 3), m
        In {K}.
    speed : ndarray, shape (n,), m/s
        Of the hand.
    occluded : ndarray of bool, shape (n,)
        Not seen by the camera.
    rate_hz : float, Hz
        Samples a second.
    runs : tuple of slice
        Rows without a pause between them; nothing is counted across one.

    Returns
    -------
    figures : dict of str to Figure
        `hand_path_length_m`, `hand_peak_speed_m_s`, `hand_mean_speed_m_s`.
    """
    keys = ("hand_path_length_m", "hand_peak_speed_m_s", "hand_mean_speed_m_s")
    if not np.isfinite(speed).any():
        return dict.fromkeys(keys, UNKNOWN)
    steps = np.zeros(len(hand))
    for run in runs:
        steps[run][1:] = np.nan_to_num(np.linalg.norm(np.diff(hand[run], axis=0), axis=1))
    share = share_of(occluded, steps)
    length, peak = float(steps.sum()), float(np.nanmax(speed))
    with np.errstate(invalid="ignore"):
        near = speed >= (1.0 - NEAR_SHARE) * peak
    seconds = max(sum(run.stop - run.start - 1 for run in runs), 1) / rate_hz
    return {
        keys[0]: Figure(length, share),
        keys[1]: Figure(peak, share_of(occluded, near)),
        keys[2]: Figure(length / seconds, share),
    }


def straightness_figures(
    hand: FloatArray, speed: FloatArray, occluded: BoolArray, rate_hz: float
) -> dict[str, Figure]:
    """Path ratio and time to peak of one movement.

    Path ratio: the way of the hand over the straight line between its ends; 1 = straight (Cirstea and Levin,
    Brain 123:940-953, 2000: index of curvature). Time to peak: from onset to the largest speed, in seconds
    and in percent of the movement (Alt Murphy et al. 2011).

    Parameters
    ----------
    hand : ndarray, shape (n, 3), m
        From onset to offset.
    speed : ndarray, shape (n,), m/s
        Of the hand.
    occluded : ndarray of bool, shape (n,)
        Not seen by the camera.
    rate_hz : float, Hz
        Samples a second.

    Returns
    -------
    figures : dict of str to Figure
        `hand_path_ratio`, `hand_time_to_peak_s`, `hand_time_to_peak_percent`; the ratio is nan where the ends
        are within 5 cm.
    """
    if len(hand) < 3 or not np.isfinite(hand).all():
        return dict.fromkeys(("hand_path_ratio", "hand_time_to_peak_s", "hand_time_to_peak_percent"), UNKNOWN)
    steps = np.linalg.norm(np.diff(hand, axis=0), axis=1)
    straight = float(np.linalg.norm(hand[-1] - hand[0]))
    ratio = float(steps.sum()) / straight if straight >= NEAREST_ENDS_M else float("nan")
    peak = int(np.argmax(speed))
    near = occluded[max(peak - 2, 0) : peak + 3]
    return {
        "hand_path_ratio": Figure(ratio, share_of(occluded[1:], steps)),
        "hand_time_to_peak_s": Figure(peak / rate_hz, share_of(near)),
        "hand_time_to_peak_percent": Figure(100.0 * peak / (len(hand) - 1), share_of(near)),
    }
