"""Streams whose stamps are put right: rows out of order, lone stamps far away."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, IntArray
from ...measurements.timestamps import largest_group
from ...runtime.store import Store, batches
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples, RecordingFile

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
