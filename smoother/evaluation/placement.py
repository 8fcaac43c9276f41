"""Where visible frames can be hidden, so that what is recovered can be compared with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..measurements.visibility import accepted_samples, visible_frames
from ..recording import Recording

#: Frames without the forearm up to this long do not end a visible run, s.
FLICKER_S = 0.2
#: An IMU that is silent for longer than this is paused, s.
IMU_PAUSE_S = 0.1
#: How far camera and IMU clocks may disagree before the offset is known, s.
CLOCK_S = 0.25
#: What must remain visible on each side of the one gap of a short recording, s.
LEAST_SIDE_S = 0.4


@dataclass(frozen=True)
class HiddenGap:
    """A gap to make, on the camera's clock.

    Attributes
    ----------
    start_s, end_s : float, s
        The frames beside it, which stay visible.
    """

    start_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s

    def contains(self, t_s: FloatArray) -> BoolArray:
        """True strictly between the visible frames beside the gap."""
        return (t_s > self.start_s) & (t_s < self.end_s)


def visible_times(recording: Recording) -> FloatArray:
    """Times (F,) of the frames that see the forearm, on the camera's clock, s."""
    return recording.arm.t_s[visible_frames(recording.arm, accepted_samples(recording.arm))]


def visible_runs(recording: Recording) -> list[tuple[float, float]]:
    """Runs (start, end) in which the forearm is seen and the IMU is not paused, camera's clock, s."""
    visible_s, imu = visible_times(recording), recording.imu.t_s
    if len(visible_s) < 2 or len(imu) < 2:
        return []
    cuts = np.flatnonzero(np.diff(visible_s) > FLICKER_S) + 1
    runs = [(float(times[0]), float(times[-1])) for times in np.split(visible_s, cuts)]
    pauses = np.flatnonzero(np.diff(imu) > max(IMU_PAUSE_S, 5.0 / recording.imu.rate_hz))
    barred = [(float(imu[i]) - CLOCK_S, float(imu[i + 1]) + CLOCK_S) for i in pauses]
    barred += [(-np.inf, float(imu[0])), (float(imu[-1]), np.inf)]
    for start, end in barred:
        runs = [rest for run in runs for rest in _without(run, start, end)]
    return runs


def _without(run: tuple[float, float], start: float, end: float) -> list[tuple[float, float]]:
    """A run less the interval (start, end)."""
    before, after = (run[0], min(run[1], start)), (max(run[0], end), run[1])
    return [rest for rest in (before, after) if rest[1] > rest[0]]


def place_gaps(
    recording: Recording,
    length_s: float,
    rng: np.random.Generator,
    *,
    count: int,
    margin_s: float = 1.5,
) -> list[HiddenGap]:
    """Draw gaps of one length at random.

    Each keeps `margin_s` of visible time on both sides and twice that to the next. A recording too
    short for any gets one gap in the middle of its longest visible run if 0.4 s stay visible on
    both sides. With a truth, at least half of a gap must be scored.

    Parameters
    ----------
    recording : Recording
        What they are to be hidden in.
    length_s : float, s
        Length of each.
    rng : numpy.random.Generator
        Where they fall.
    count : int
        Most gaps that are drawn.
    margin_s : float, s
        Visible time on each side.

    Returns
    -------
    gaps : list of HiddenGap
        In order of time; fewer, or none, where there is not enough visible time.
    """
    runs, visible_s = visible_runs(recording), visible_times(recording)
    open_starts = _starts(visible_s, runs, length_s, margin_s)
    chosen: list[HiddenGap] = []
    while len(open_starts) and len(chosen) < count:
        start = float(rng.choice(open_starts))
        gap = _snapped(visible_s, start, length_s)
        reach = length_s + 2.0 * margin_s
        if gap is None or not _worth_scoring(recording, gap):
            open_starts = open_starts[open_starts != start]
            continue
        chosen.append(gap)
        open_starts = open_starts[np.abs(open_starts - gap.start_s) > reach]
    if not chosen and runs:
        chosen = _middle(recording, visible_s, runs, length_s)
    return sorted(chosen, key=lambda gap: gap.start_s)


def _starts(
    visible_s: FloatArray, runs: list[tuple[float, float]], length_s: float, margin_s: float
) -> FloatArray:
    """Of the visible frames those at which a gap may start, s."""
    fits = np.zeros(len(visible_s), dtype=bool)
    for start, end in runs:
        fits |= (visible_s >= start + margin_s) & (visible_s + length_s + margin_s <= end)
    return visible_s[fits]


def _snapped(visible_s: FloatArray, start_s: float, length_s: float) -> HiddenGap | None:
    """The gap from one visible frame to the visible frame nearest to its length."""
    later = visible_s[visible_s > start_s]
    if not len(later):
        return None
    gap = HiddenGap(start_s, float(later[np.argmin(np.abs(later - start_s - length_s))]))
    hides_something = gap.contains(visible_s).any()
    return gap if hides_something and abs(gap.length_s - length_s) <= FLICKER_S else None


def _worth_scoring(recording: Recording, gap: HiddenGap) -> bool:
    """With a truth, at least half of the gap's samples must be finite and scored."""
    truth = recording.truth
    if truth is None or not len(truth):
        return True
    inside = gap.contains(truth.t_s)
    good = truth.score & np.isfinite(truth.position).all(axis=1)
    return bool(inside.any() and good[inside].mean() >= 0.5)


def _middle(
    recording: Recording, visible_s: FloatArray, runs: list[tuple[float, float]], length_s: float
) -> list[HiddenGap]:
    """One gap in the middle of the longest run, if enough stays visible beside it."""
    start, end = max(runs, key=lambda run: run[1] - run[0])
    inside = visible_s[(visible_s >= start) & (visible_s <= end)]
    if end - start < length_s + 2 * LEAST_SIDE_S or len(inside) < 3:
        return []
    at = float(inside[np.argmin(np.abs(inside - 0.5 * (start + end - length_s)))])
    gap = _snapped(visible_s, at, length_s)
    return [gap] if gap is not None and _worth_scoring(recording, gap) else []
