"""Where a visible stretch can be hidden, so that what comes back can be compared with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..recording import FOREARM_JOINTS, BoolArray, FloatArray, Recording

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
    """A stretch to hide, on the camera's clock: its ends are frames that stay visible, s."""

    start_s: float
    end_s: float

    @property
    def length_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s

    def contains(self, t_s: FloatArray) -> BoolArray:
        """True strictly between the visible frames beside the gap."""
        return (t_s > self.start_s) & (t_s < self.end_s)


def forearm_seen(recording: Recording) -> BoolArray:
    """(F,) the camera tracks the forearm: two of its joints, or the one that the recording has."""
    arm = recording.arm
    tracked = np.array([arm.tracked(joint) for joint in FOREARM_JOINTS])
    has = max(1, int(tracked.any(axis=1).sum()))
    return tracked.sum(axis=0) >= min(2, has)


def visible_runs(recording: Recording) -> list[tuple[float, float]]:
    """Stretches (start, end) in which the forearm is seen and the IMU runs, camera clock, s."""
    seen = recording.arm.t_s[forearm_seen(recording)]
    imu = recording.imu.t_s
    if len(seen) < 2 or len(imu) < 2:
        return []
    cuts = np.flatnonzero(np.diff(seen) > FLICKER_S) + 1
    runs = [(float(part[0]), float(part[-1])) for part in np.split(seen, cuts)]
    pauses = np.flatnonzero(np.diff(imu) > max(IMU_PAUSE_S, 5.0 / recording.imu.rate_hz))
    barred = [(float(imu[i]) - CLOCK_S, float(imu[i + 1]) + CLOCK_S) for i in pauses]
    barred += [(-np.inf, float(imu[0])), (float(imu[-1]), np.inf)]
    for start, end in barred:
        runs = [piece for run in runs for piece in _without(run, start, end)]
    return runs


def _without(run: tuple[float, float], start: float, end: float) -> list[tuple[float, float]]:
    """A run less the interval (start, end)."""
    left, right = (run[0], min(run[1], start)), (max(run[0], end), run[1])
    return [piece for piece in (left, right) if piece[1] > piece[0]]


def place_gaps(
    recording: Recording,
    length_s: float,
    rng: np.random.Generator,
    *,
    count: int,
    margin_s: float = 1.5,
) -> list[HiddenGap]:
    """Draw gaps of one length at random, in order of time; fewer, or none, where there is no room.

    Each keeps `margin_s` of visible time on both sides and twice that to the next. A recording too
    short for any gets one gap in the middle of its longest visible run if 0.4 s stay visible on
    both sides. With a truth, at least half of a gap must be scored.
    """
    runs = visible_runs(recording)
    open_starts = _starts(recording, runs, length_s, margin_s)
    chosen: list[HiddenGap] = []
    while len(open_starts) and len(chosen) < count:
        start = float(rng.choice(open_starts))
        gap = _snapped(recording, start, length_s)
        reach = length_s + 2.0 * margin_s
        if gap is None or not _worth_scoring(recording, gap):
            open_starts = open_starts[open_starts != start]
            continue
        chosen.append(gap)
        open_starts = open_starts[np.abs(open_starts - gap.start_s) > reach]
    if not chosen and runs:
        chosen = _middle(recording, runs, length_s)
    return sorted(chosen, key=lambda gap: gap.start_s)


def _starts(
    recording: Recording, runs: list[tuple[float, float]], length_s: float, margin_s: float
) -> FloatArray:
    """Seen frames at which a gap may start, s."""
    seen = recording.arm.t_s[forearm_seen(recording)]
    fits = np.zeros(len(seen), dtype=bool)
    for start, end in runs:
        fits |= (seen >= start + margin_s) & (seen + length_s + margin_s <= end)
    return seen[fits]


def _snapped(recording: Recording, start_s: float, length_s: float) -> HiddenGap | None:
    """The gap from one seen frame to the seen frame nearest to its length."""
    seen = recording.arm.t_s[forearm_seen(recording)]
    later = seen[seen > start_s]
    if not len(later):
        return None
    gap = HiddenGap(start_s, float(later[np.argmin(np.abs(later - start_s - length_s))]))
    hides_something = gap.contains(seen).any()
    return gap if hides_something and abs(gap.length_s - length_s) <= FLICKER_S else None


def _worth_scoring(recording: Recording, gap: HiddenGap) -> bool:
    """With a truth, at least half of the gap's samples must be finite and scored."""
    truth = recording.truth
    if truth is None or not len(truth):
        return True
    inside = gap.contains(truth.t_s)
    good = truth.score & np.isfinite(truth.position).all(axis=1)
    return bool(inside.any() and good[inside].mean() >= 0.5)


def _middle(recording: Recording, runs: list[tuple[float, float]], length_s: float) -> list[HiddenGap]:
    """One gap in the middle of the longest run, if enough stays visible beside it."""
    start, end = max(runs, key=lambda run: run[1] - run[0])
    seen = recording.arm.t_s[forearm_seen(recording)]
    seen = seen[(seen >= start) & (seen <= end)]
    if end - start < length_s + 2 * LEAST_SIDE_S or len(seen) < 3:
        return []
    at = float(seen[np.argmin(np.abs(seen - 0.5 * (start + end - length_s)))])
    gap = _snapped(recording, at, length_s)
    return [gap] if gap is not None and _worth_scoring(recording, gap) else []
