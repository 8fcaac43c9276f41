"""Recordings of live streams: messages stand as they arrived, and are put in the order of their stamps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...runtime.store import Store, batches
from .streams import ArmFrames, ImuSamples, RecordingFile

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
