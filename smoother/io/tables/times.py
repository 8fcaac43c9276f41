"""Times of tables: repaired, and clocks brought together that share nothing."""

from __future__ import annotations

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
from ..recording.streams import ImuSamples, SkeletonTable, rows_of
from .imu import in_shown_units, paired

# ------------------------------------------------------------------------------------------------- repaired

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


Stream = TypeVar("Stream", ImuSamples, SkeletonTable)


def repaired_imu(table: ImuSamples, source: str) -> ImuSamples:
    """An IMU's samples with times that increase, in the units that gravity shows."""
    table = replace(table, notes=list(table.notes))

    def vectors() -> list[FloatArray]:
        return [values for values in (table.acc, table.gyro) if values is not None]

    if table.t_s is not None and len(parts := _halves(table)) > 1:  # of two sensors' rows, each its own
        return paired([repaired_imu(part, source) for part in parts], source)
    sends = np.logical_or.reduce([values.any(axis=1) for values in vectors()])
    table = _kept(table, np.maximum.accumulate(sends), "Rows of zeros at the start")
    finite = np.logical_and.reduce([np.isfinite(values).all(axis=1) for values in vectors()])
    table = _kept(table, finite, "Samples that are not numbers")
    if table.t_s is not None and (lacks := ~np.isfinite(table.t_s)).sum() > _LOST * len(table):
        table.t_s = table.t_s[np.maximum.accumulate(np.where(lacks, 0, np.arange(len(lacks))))]
        table.notes.append(f"Samples without a stamp, taken with the stamp before them: {int(lacks.sum())}.")
    table = _kept(table, _timed(table), "Samples without a time")
    if len(table) < 2:
        raise RecordingError(
            f"{source} has too few usable samples ({len(table)}); record or export it again."
        )
    mark = table.counter if table.t_s is None else table.t_s
    if mark is not None:
        same = np.logical_and.reduce([(each[1:] == each[:-1]).all(axis=1) for each in vectors()])
        table = _kept(
            table, ~np.append(False, (np.diff(mark) == 0) & same), "Rows that repeat the one before"
        )
    table = _on_one_clock(table, vectors()[0], "samples")
    return in_shown_units(_with_times(table, _number(table), source, "samples"))


def _halves(table: ImuSamples) -> list[ImuSamples]:
    """Accelerometer and gyroscope of a table whose rows hold the one or the other; else the table."""
    if table.acc is None or table.gyro is None:
        return [table]
    acc, gyro = (np.asarray(np.isfinite(each).all(axis=1)) for each in (table.acc, table.gyro))
    if (acc & gyro).sum() > 0.5 * min(acc.sum(), gyro.sum()):
        return [table]
    return [replace(rows_of(table, acc), gyro=None), replace(rows_of(table, gyro), acc=None, notes=[])]


def repaired_skeleton(table: SkeletonTable, source: str) -> SkeletonTable:
    """A body's frames with times that increase; parameters, returns and raises as `repaired_imu`."""
    table = _kept(table, _timed(table), "Frames without a time")
    if not len(table):
        raise RecordingError(f"{source} has no usable frames; record or export it again.")
    table = _on_one_clock(table, next(iter(table.position.values())), "frames")
    return _with_times(table, None, source, "frames")


def _kept(table: Stream, keep: BoolArray, what: str) -> Stream:
    """The rows to keep, and a sentence on those that were left out."""
    if keep.all():
        return table
    return replace(rows_of(table, keep), notes=[*table.notes, f"{what}, left out: {int((~keep).sum())}."])


def _timed(table: Stream) -> BoolArray:
    """Rows with a time: finite, near enough to the others, and not zeros before the clock was set."""
    if (t_s := table.t_s) is None:
        return np.ones(len(table), bool)
    timed = np.isfinite(t_s)
    if timed.any():
        with np.errstate(invalid="ignore"):
            timed &= np.abs(t_s - np.median(t_s[timed])) < _FARTHEST_S
    first = int(np.argmin(t_s == 0)) if len(t_s) else 0
    if first and t_s[first] > _FAR_S:
        timed[:first] = False
    return np.asarray(timed)


def _on_one_clock(table: Stream, values: FloatArray, what: str) -> Stream:
    """Rows whose stamps stray, restart, were set back or stand out of order, put right."""
    if table.t_s is None:
        return table
    stamps, strays = strayed(table.t_s, what)
    there = np.isfinite(stamps)
    table = replace(table, t_s=stamps, notes=table.notes + strays)
    table = _kept(table, there, f"{what.capitalize()} far from all others")
    assert table.t_s is not None
    t_s, wraps = unwrapped(table.t_s)
    notes = [f"The device's clock restarted and was continued, times: {wraps}."] if wraps else []
    # before rows are put in order, which would mix what was apart
    t_s, steps = clock_resets(t_s, values[there])
    notes += [resets_message(steps, what)] if steps else []
    table = replace(table, t_s=t_s, notes=table.notes + notes)
    if (order := _order(t_s)) is None:
        return table
    moved = int((order != np.arange(len(order))).sum())
    said = f"Rows out of order, put in the order of their stamps: {moved}."
    return replace(rows_of(table, order), notes=[*table.notes, said])


