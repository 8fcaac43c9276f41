"""Stamps of streams put right: clocks that were set back, rows out of order, lone stamps far away."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...runtime.store import Store, batches
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples, RecordingFile

#: A clock is set by more than this many usual intervals, and this long, s; what is less is jitter.
_INTERVALS, _LEAST_S = 2.5, 0.05
#: More steps back in a file are no clock that somebody set.
_MOST = 6
#: So many steps on both sides are regular: this share of them lies within these parts of the usual interval.
_BESIDE, _REGULAR = 12, (0.25, 3.0, 0.8)
#: Fewer than this on one side tell nothing.
_FEWEST = 4
#: The level of the stamps is compared over so many rows; it falls by the step, to this part of it.
_LEVEL, _SAME = 50, 0.3


def increasing(stamp_ns: IntArray) -> BoolArray:
    """Samples (N,) to keep so that stamps increase strictly.

    A stamp that jumps back makes the later sample the wrong one, a stamp that jumps ahead the
    earlier: whichever reading drops fewer samples is taken.
    """
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return np.ones(len(stamp_ns), bool)
    after_all = np.ones(len(stamp_ns), bool)
    after_all[1:] = stamp_ns[1:] > np.maximum.accumulate(stamp_ns)[:-1]
    before_all = np.ones(len(stamp_ns), bool)
    before_all[:-1] = stamp_ns[:-1] < np.minimum.accumulate(stamp_ns[::-1])[::-1][1:]
    return after_all if after_all.sum() >= before_all.sum() else before_all


def kept(values: NDArray, keep: BoolArray, store: Store) -> NDArray:
    """The rows to keep (n,) of a column (N, ...); the same array where that is all."""
    count = int(keep.sum())
    if count == len(values):
        return values
    rest, filled = store.array((count, *values.shape[1:]), 0, values.dtype), 0
    for part in batches(len(values)):
        rows = values[part][keep[part]]
        rest[filled : filled + len(rows)] = rows
        filled += len(rows)
    return rest


def clock_resets(
    t_s: FloatArray, values: FloatArray | None = None
) -> tuple[FloatArray, list[tuple[float, float]]]:
    """Times of a clock that was set back, made to go on at the usual interval.

    Rows out of order are left alone: what was written late fills what is missing before it. So are rows that
    are there twice.

    Parameters
    ----------
    t_s : ndarray, shape (n,), s
        Stamps in the order of the rows.
    values : ndarray, shape (n, k), optional
        What was measured; rows that repeat an earlier time and its values are there twice.

    Returns
    -------
    t_s : ndarray, shape (n,), s
        The same array where no clock was set back.
    steps : list of (float, float), s
        By how much it was set back, and how long after the first row.
    """
    dt = np.diff(t_s)
    if len(dt) < 2 * _FEWEST or not (dt < 0).any():
        return t_s, []
    usual = float(np.median(dt[dt > 0])) if (dt > 0).any() else 0.0
    least = max(_INTERVALS * usual, _LEAST_S)
    rows = np.flatnonzero(usual - dt > least) + 1
    if not usual > 0 or not 0 < len(rows) <= _MOST or _fill_up(t_s, dt, usual, least):
        return t_s, []
    edges = [0, *rows.tolist(), len(t_s)]
    added, steps = np.zeros(len(t_s)), []
    for before, row, after in zip(edges, edges[1:], edges[2:], strict=False):
        by = usual - float(dt[row - 1])
        if _lasts(t_s, slice(before, row), slice(row, after), usual, by) and not _again(t_s, values, row):
            steps.append((by, float(t_s[row - 1] + added[row - 1] - t_s[0])))
            added[row:] += by
    return (t_s + added, steps) if steps else (t_s, [])


def begins_frames(time: FloatArray, kind: IntArray) -> bool:
    """Whether a table of a row a joint holds frame after frame though its times go back here and there.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Of each row; those of one frame stand together.
    kind : ndarray of int, shape (n,)
        Joint and body of each row: where times go back, a frame begins with what the first row holds. A file
        that lists one joint or body after the other begins with another there.
    """
    back = np.flatnonzero(np.diff(time) < 0) + 1
    return 0 < len(back) <= _MOST and len(np.unique(kind)) > 1 and bool((kind[back] == kind[0]).all())


def resets_message(steps: list[tuple[float, float]], what: str) -> str:
    """A sentence on steps of a clock; `what` are the rows behind them."""
    back = ", ".join(f"by {by:.{1 if by >= 0.95 else 2}f} s at {at:.1f} s" for by, at in steps)
    return (
        f"The clock was set back {back}: the {what} behind {'it go' if len(steps) == 1 else 'them go'} on"
        " after the ones before at the usual interval."
    )


def _fill_up(t_s: FloatArray, dt: FloatArray, usual: float, least: float) -> bool:
    """Whether the rows between jumps, put in order, leave fewer jumps and no overlap: pages out of order."""
    jumps = np.flatnonzero((usual - dt > least) | (dt > least)) + 1
    if len(jumps) > 20 * _MOST:
        return False
    pages = [t_s[first:last] for first, last in pairwise([0, *jumps.tolist(), len(t_s)])]
    ends = sorted((float(page.min()), float(page.max())) for page in pages)
    between = np.array([later[0] - earlier[1] for earlier, later in pairwise(ends)])
    return bool((between > -0.5 * usual).all() and (between > least).sum() < len(jumps))


def _lasts(t_s: FloatArray, before: slice, after: slice, usual: float, by: float) -> bool:
    """Whether stamps run evenly on both sides of a step, and stay down behind it."""
    earlier, later = t_s[before][-_LEVEL:], t_s[after][:_LEVEL]
    if min(len(earlier), len(later)) <= _FEWEST:
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
    if not len(moving) or (moving == moving[0]).all():  # hidden, or held: nothing tells them apart
        return False
    for at in np.flatnonzero(np.abs(t_s[:row] - t_s[row]) < 1e-9).tolist():
        earlier = slice(at, at + len(t_s[rows]))
        if np.allclose(t_s[earlier], t_s[rows], rtol=0, atol=1e-9) and np.array_equal(
            values[earlier], values[rows], equal_nan=True
        ):
            return True
    return False


#: Key and value of a file's own metadata that say so. Stamps that run back in other files are a fault.
ORDER, ARRIVAL = "order", "arrival"


def sort_arrivals(file: RecordingFile, metadata: dict[str, str], store: Store) -> None:
    """Put the samples and frames of a live recording in the order of their stamps.

    Parameters
    ----------
    file : RecordingFile
        As read; left alone unless its metadata says that messages stand as they arrived.
    metadata : dict of str to str
        Its own metadata record.
    store : Store
        Where sorted streams lie.
    """
    if metadata.get(ORDER) != ARRIVAL:
        return
    file.imus = [_sorted_imu(imu, store) for imu in file.imus]
    file.arms = [_sorted_arm(arm, store) for arm in file.arms]


def _sorted_imu(imu: ImuSamples, store: Store) -> ImuSamples:
    order = _order(imu.stamp_ns)
    return imu if order is None else replace(imu, **_columns(imu, ("acc", "gyro", "mag"), order, store))


def _sorted_arm(arm: ArmFrames, store: Store) -> ArmFrames:
    order = _order(arm.stamp_ns)
    return arm if order is None else replace(arm, **_columns(arm, ("position", "state"), order, store))


def _order(stamp_ns: IntArray) -> IntArray | None:
    """Rows by stamp; None where they stand so."""
    if all((np.diff(stamp_ns[part.start : part.stop + 1]) >= 0).all() for part in batches(len(stamp_ns))):
        return None
    return np.argsort(stamp_ns, kind="stable")


def _columns(
    stream: ImuSamples | ArmFrames, names: tuple[str, ...], order: IntArray, store: Store
) -> dict[str, Any]:
    """Columns of a stream in another order."""
    columns: dict[str, NDArray | None] = {name: getattr(stream, name) for name in ("stamp_ns", *names)}
    moved: dict[str, Any] = {}
    for name, values in columns.items():
        if values is None:
            continue
        moved[name] = store.array(values.shape, 0, values.dtype)
        for part in batches(len(order)):
            moved[name][part] = values[order[part]]
    return moved


#: Samples farther from all others than this are of another recording, or their stamps are wrong, s.
FAR_S = 12 * 3600.0


def largest_group(stamp_ns: IntArray) -> BoolArray | None:
    """Samples (N,) in the largest group of stamps that are less than `FAR_S` apart; None where all are."""
    far = int(FAR_S * 1e9)
    if not len(stamp_ns) or int(stamp_ns.max()) - int(stamp_ns.min()) <= far:
        return None
    order = np.argsort(stamp_ns, kind="stable")
    # unsigned, as stamps of year -292 and 2262 are farther apart than a signed number holds
    step = np.diff(stamp_ns[order].view(np.uint64))
    cuts = np.flatnonzero(step > np.uint64(far)) + 1
    if not len(cuts):
        return None
    edges = np.concatenate([[0], cuts, [len(order)]])
    best = int(np.argmax(np.diff(edges)))
    mask = np.zeros(len(stamp_ns), bool)
    mask[order[edges[best] : edges[best + 1]]] = True
    return mask


def drop_timestamp_outliers(file: RecordingFile, store: Store) -> None:
    """Drop samples whose stamps lie far from all others of their stream; a note says how many."""
    streams: list[ImuSamples | ArmFrames | PoseSamples] = [*file.imus, *file.arms, *file.poses]
    cleaned = {id(stream): without_outlying(stream, file.notes, store) for stream in streams}
    file.imus = [cleaned[id(stream)] for stream in file.imus]  # type: ignore[misc]
    file.arms = [cleaned[id(stream)] for stream in file.arms]  # type: ignore[misc]
    file.poses = [cleaned[id(stream)] for stream in file.poses]  # type: ignore[misc]


def without_outlying(
    stream: ImuSamples | ArmFrames | PoseSamples | FieldSamples, notes: list[str], store: Store
) -> ImuSamples | ArmFrames | PoseSamples | FieldSamples:
    """The stream without samples whose stamps lie far from all others; itself where there are none."""
    mask = largest_group(stream.stamp_ns)
    if mask is None:
        return stream
    dropped = ~mask
    near = int(np.median(stream.stamp_ns[mask]))
    days = abs(int(stream.stamp_ns[dropped][0]) - near) / 86_400e9
    count, total = int(dropped.sum()), len(mask)
    notes.append(
        f"{stream.topic}: {count} of {total} stamps lie far from all others, the first by {days:.1f} days;"
        " these samples were dropped."
    )
    columns: dict[str, Any] = {
        name: kept(getattr(stream, name), mask, store)
        for name in ("stamp_ns", "acc", "gyro", "mag", "position", "state", "quaternion", "score")
        if getattr(stream, name, None) is not None
    }
    if isinstance(stream, PoseSamples):
        columns["joints"] = {name: kept(values, mask, store) for name, values in stream.joints.items()}
    return replace(stream, **columns)
