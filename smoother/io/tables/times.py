"""Times of tables: which column they are, repaired, and clocks brought together that share nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TypeVar

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...measurements.timestamps import (
    clock_resets,
    counted,
    even_times,
    increasing,
    needs_counting,
    resets_message,
    strayed,
    unwrapped,
)
from .imu import ImuTable, turn_notes, with_settled_unit
from .joints import TIME_WORDS, column_named, words_of
from .skeletons import SkeletonTable
from .table import Table, amount, shown
from .units import SECONDS, TIME, from_1970, plain_unit, time_unit, unit_of_step

#: Units that a label ends with, where they are not taken off.
_SUFFIX = re.compile(r"(?:_|\s|\b)(ns|nano\w*|us|micro\w*|ms|milli\w*|s|sec\w*)$")
#: This share of the steps of a column of times rises, and lies within these parts of the usual one.
_RISES, _EVEN, _EVEN_SHARE = 0.95, (0.3, 3.0), 0.8
#: Fewer rows than these rise by chance.
_FEWEST = 8


def time_column(table: Table) -> int | None:
    """The column that is the time by its name; without names the first."""
    if not table.labels:
        return 0
    exact = column_named(table.names, TIME_WORDS)
    if exact is not None:
        return exact
    return 0 if table.labels[0].startswith(("time", "timestamp", "elapsed", "epoch")) else None


def stated_time_unit(table: Table, column: int) -> str:
    """The unit that a column of times states, in brackets or behind its name; "" where it states none."""
    stated = TIME.get(plain_unit(table.unit(column)))
    suffix = _SUFFIX.search(table.labels[column] if table.labels else "")
    letters = suffix.group(1) if suffix else ""
    said = (
        "us"
        if letters.startswith("micro")
        else {"n": "ns", "u": "us", "m": "ms", "s": "s"}.get(letters[:1], "")
    )
    return next((unit for unit, seconds in SECONDS.items() if seconds == stated), said)


def seconds(table: Table, column: int | None, unit: str = "s") -> FloatArray | None:
    """Times of a column, (n,) in s, dates since 1970; None for no column or one without times."""
    if column is None or not any(table.texts(column)[:2000]):
        return None
    times, dates = table.times(column)
    if not np.isfinite(times).any():
        return None
    if dates:
        return times
    stated = next((u for u, s in SECONDS.items() if s == TIME.get(plain_unit(table.unit(column)))), unit)
    fits = time_unit(stated, times) or stated
    note = f"Times are in {fits}, by the rate or the date that they give, not in {stated}."
    if fits != stated and note not in table.notes:
        table.notes.append(note)
    return from_1970(times, fits) * SECONDS[fits]


def time_among(
    table: Table, free: Sequence[int], rates_hz: tuple[float, float], notes: list[str]
) -> tuple[int | None, str]:
    """The column that is the time and its unit ("iso" of dates), of those that nothing else is known of."""
    for at in free:
        name = shown(table.name(at).removeprefix("column "), 60)
        try:
            values, dates = table.times(at)
        except RecordingError:  # of words, not of times
            continue
        step = np.diff(values[np.isfinite(values)])
        moved = step[step != 0]
        rises = len(moved) and (moved > 0).mean() > _RISES
        if {"x", "y", "z", "w"} & set(words_of(name)) or len(values) < _FEWEST or not rises:
            continue
        if dates:
            return at, "iso"
        if len(moved) < 0.3 * (len(values) - 1):
            continue
        usual = float(np.median(moved))
        unit = unit_of_step(usual, rates_hz, "", float(np.nanmedian(values)))
        if usual == 1 and (values % 1 == 0)[np.isfinite(values)].all() and np.nanmax(values) < 1e11:
            notes.append(f"The column {name} counts rows or packets and is not the time.")
            continue
        even = ((step > _EVEN[0] * usual) & (step < _EVEN[1] * usual)).mean() > _EVEN_SHARE
        if unit is None and not even:
            continue
        if unit is None or not even or not (step > 0).all() or not np.isfinite(values).all():
            raise RecordingError(
                f"{table.path} has no time by its name, and its column {name} rises like one, but it is not"
                " certain that it is, or in which unit; call it time_s, time_ms, time_us, time_ns or"
                " time_ticks, or describe it in a recording.toml (`unocclude import describe"
                f" {table.path}`)."
            )
        notes.append(
            f"The column {name} was taken for the time, in {unit}: it alone rises evenly, with"
            f" {1 / (usual * SECONDS[unit]):.4g} rows per second."
        )
        return at, unit
    return None, ""


#: Rows at the start with a stamp of zero are not times where the next stamp is this much later, s.
_FAR_S = 3600.0
#: A stamp farther than this from the others is none, s: files keep nanoseconds in 64 bits, +-292 years.
_FARTHEST_S = 4e9
#: A column is the samples' counter where at least this share of its steps is one.
_COUNTS = 0.5
#: Rows are out of order where, sorted, this share of the steps lies within these parts of the usual one.
_IN_ORDER = (0.6, 1.6, 0.97)
#: More of the samples are not left out for their stamps.
_LOST = 0.2
#: Stamps that follow a counter to this part of a tick are the samples' own.
_OWN_STAMPS = 0.25


Stream = TypeVar("Stream", ImuTable, SkeletonTable)


def repaired_imu(table: ImuTable, source: str) -> ImuTable:
    """An IMU's samples with times that increase."""
    table = with_settled_unit(table)
    table = replace(
        table, notes=table.notes + [each for each in turn_notes(table) if each not in table.notes]
    )
    vectors = [values for values in (table.acc, table.gyro) if values is not None]
    sends = np.logical_or.reduce([values.any(axis=1) for values in vectors])
    table = _kept(table, np.maximum.accumulate(sends), "rows of zeros at the start were left out")
    finite = [np.isfinite(values).all(axis=1) for values in (table.acc, table.gyro) if values is not None]
    table = _kept(table, np.logical_and.reduce(finite), "samples that are not numbers were left out")
    if table.t_s is not None:
        table = _kept(table, _timed(table.t_s), "samples without a time were left out")
    if len(table) < 2:
        raise RecordingError(
            f"{source} has too few usable samples ({len(table)}); record or export it again."
        )
    table = _kept(table, ~_repeated(table), "rows that repeat the one before were left out")
    table = _on_one_clock(table, table.acc if table.acc is not None else table.gyro, "samples")
    number, notes = _number(table)
    table = replace(table, notes=table.notes + notes)
    return _with_times(table, number, source, "samples")