def _order(t_s: FloatArray) -> IntArray | None:
    """The order of rows that were written out of it: in order their stamps are even. None to leave it."""
    if not (np.diff(t_s) < 0).any():
        return None
    order = np.argsort(t_s, kind="stable")
    steps = np.diff(t_s[order])
    usual = float(np.median(steps))
    even = ((steps > _IN_ORDER[0] * usual) & (steps < _IN_ORDER[1] * usual)).mean()
    return order if even > _IN_ORDER[2] else None


def _number(table: ImuSamples) -> IntArray | None:
    """Numbers of the samples by their counter; None where it has none that counts them."""
    if table.counter is None:
        return None
    step = np.diff(table.counter)
    if not len(step) or (step > 0).mean() < _COUNTS:
        table.notes.append("The counter does not count the samples and was not used.")
        return None
    return counted(table.counter, table.counter_wraps)[0]


def _with_times(table: Stream, number: IntArray | None, source: str, what: str) -> Stream:
    """Rows with increasing times, by stamps, by a counter, or by a rate alone."""
    t_s, rate_hz, notes = table.t_s, table.rate_hz, list(table.notes)
    lost = 0 if number is None or not len(number) else int(number[-1]) + 1 - len(number)
    if t_s is None:
        if rate_hz is None or not 0 < rate_hz < 1e6:
            raise RecordingError(
                f"{source} has neither times nor a rate of its {what}; export them as well, or give rate_hz"
                f" in a recording.toml (`unocclude import describe {source}` prints one)."
            )
        t_s = (np.arange(len(table)) if number is None else number) / rate_hz
        said = f"; {what} that the counter misses stay missing: {lost}" if lost else ""
        notes.append(f"Times are counted at {rate_hz:g} Hz{said}.")
    else:
        if lost > 0:
            notes.append(f"{what.capitalize()} missing by the counter, nothing is put there: {lost}.")
        good = not needs_counting(t_s) if number is None else _follows(t_s, number)
        if (even := None if good else even_times(t_s, number)) is not None:
            bad = int((np.diff(t_s) <= 0).sum())
            moved = int((np.abs(even.t_s - t_s) > 0.5 * even.tick_s).sum())
            notes.append(
                f"Stamps that repeat or go back: {bad} of {len(t_s)}; the {what} were counted at the even"
                f" rate of {1 / even.tick_s:.2f} Hz that the stamps show, which moved {moved} by more than"
                " half a period."
            )
            for count, kind in ((even.pauses, "Pauses"), (even.clock_resets, "Settings back of the clock")):
                notes += [f"{kind} in the {what}: {count}."] if count else []
            t_s = even.t_s
    table = replace(table, t_s=t_s, notes=notes)
    # Stamps are written in ns: two that agree to it are one.
    keep = increasing(np.rint((t_s - t_s[0]) * 1e9))
    if (~keep).mean() > _LOST:
        raise RecordingError(
            f"{source}: {int((~keep).sum())} of {len(keep)} stamps repeat or go back, and the samples are not"
            " even enough to be counted instead; export the sensor's own stamps, or its packet counter."
        )
    return _kept(table, keep, f"{what.capitalize()} whose stamps repeat or go back")


def _follows(t_s: FloatArray, number: IntArray) -> bool:
    """Whether stamps are as even as their counter, as far as known."""
    dt, steps = np.diff(t_s), np.diff(number)
    if (dt <= 0).any():
        return False
    ticks = dt / np.maximum(steps, 1)
    return bool(np.quantile(np.abs(ticks / np.median(ticks) - 1.0), 0.99) < _OWN_STAMPS)


# ------------------------------------------------------------------------------- clocks brought together

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
    is_further: bool = False  # A camera on a clock of its own, which the joints that both see tell


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
    camera = [stream for stream in streams if not stream.is_imu and not stream.is_further]
    groups = _groups([row for row, stream in enumerate(streams) if stream.is_imu], streams)
    if not camera or not groups:
        return [0.0] * len(streams), []
    shift = [0.0] * len(streams)
    first_frame = min(float(stream.t_s[0]) for stream in camera)
    starts = [min(float(streams[row].t_s[0]) for row in group) for group in groups]
    if imu_starts_at_s is not None:
        for group, own in zip(groups, starts, strict=True):
            for row in group:
                shift[row] = first_frame + imu_starts_at_s - own
        return shift, [
            f"The first IMU sample was put {abs(imu_starts_at_s):g} s"
            f" {'before' if imu_starts_at_s < 0 else 'after'} the camera's first frame, as given."
        ]
    sentences: list[str] = []
    for group, own in zip(groups, starts, strict=True):
        if any(_share(streams[row].t_s, c.t_s) for row in group for c in camera):
            continue
        if not sentences:  # a stream that shares the camera's clock starts with it
            own_clock = [each.is_further and each.t_s[0] < first_frame for each in streams]
            shift = [0.0 if own else -first_frame for own in own_clock]
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
    return f"from {np.datetime64(int(first_s), 's')} UTC on" if first_s > 1e8 else f"from {first_s:.1f} s on"
