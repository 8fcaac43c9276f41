"""Stamps in nanoseconds, as files have them, and seconds after an origin."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray, IntArray
from ...runtime.store import Store, batches
from ..wire.layout import Block, MessageLayout

SECOND_NS = 1_000_000_000


def seconds(stamp_ns: IntArray, origin_ns: int, store: Store | None = None) -> FloatArray:
    """Stamps as seconds after an origin; `nanoseconds` gives the same stamps back.

    Parameters
    ----------
    stamp_ns : ndarray, shape (n,), ns
        Stamps.
    origin_ns : int, ns
        The origin.
    store : Store, optional
        Where the seconds are to lie; in memory if None.

    Returns
    -------
    t_s : ndarray, shape (n,), s
        Exact to the nanosecond within fifty days of the origin.
    """
    if store is None:
        return (stamp_ns - origin_ns) / 1e9
    t_s = store.array((len(stamp_ns),), 0.0)
    for part in batches(len(stamp_ns)):
        t_s[part] = (stamp_ns[part] - origin_ns) / 1e9
    return t_s


def nanoseconds(t_s: FloatArray, origin_ns: int) -> IntArray:
    """Seconds (n,) after an origin as stamps in ns."""
    return np.rint(np.asarray(t_s) * 1e9).astype(np.int64) + origin_ns


def ros_stamps(block: Block, layout: MessageLayout) -> IntArray:
    """Stamps (rows,) of ROS messages with the fields `sec` and `nsec`, ns."""
    seconds_part = layout.get(block, "sec")[:, 0].astype(np.int64)
    return seconds_part * SECOND_NS + layout.get(block, "nsec")[:, 0].astype(np.int64)