def repaired_skeleton(table: SkeletonTable, source: str) -> SkeletonTable:
    """A body's frames with times that increase; parameters, returns and raises as `repaired_imu`."""
    if table.t_s is not None:
        table = _kept(table, _timed(table.t_s), "frames without a time were left out")
    if not len(table):
        raise RecordingError(f"{source} has no usable frames; record or export it again.")
    table = _on_one_clock(table, next(iter(table.position.values())), "frames")
    return _with_times(table, None, source, "frames")


def _on_one_clock(table: Stream, values: FloatArray | None, what: str) -> Stream:
    """Rows whose stamps stray, restart, were set back or stand out of order, put right."""
    if table.t_s is None:
        return table
    stamps, strays = strayed(table.t_s, what)
    there = np.isfinite(stamps)
    table = replace(table, t_s=stamps, notes=table.notes + strays)
    table = _kept(table, there, f"{what} far from all others were left out")
    assert table.t_s is not None
    t_s, wraps = unwrapped(table.t_s)
    notes = [f"The device's clock restarted {_times_message(wraps)}; it was continued."] if wraps else []
    # before rows are put in order, which would mix what was apart
    t_s, steps = clock_resets(t_s, None if values is None else values[there])
    notes += [resets_message(steps, what)] if steps else []
    table = replace(table, t_s=t_s, notes=table.notes + notes)
    order = _order(t_s)
    if order is None:
        return table
    moved = int((order != np.arange(len(order))).sum())
    said = f"{moved} rows were out of order and were put in the order of their stamps."
    return replace(table.select(order), notes=[*table.notes, said])


