"""Long columns of several streams, cut into batches at the same times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...array_types import FloatArray, IntArray
from .merge import END, SLICE
from .stamps import nanoseconds


class TimeAxis(NamedTuple):
    """Times of a stream.

    Attributes
    ----------
    t_s : ndarray, shape (N,), s
        After the origin, in rising order.
    origin_ns, shift_ns : int, ns
        The origin, and log time less stamp.
    """

    t_s: FloatArray
    origin_ns: int
    shift_ns: int

    def log_ns(self, rows: slice) -> IntArray:
        """Log times of some rows, ns."""
        return nanoseconds(self.t_s[rows], self.origin_ns) + self.shift_ns


class TimeBatch(NamedTuple):
    """Rows of several streams.

    Attributes
    ----------
    until_ns : int, ns
        Log time that they end before.
    rows : list of slice
        Of each axis.
    """

    until_ns: int
    rows: list[slice]


def time_batches(axes: Sequence[TimeAxis], most: int = SLICE) -> Iterator[TimeBatch]:
    """Cut streams where the densest of them has `most` rows; there is one batch at the least.

    Rows that run back in time are in the batch of those around them.

    Parameters
    ----------
    axes : sequence of TimeAxis
        Of the streams.
    most : int
        Rows of a stream in one batch.

    Yields
    ------
    TimeBatch
        Every row is in one of them.
    """
    starts = [0] * len(axes)
    while True:
        ahead = [
            axis.log_ns(slice(start, start + most + 1)) for axis, start in zip(axes, starts, strict=True)
        ]
        until = min((int(times[most]) for times in ahead if len(times) > most), default=END)
        first = min((int(times[0]) for times in ahead if len(times)), default=END)
        until = max(until, first + 1) if until != END else END  # on and on, also where times stand still
        rows = []
        for i, times in enumerate(ahead):
            late = times >= until
            count = int(np.argmax(late)) if late.any() and until != END else len(times)
            rows.append(slice(starts[i], starts[i] + count))
            starts[i] += count
        yield TimeBatch(until, rows)
        if until == END:
            return
