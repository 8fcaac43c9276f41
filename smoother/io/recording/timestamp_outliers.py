"""Stamps that lie far from all others: one wrong one must not make a recording ten days long."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...array_types import BoolArray, IntArray
from ...runtime.store import Store
from .clean import kept
from .streams import ArmFrames, FieldSamples, ImuSamples, PoseSamples, RecordingFile

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