def _with_times(table: Stream, number: IntArray | None, source: str, what: str) -> Stream:
    t_s, notes = _times(table.t_s, number, table.rate_hz, source, what, len(table))
    table = replace(table, t_s=t_s, notes=table.notes + notes)
    return _kept(table, _increasing(t_s, source), f"{what} whose stamps repeat or go back were left out")


def _kept(table: Stream, keep: BoolArray, why: str) -> Stream:
    """The rows to keep, and a sentence on those that were left out."""
    lost = int((~keep).sum())
    if not lost:
        return table
    return replace(table.select(keep), notes=[*table.notes, f"{lost} {why if lost > 1 else _one(why)}."])


def _times(
    t_s: FloatArray | None,
    number: IntArray | None,
    rate_hz: float | None,
    source: str,
    what: str,
    count: int,
) -> tuple[FloatArray, list[str]]:
    """Times (N,) by stamps, by a counter, or by a rate alone; and what was done."""
    if t_s is None:
        if rate_hz is None or not 0 < rate_hz < 1e6:
            raise RecordingError(
                f"{source} has neither times nor a rate of its {what}; export them as well, or give rate_hz"
                f" in a recording.toml (`unocclude import describe {source}` prints one)."
            )
        number = np.arange(count) if number is None else number
        lost = int(number[-1]) + 1 - len(number) if len(number) else 0
        misses = f"that the counter misses {'stays' if lost == 1 else 'stay'} missing"
        said = f"; {amount(lost, what.removesuffix('s'), what)} {misses}" if lost else ""
        return number / rate_hz, [f"Times are counted at {rate_hz:g} Hz{said}."]
    good = not needs_counting(t_s) if number is None else _follows(t_s, number)
    even = None if good else even_times(t_s, number)
    if even is None:
        return t_s, []
    notes = []
    bad = int((np.diff(t_s) <= 0).sum())
    moved = int((np.abs(even.t_s - t_s) > 0.5 * even.tick_s).sum())
    notes.append(
        f"{bad} of {len(t_s)} stamps {'repeats or goes' if bad == 1 else 'repeat or go'} back: the {what}"
        f" were counted at the even rate of {1 / even.tick_s:.2f} Hz that the stamps show; {moved} moved by"
        " more than half a period."
    )
    if even.pauses:
        notes.append(
            f"{amount(even.pauses, 'pause', 'pauses')} in the {what}"
            f" {'stays as it is' if even.pauses == 1 else 'stay as they are'}."
        )
    if even.clock_resets:
        notes.append(
            f"The clock was set back {_times_message(even.clock_resets)}; the {what} continue evenly."
        )
    return even.t_s, notes


def _number(table: ImuTable) -> tuple[IntArray | None, list[str]]:
    """Numbers of the samples by their counter; None where it has none that counts them."""
    if table.counter is None:
        return None, []
    step = np.diff(table.counter)
    if not len(step) or (step > 0).mean() < _COUNTS:
        return None, ["The counter does not count the samples and was not used."]
    number, _ = counted(table.counter, table.counter_wraps)
    lost = int(number[-1]) + 1 - len(number)
    if table.t_s is not None and lost > 0:
        return number, [
            f"By the counter {amount(lost, 'sample is', 'samples are')} missing; nothing is put there."
        ]
    return number, []


def _follows(t_s: FloatArray, number: IntArray) -> bool:
    """Whether stamps are as even as their counter, as far as known."""
    dt, steps = np.diff(t_s), np.diff(number)
    if (dt <= 0).any():
        return False
    ticks = dt / np.maximum(steps, 1)
    return bool(np.quantile(np.abs(ticks / np.median(ticks) - 1.0), 0.99) < _OWN_STAMPS)


