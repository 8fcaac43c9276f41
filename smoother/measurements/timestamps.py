"""Stamps: pauses, jitter taken off, stamps that were not measured, counters, clocks that were set back."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..filters import moving_mean
from ..linalg import robust_sigma
from ..recording import ImuStream

#: Rates that cameras run at, Hz, and how near to one is near, as a part of it.
CAMERA_RATES_HZ = np.array(
    [5.0, 7.5, 10.0, 15.0, 20.0, 24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0]
)
RATE_TOLERANCE = 0.01

#: Longest interval between IMU samples that is bridged, s (or this many sample periods).
PAUSE_S = 0.08
PAUSE_SAMPLES = 5.0
#: Stamps that scatter by more than this part of a tick are dejittered; what departs from the tick more
#: slowly than this stays, s.
JITTER_SCATTER = 0.08
JITTER_AVERAGE_S = 4.0
JITTER_FEWEST = 50


def pauses(t_s: FloatArray) -> IntArray:
    """Numbers of the samples before which an IMU paused, at increasing stamps (N,) s."""
    dt = np.diff(t_s)
    pause_s = max(PAUSE_S, PAUSE_SAMPLES * float(np.median(dt))) if len(dt) else PAUSE_S
    return np.flatnonzero(dt > pause_s) + 1


def split_at_pauses(imu: ImuStream) -> list[slice]:
    """The segments of the IMU stream, between its pauses, in order."""
    cuts = pauses(imu.t_s)
    edges = [0, *cuts.tolist(), len(imu.t_s)]
    return [slice(a, b) for a, b in pairwise(edges)]


def dejitter(t: FloatArray) -> FloatArray:  # t (N,) s -> (N,) s
    """Sample times of a sensor that ticks evenly, from stamps that a radio or a driver made uneven."""
    if len(t) < JITTER_FEWEST:
        return t
    dt = np.diff(t)
    tick = float(t[-1] - t[0]) / (len(t) - 1)
    if robust_sigma(dt - tick) < JITTER_SCATTER * tick:
        return t
    count = np.arange(len(t), dtype=float)
    slope, start = np.polyfit(count, t, 1)
    departure = t - (start + slope * count)
    width = max(int(JITTER_AVERAGE_S / slope), 3) | 1
    slow = moving_mean(departure, width)
    jitter = departure - slow
    # a missing sample makes a step of a whole tick: then nothing is better than the stamps
    half = width // 2
    step = np.abs(moving_mean(jitter, max(width // 8, 3))[half:-half])
    if not len(step) or step.max() > 0.4 * slope:
        return t
    even_t = start + slope * count + slow
    return even_t if np.diff(even_t).min() > 0.2 * slope else t


def synthetic_stamps(t_s: FloatArray) -> bool:  # t_s (F,) s
    """Whether frame times (F,) were spread evenly by somebody instead of measured."""
    dt = np.diff(t_s)
    if len(dt) < 10 or np.ptp(dt) > 1e-4:
        return False
    return bool(np.min(np.abs(1.0 / dt.mean() / CAMERA_RATES_HZ - 1.0)) > RATE_TOLERANCE)


#: Counters of devices start anew after this many seconds: 2^32 of us, ms, ns and 30 us; 2^24 of 1/32768 s;
#: 2^16 of ms; a day.
WRAPS_S = (
    2**32 * 1e-6,
    2**32 * 1e-3,
    2**32 * 1e-9,
    2**32 / 32768,
    2**24 / 32768,
    2**16 * 1e-3,
    86_400.0,
)
#: After a wrap the next stamp follows within this many ticks, or this long, s.
WRAP_TICKS, WRAP_S = 50.0, 1.0
#: A step is a repeat or a burst's where it is shorter than this part of a tick; stamps with a smaller share
#: of those are left as they are.
SHORT_STEP, FEW = 0.25, 0.003
#: Stamps of packets of two samples and more: at least this share of the steps is short.
IN_PACKETS = 0.4
#: A pause is looked at from this many ticks, and `PAUSE_S`, on.
PAUSE_TICKS = 4.0
#: Stamps that catch up do so within this time, s; the level before a pause is taken over the second.
CATCH_UP_S, BEFORE_S = 6.0, 1.0
#: Stamps' level is taken over this long, s; this many of them are compared with their neighbours.
LEVEL_S, LEVELS = 2.0, 5
#: A sensor is even where its rate over `LEVEL_S` scatters by no more than this part.
EVEN = 0.04
#: Of a level before or after a step at most about this many samples are ranked.
QUICK = 100
#: With fewer samples nothing is estimated.
FEWEST = 50


@dataclass(frozen=True)
class EvenTimes:
    """Times by count."""

    t_s: FloatArray  # (N,) s: increasing, a tick apart but for pauses and slow drift
    tick_s: float  # The sensor's period
    pauses: int  # Pauses after which the stamps did not catch up
    clock_resets: int  # Times that the clock was set back to stay


def unwrapped(t_s: FloatArray) -> tuple[FloatArray, int]:
    """Stamps (N,) of a clock that starts anew, made to go on; and how often it did."""
    dt = np.diff(t_s)
    back = np.flatnonzero(dt < 0)
    if not len(back):
        return t_s, 0
    forward = dt[dt > 0]
    tick = float(np.median(forward)) if len(forward) else 0.0
    near = max(WRAP_TICKS * tick, WRAP_S)
    added, wraps = np.zeros(len(t_s)), 0
    for row in back.tolist():
        fitting = [wrap for wrap in WRAPS_S if 0 <= dt[row] + wrap <= min(near, 0.1 * wrap)]
        if fitting:
            added[row + 1 :] += min(fitting, key=lambda wrap: dt[row] + wrap)
            wraps += 1
    return t_s + added, wraps


def counted(counter: IntArray, wraps: int) -> tuple[IntArray, int]:
    """Counter values (N,) as numbers of samples from 0 on, and how often the counter started anew."""
    if not len(counter):
        return counter, 0
    if wraps <= 0:
        wraps = next((2**bits for bits in (8, 16, 32) if counter.max() < 2**bits), 2**62)
    step = np.diff(counter)
    usual = max(int(np.median(step[step > 0])), 1) if (step > 0).any() else 1
    back = step < 0
    around = step + wraps
    # A wrap loses a few samples at most; a counter that starts at any other number was started anew.
    step = np.where(back, np.where(around <= 0.1 * wraps, around, usual), step)
    number = np.concatenate([[0], np.cumsum(step)])
    return np.asarray(number // usual if (step % usual == 0).all() else number, np.int64), int(back.sum())


def needs_counting(t_s: FloatArray) -> bool:
    """Whether this many stamps (N,) repeat, go back or come too close that they are not the samples' own."""
    dt = np.diff(t_s)
    if len(dt) < FEWEST:
        return bool((dt <= 0).any())
    tick = _tick(t_s)
    if not tick > 0:
        return False
    late = dt > max(PAUSE_TICKS * tick, PAUSE_S)
    short = float((dt < SHORT_STEP * tick).mean())
    return bool((dt <= 0).mean() > FEW or (short > FEW and late.any()) or short > IN_PACKETS)