def _order(t_s: FloatArray) -> IntArray | None:
    """The order of rows that were written out of it: in order their stamps are even. None to leave it."""
    dt = np.diff(t_s)
    if not (dt < 0).any():
        return None
    order = np.argsort(t_s, kind="stable")
    steps = np.diff(t_s[order])
    usual = float(np.median(steps))
    even = ((steps > _IN_ORDER[0] * usual) & (steps < _IN_ORDER[1] * usual)).mean()
    return order if even > _IN_ORDER[2] else None


def _timed(t_s: FloatArray) -> BoolArray:
    """Rows with a time: finite, near enough to the others, and not zeros before the clock was set."""
    timed = np.isfinite(t_s)
    if timed.any():
        with np.errstate(invalid="ignore"):
            timed &= np.abs(t_s - np.median(t_s[timed])) < _FARTHEST_S
    zero = t_s == 0
    if zero[:1].any():
        first = int(np.argmin(zero)) if not zero.all() else 0
        if first and t_s[first] > _FAR_S:
            timed[:first] = False
    return np.asarray(timed)


def _repeated(table: ImuTable) -> BoolArray:
    """Rows whose time (or count) and values are those of the row before."""
    mark = table.t_s if table.t_s is not None else table.counter
    if mark is None:
        return np.zeros(len(table), bool)
    same = np.append(False, np.diff(mark) == 0)
    for values in (table.acc, table.gyro):
        if values is not None:
            same[1:] &= (values[1:] == values[:-1]).all(axis=1)
    return same


def _increasing(t_s: FloatArray, source: str) -> BoolArray:
    """Rows to keep so that times increase strictly; of two ways to do it the one that loses less."""
    # Stamps are written in ns: two that agree to it are one.
    keep = increasing(np.rint((t_s - t_s[0]) * 1e9))
    lost = int((~keep).sum())
    if lost > _LOST * len(keep):
        raise RecordingError(
            f"{source}: {lost} of {len(keep)} stamps repeat or go back, and the samples are not even enough"
            " to be counted instead; export the sensor's own stamps, or its packet counter."
        )
    return keep


def _one(why: str) -> str:
    """A sentence's plural, of one."""
    for many, one in (
        ("rows", "row"),
        ("samples", "sample"),
        ("frames", "frame"),
        (" are ", " is "),
        ("were left", "was left"),
        ("stamps repeat or go", "stamp repeats or goes"),
        ("that repeat ", "that repeats "),
    ):
        why = why.replace(many, one)
    return why


def _times_message(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


#: Streams that share less than this, s, or less than this part of the shorter one, share no clock.
SHARED_S, SHARED_PART = 1.0, 0.05
#: A clock that begins nearer to zero than this, s, counts from the file's own start.
FROM_ZERO_S = 1.0
#: A device's clock counts from its start, s; recordings as long as each other to this, s, are one recorder's.
FROM_START_S, SAME_LENGTH_S = 60.0, 1.0


@dataclass
class Timed:
    """Times of a stream, and what to call it."""

    label: str  # For sentences
    t_s: FloatArray  # (n,) s: increasing, on its own clock
    is_imu: bool  # An IMU, not a camera
    source: str = ""  # The file; "" where it does not matter


#: Stamps from the year 2000 on are dates, s; files of one session are not so far apart, s.
_DATES_S, _SESSION_S = 946_684_800.0, 86_400.0


def check_one_session(streams: list[Timed]) -> None:
    """Refuse files that were found together and are of different days."""
    dated = [stream for stream in streams if len(stream.t_s) and stream.t_s[0] >= _DATES_S]
    if not dated:
        return
    ends = min(dated, key=lambda stream: float(stream.t_s[-1]))
    starts = max(dated, key=lambda stream: float(stream.t_s[0]))
    if starts.t_s[0] - ends.t_s[-1] < _SESSION_S:
        return
    early, late = (
        f"{stream.source or stream.label} ({datetime.fromtimestamp(float(stream.t_s[0]), UTC):%Y-%m-%d})"
        for stream in (ends, starts)
    )
    raise RecordingError(
        f"the folder mixes sessions: {early} and {late}; give each session a folder of its own, or name its"
        " files with --skeleton and --imu"
    )


def shifts(streams: list[Timed], imu_starts_at_s: float | None = None) -> tuple[list[float], list[str]]:
    """What to add to each stream's times so that all of them can be in one recording."""
    camera = [stream for stream in streams if not stream.is_imu]
    groups = _groups([row for row, stream in enumerate(streams) if stream.is_imu], streams)
    if not camera or not groups:
        return [0.0] * len(streams), []
    shift = [0.0] * len(streams)
    first_frame = min(float(stream.t_s[0]) for stream in camera)
    if imu_starts_at_s is not None:
        first_sample = min(float(streams[row].t_s[0]) for group in groups for row in group)
        for group in groups:
            own = first_sample if len(groups) == 1 else min(float(streams[row].t_s[0]) for row in group)
            for row in group:
                shift[row] = first_frame + imu_starts_at_s - own
        return shift, [
            f"The first IMU sample was put {abs(imu_starts_at_s):g} s"
            f" {'before' if imu_starts_at_s < 0 else 'after'} the camera's first frame, as given."
        ]
    apart = [
        group for group in groups if not any(_share(streams[row].t_s, c.t_s) for row in group for c in camera)
    ]
    if not apart:
        return shift, []
    shift = [-first_frame] * len(streams)  # a stream that shares the camera's clock starts with it
    sentences = []
    for group in apart:
        own = min(float(streams[row].t_s[0]) for row in group)
        for row in group:
            shift[row] = -own
        names = ", ".join(streams[row].label for row in group)
        sentences.append(
            f"The clock of {names} ({_clock_message(own)}) is unrelated to the camera's"
            f" ({_clock_message(first_frame)}): both were set to start at zero; the offset is estimated"
            " from the motion (if that fails, give --imu-starts-at S)."
        )
    return shift, sentences


def count_from_zero(streams: list[Timed]) -> bool:
    """Whether cameras and IMUs each count from zero, so that their relative start is unknown."""
    first = [float(stream.t_s[0]) for stream in streams]
    kinds = {stream.is_imu for stream in streams}
    one_file = len({stream.source for stream in streams}) == 1 and bool(streams[0].source)
    if len(kinds) < 2 or one_file:
        return False
    return max(abs(each) for each in first) < (FROM_ZERO_S if of_one_length(streams) else FROM_START_S)


def of_one_length(streams: list[Timed]) -> bool:
    """Whether the longest of the cameras and of the IMUs are as long as each other, as one recorder's are."""
    length = {stream.is_imu: 0.0 for stream in streams}
    for stream in streams:
        length[stream.is_imu] = max(length[stream.is_imu], float(stream.t_s[-1] - stream.t_s[0]))
    return max(length.values()) - min(length.values()) < SAME_LENGTH_S


def _groups(rows: list[int], streams: list[Timed]) -> list[list[int]]:
    """IMUs that share a clock, as far as their times overlap."""
    groups: list[list[int]] = []
    for row in rows:
        mine = [g for g in groups if any(_share(streams[row].t_s, streams[other].t_s) for other in g)]
        groups = [g for g in groups if g not in mine] + [[*(r for g in mine for r in g), row]]
    return groups


def _share(a: FloatArray, b: FloatArray) -> bool:
    shared = min(float(a[-1]), float(b[-1])) - max(float(a[0]), float(b[0]))
    shorter = min(float(a[-1] - a[0]), float(b[-1] - b[0]))
    return shared > min(SHARED_S, 0.5 * shorter) and shared > SHARED_PART * shorter


def _clock_message(first_s: float) -> str:
    """A clock by what it starts at."""
    if first_s > 1e8:
        return f"from {np.datetime64(int(first_s), 's')} UTC on"
    return f"from {first_s:.1f} s on"