def in_packets(t_s: FloatArray) -> bool:
    """Whether stamps (N,) are those of packets with several samples, as they arrived, with pauses between."""
    if len(t_s) < FEWEST:
        return False
    dt = np.diff(t_s)
    short = (dt < SHORT_STEP * _tick(t_s)).mean() > IN_PACKETS
    return bool(short and ((dt <= 0).mean() > FEW or (dt > PAUSE_S).mean() > FEW))


def even_times(t_s: FloatArray, number: IntArray | None = None) -> EvenTimes | None:
    """Times of an even sensor from bad stamps (N,), s, and the samples' numbers where they were counted."""
    if len(t_s) < FEWEST:
        return None
    tick, is_counted = _tick(t_s, number), number is not None
    if number is None and ((dt := np.diff(t_s)) == 0).mean() > IN_PACKETS:  # one stamp a packet
        starts = np.flatnonzero(np.append(True, dt != 0))
        tick, size = _tick(t_s[starts], starts), np.diff(starts, append=len(t_s))
        middle = starts + 0.5 * (np.median(size) - 1)
        t_s = t_s + tick * (np.arange(len(t_s)) - np.repeat(middle, size))
    if not tick > 0:
        return None
    number = np.arange(len(t_s)) if number is None else number
    departure = t_s - tick * number
    steps = [] if is_counted else _pauses(t_s, departure, tick)
    for row, step in steps:
        if step < 0:
            departure[row:] -= step
    pauses = [row for row, step in steps if step > 0]
    edges = [0, *pauses, len(t_s)]
    even = np.empty(len(t_s))
    rates: list[float] = []
    for first, stop in pairwise(edges):
        rows = slice(first, stop)
        level, slopes = _level(departure[rows], number[rows], tick)
        even[rows] = tick * number[rows] + level
        rates += slopes
    if len(rates) >= 3 and robust_sigma(np.array(rates)) > EVEN:
        return None
    if (np.diff(even) < 0.2 * tick * np.maximum(np.diff(number), 1)).any():
        return None  # a level that runs back is not a drift of a clock
    return EvenTimes(even, tick, len(pauses), len(steps) - len(pauses))


def _tick(t_s: FloatArray, number: IntArray | None = None) -> float:
    """The period over intervals long enough that bursts do not count and pauses are rare."""
    apart = max(min(len(t_s) // 3, 500), 1)
    ticks = t_s[apart:] - t_s[:-apart]
    if number is None:
        ticks /= apart
    else:
        ahead = number[apart:] - number[:-apart]
        ticks = ticks[ahead > 0] / ahead[ahead > 0]
    return float(np.median(ticks, overwrite_input=True)) if len(ticks) else float("nan")


def _pauses(t_s: FloatArray, departure: FloatArray, tick: float) -> list[tuple[int, float]]:
    """Rows before which the stamps step for good, and how far, s: on by a pause, back by a clock set back."""
    dt = np.diff(t_s)
    least = max(PAUSE_TICKS * tick, PAUSE_S)
    after, before = (max(round(time / tick), 5) for time in (CATCH_UP_S, BEFORE_S))

    def step_over(first: int, last: int) -> float:
        """Level from row `last` on less that up to row `first`; late stamps lie above what they return to."""
        earlier = _ranked(departure[max(first - before, 0) : first], 0.5)
        later = departure[last : last + after]
        middle = _ranked(later, 0.5)
        return (middle if middle < earlier else _ranked(later, 0.1)) - earlier

    def lasts(step: float, jump: float) -> bool:
        return abs(step) > max(0.5 * abs(jump), 0.6 * least) and (step > 0) == (jump > 0)

    jumps = np.flatnonzero((dt > least) | (dt < -PAUSE_S)) + 1
    # With few samples beside it a burst looks like a pause; only a long jump is one all the same.
    inside = (jumps >= before // 2) & (jumps <= len(t_s) - before // 2)
    jumps = jumps[inside | (dt[jumps - 1] > BEFORE_S)].tolist()
    candidates = np.array([r for r in jumps if lasts(step_over(r, r), float(dt[r - 1]))], np.int64)
    pauses: list[tuple[int, float]] = []
    for group in np.split(candidates, np.flatnonzero(np.diff(candidates) > before) + 1):
        if not len(group):
            continue
        first, last = int(group[0]), int(group[-1])
        step = step_over(first, last)
        if len(group) > 1:  # stamps of one pause, mixed with late ones: where do two levels fit best?
            low = float(np.median(departure[max(first - before, 0) : first]))
            error = np.abs(departure[first:last] - low) - np.abs(departure[first:last] - low - step)
            split = first + int(np.argmin(np.append(0.0, np.cumsum(error))))
        else:
            split = first
        if abs(step) > 0.6 * least:
            pauses.append((split, step))
    return pauses


def _ranked(values: FloatArray, share: float) -> float:
    """A quantile of at most `QUICK` of the values: bursty stamps have thousands of steps to look at."""
    values = values[:: max(len(values) // QUICK, 1)]
    rank = int(share * (len(values) - 1))
    return float(np.partition(values, rank)[rank])


def _level(departure: FloatArray, number: IntArray, tick: float) -> tuple[FloatArray, list[float]]:
    """Slow departure of stamps from an even tick, and its slopes from level to level."""
    width = max(round(LEVEL_S / tick), 5)
    count = max(len(departure) // width, 1)
    parts = np.array_split(np.arange(len(departure)), count)
    level = np.array([np.median(departure[part]) for part in parts])
    if count == 1:
        return np.full(len(departure), level[0]), []
    at = np.array([np.median(number[part]) for part in parts])
    slopes = np.diff(level) / np.maximum(np.diff(at) * tick, 1e-9)
    trend = float(np.median(slopes)) * tick
    half = LEVELS // 2
    padded = np.pad(level - trend * at, half, mode="edge")
    slow = np.median(np.lib.stride_tricks.sliding_window_view(padded, LEVELS), axis=1)
    return trend * number + np.interp(number, at, slow), slopes.tolist()


#: A clock is set by more than this many usual intervals, and this long, s; what is less is jitter.
_INTERVALS, _LEAST_S = 2.5, 0.05
#: More steps back in a file are not a clock that was set.
_MOST_RESETS = 6
#: This many steps on both sides are regular: this share of them lies within these parts of the usual
#: interval.
_BESIDE, _REGULAR = 12, (0.25, 3.0, 0.8)
#: Fewer than this on one side are not enough.
_FEWEST_ROWS = 4
#: The level of the stamps is compared over this many rows; it falls by the step, to this part of it.
_LEVEL_ROWS, _SAME = 50, 0.3


def increasing(stamp_ns: IntArray | FloatArray) -> BoolArray:
    """Samples (N,) to keep so that stamps increase strictly."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return np.ones(len(stamp_ns), bool)
    after_all = np.ones(len(stamp_ns), bool)
    after_all[1:] = stamp_ns[1:] > np.maximum.accumulate(stamp_ns)[:-1]
    before_all = np.ones(len(stamp_ns), bool)
    before_all[:-1] = stamp_ns[:-1] < np.minimum.accumulate(stamp_ns[::-1])[::-1][1:]
    return after_all if after_all.sum() >= before_all.sum() else before_all


def clock_resets(
    t_s: FloatArray,
    values: FloatArray | None = None,  # t_s (n,) s; values (n, k)
) -> tuple[FloatArray, list[tuple[float, float]]]:  # t_s (n,) s, steps s
    """Times of a clock that was set back, made to go on at the usual interval."""
    dt = np.diff(t_s)
    if len(dt) < 2 * _FEWEST_ROWS or not (dt < 0).any():
        return t_s, []
    usual = float(np.median(dt[dt > 0])) if (dt > 0).any() else 0.0
    least = max(_INTERVALS * usual, _LEAST_S)
    rows = np.flatnonzero(usual - dt > least) + 1
    if not usual > 0 or not 0 < len(rows) <= _MOST_RESETS or _fill_up(t_s, dt, usual, least):
        return t_s, []
    edges = [0, *rows.tolist(), len(t_s)]
    added, steps = np.zeros(len(t_s)), []
    for before, row, after in zip(edges, edges[1:], edges[2:], strict=False):
        by = usual - float(dt[row - 1])
        if _lasts(t_s, slice(before, row), slice(row, after), usual, by) and not _again(t_s, values, row):
            steps.append((by, float(t_s[row - 1] + added[row - 1] - t_s[0])))
            added[row:] += by
    return (t_s + added, steps) if steps else (t_s, [])


#: A stamp that is farther than this from where it should be, s and usual intervals, is a leap.
_LEAP_S, _LEAP_INTERVALS = 1.0, 20.0
#: More leaps than this are not a clock that strays.
_MOST_LEAPS = 40
#: Clocks are set ahead by whole half hours (zones, summer time), s; other leaps from here on are questioned.
_ZONE_S, _QUESTIONED_S = 1800.0, 600.0
#: Before this, s since 1970, a clock was not set (1990).
_SET_S = 631_152_000.0


def strayed(t_s: FloatArray, what: str) -> tuple[FloatArray, list[str]]:
    """Times (n,) of a clock that strays and returns, or leaps ahead: put between, or nan; and notes."""
    dt = np.diff(t_s)
    usual = float(np.median(dt[dt > 0])) if (dt > 0).any() else 0.0
    least = max(_LEAP_S, _LEAP_INTERVALS * usual)
    leaps = np.flatnonzero(np.abs(dt - usual) > least) + 1
    if not usual > 0 or not 0 < len(leaps) <= _MOST_LEAPS or _fill_up(t_s, dt, usual, least):
        return t_s, []
    t_s, count, row = t_s.copy(), {"placed between the others": 0, "left out": 0}, 0
    farthest = 0.0
    while row < len(leaps) - 1:
        first, last = int(leaps[row]), int(leaps[row + 1])
        by, back = float(dt[first - 1]) - usual, float(dt[last - 1]) - usual
        # What the clock drifted and lost meanwhile is small beside the leap.
        if last - first < 2 or not abs(by + back) < min(0.05 * abs(by), max(5 * usual, 0.1)):
            row += 1
            continue
        step, (low, high, share) = dt[first : last - 1], _REGULAR
        is_even = ((step > low * usual) & (step < high * usual)).mean() >= share
        t_s[first:last] = t_s[first:last] - by if is_even else np.nan
        count["placed between the others" if is_even else "left out"] += last - first
        farthest = max(farthest, abs(by))
        row += 2
    done = " and ".join(f"{many} {what} were {how}" for how, many in count.items() if many)
    notes = [f"The clock strayed by up to {farthest:.4g} s and returned: {done}."] if done else []
    return _ahead(t_s, usual, what, notes), notes


def _ahead(t_s: FloatArray, usual: float, what: str, notes: list[str]) -> FloatArray:
    """Times whose leaps ahead, by a clock that was set, are closed; those to another session are nan."""
    known = np.flatnonzero(np.isfinite(t_s))
    for later in (np.flatnonzero(np.diff(t_s[known]) > _QUESTIONED_S) + 1).tolist():
        at, row = int(known[later - 1]), int(known[later])
        by = float(t_s[row] - t_s[at]) - usual * (row - at)
        if not by > _QUESTIONED_S:
            continue
        since = float(t_s[at] - t_s[known[0]])
        said = f"The clock of the {what} leaps ahead by {by:.4g} s, {since:.1f} s after the first"
        zones = round(by / _ZONE_S)
        was_set = t_s[at] < _SET_S < t_s[row]
        if was_set or (zones and abs(by - zones * _ZONE_S) < max(2 * usual, 0.05)):
            is_later = np.arange(len(t_s)) >= row
            t_s = t_s + (by * ~is_later if was_set else -by * is_later)
            notes.append(f"{said}: it was set, and the {what} continue at the usual interval.")
        elif by > FAR_S:
            gone = np.arange(len(t_s)) < row if row < len(t_s) / 2 else np.arange(len(t_s)) >= row
            t_s = np.where(gone, np.nan, t_s)
            notes.append(f"{said}: the {int(gone.sum())} {what} of the shorter part were left out.")
        else:
            notes.append(f"{said}: taken for a pause; if the clock was set there, correct it in the file.")
    return t_s


def begins_frames(time: FloatArray, kind: IntArray) -> bool:  # time (n,); kind int (n,)
    """Whether a table of one row per joint is ordered by frames though its times go back here and there."""
    back = np.flatnonzero(np.diff(time) < 0) + 1
    return 0 < len(back) <= _MOST_RESETS and len(np.unique(kind)) > 1 and bool((kind[back] == kind[0]).all())


def resets_message(steps: list[tuple[float, float]], what: str) -> str:
    """A sentence on steps of a clock; `what` are the rows behind them."""
    back = ", ".join(f"by {by:.{1 if by >= 0.95 else 2}f} s at {at:.1f} s" for by, at in steps)
    return f"The clock was set back {back}: the following {what} continue at the usual interval."


def _fill_up(t_s: FloatArray, dt: FloatArray, usual: float, least: float) -> bool:
    """Whether the rows between jumps, put in order, leave fewer jumps and no overlap: pages out of order."""
    jumps = np.flatnonzero((usual - dt > least) | (dt > least)) + 1
    if len(jumps) > 20 * _MOST_RESETS:
        return False
    pages = [t_s[first:last] for first, last in pairwise([0, *jumps.tolist(), len(t_s)])]
    ends = sorted((float(page.min()), float(page.max())) for page in pages)
    between = np.array([later[0] - earlier[1] for earlier, later in pairwise(ends)])
    return bool((between > -0.5 * usual).all() and (between > least).sum() < len(jumps))


def _lasts(t_s: FloatArray, before: slice, after: slice, usual: float, by: float) -> bool:
    """Whether stamps run evenly on both sides of a step, and stay down behind it."""
    earlier, later = t_s[before][-_LEVEL_ROWS:], t_s[after][:_LEVEL_ROWS]
    if min(len(earlier), len(later)) <= _FEWEST_ROWS:
        return False
    for steps in (np.diff(earlier)[-_BESIDE:], np.diff(later)[:_BESIDE]):
        low, high, share = _REGULAR
        if ((steps > low * usual) & (steps < high * usual)).mean() < share:
            return False
    rows = np.arange(-len(earlier), len(later))
    level = np.concatenate([earlier, later]) - usual * rows
    fall = np.median(level[: len(earlier)]) - np.median(level[len(earlier) :])
    return bool(abs(fall - by) < _SAME * by)


def _again(t_s: FloatArray, values: FloatArray | None, row: int) -> bool:
    """Whether the rows from one on repeat earlier ones, times and values."""
    if values is None:
        return False
    rows = slice(row, row + _BESIDE)
    moving = values[rows][np.isfinite(values[rows]).all(axis=1)]
    if not len(moving) or (moving == moving[0]).all():  # hidden, or held: they cannot be distinguished
        return False
    for at in np.flatnonzero(np.abs(t_s[:row] - t_s[row]) < 1e-9).tolist():
        earlier = slice(at, at + len(t_s[rows]))
        if np.allclose(t_s[earlier], t_s[rows], rtol=0, atol=1e-9) and np.array_equal(
            values[earlier], values[rows], equal_nan=True
        ):
            return True
    return False


#: Samples farther from all others than this are of another recording, or their stamps are wrong, s.
FAR_S = 12 * 3600.0


def largest_group(stamp_ns: IntArray) -> BoolArray | None:
    """Samples (N,) in the largest group of stamps that are less than `FAR_S` apart; None where all are."""
    far = int(FAR_S * 1e9)
    if not len(stamp_ns) or int(stamp_ns.max()) - int(stamp_ns.min()) <= far:
        return None
    order = np.argsort(stamp_ns, kind="stable")
    # unsigned, as stamps of year -292 and 2262 are farther apart than a signed number can contain
    step = np.diff(stamp_ns[order].view(np.uint64))
    cuts = np.flatnonzero(step > np.uint64(far)) + 1
    if not len(cuts):
        return None
    edges = np.concatenate([[0], cuts, [len(order)]])
    best = int(np.argmax(np.diff(edges)))
    mask = np.zeros(len(stamp_ns), bool)
    mask[order[edges[best] : edges[best + 1]]] = True
    return mask
