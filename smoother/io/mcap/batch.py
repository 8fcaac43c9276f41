"""Messages of several channels put in the order of their times, as records of an MCAP file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ...array_types import IntArray
from ..wire.protobuf_encode import HEAD_BYTES
from .messages import ChunkMessages
from .records import HEAD, MESSAGE

#: Messages of one stream: rows (n, HEAD_BYTES + size) behind room for their heads, or one by one.
Encoded = NDArray[np.uint8] | list[bytes]


class Records(NamedTuple):
    """Messages with their heads, as they stand in a file.

    Attributes
    ----------
    channel : ndarray of int, shape (n,)
        Numbers of their channels.
    log_ns : ndarray of int, shape (n,), ns
        Log times.
    sizes : ndarray of int, shape (n,), bytes
        Of the records.
    records : list of bytes
        Heads and payloads.
    """

    channel: IntArray
    log_ns: IntArray
    sizes: IntArray
    records: list[bytes]


class Batch:
    """Messages to be sorted and written together."""

    def __init__(self) -> None:
        self._columns: list[IntArray] = []
        self._data: list[Encoded] = []

    def extend(self, channel: int, time_ns: IntArray, data: Encoded) -> None:
        """Our own messages, to be numbered."""
        if not len(time_ns):
            return
        columns = np.full((4, len(time_ns)), -1, np.int64)
        columns[0], columns[2:] = channel, time_ns
        self._columns.append(columns)
        self._data.append(data)

    def add(self, messages: ChunkMessages, channels: list[int]) -> None:
        """Messages of another file, which keep their numbers; `channels` are those of its topics."""
        channel = np.array(channels, np.int64)[messages.topic]
        self._columns.append(np.stack([channel, messages.sequence, messages.log_ns, messages.publish_ns]))
        self._data.append(messages.data)

    def own(self) -> Counter[int]:
        """How many messages of our own it has, by channel."""
        counts: Counter[int] = Counter()
        for columns in self._columns:
            if columns[1, 0] < 0:
                counts[int(columns[0, 0])] += columns.shape[1]
        return counts

    def sorted(self, numbers: Mapping[int, int]) -> Records:
        """All messages by log time; those of one time in the order in which they came.

        Parameters
        ----------
        numbers : mapping of int to int
            The next message's number by channel; zero where there is none.
        """
        if not self._columns:
            nothing = np.empty(0, np.int64)
            return Records(nothing, nothing, nothing, [])
        columns = np.concatenate(self._columns, axis=1)
        channel, sequence, log_ns, publish_ns = columns
        order = np.argsort(log_ns, kind="stable")
        own = order[sequence[order] < 0]
        by_channel = own[np.argsort(channel[own].astype(np.uint16), kind="stable")]
        counts, start = np.bincount(channel[own]), 0
        for number in np.flatnonzero(counts).tolist():
            rows = by_channel[start : start + int(counts[number])]
            sequence[rows] = numbers.get(number, 0) + np.arange(len(rows))
            start += len(rows)
        heads = np.empty(len(channel), MESSAGE)
        heads["opcode"] = Opcode.MESSAGE
        heads["channel"], heads["sequence"] = channel, sequence
        heads["log"], heads["publish"] = log_ns, publish_ns
        records: list[bytes] = []
        for data in self._data:
            records += _records(heads[len(records) : len(records) + len(data)], data)
        sizes = heads["length"].astype(np.int64) + HEAD.size
        return Records(channel[order], log_ns[order], sizes[order], [records[i] for i in order.tolist()])


def _records(heads: NDArray, data: Encoded) -> list[bytes]:
    """Heads and messages put together; the heads learn the messages' lengths."""
    if isinstance(data, list):
        heads["length"] = np.fromiter(map(len, data), np.int64, len(data)) + (MESSAGE.itemsize - HEAD.size)
        raw = heads.tobytes()
        starts = range(0, len(raw), MESSAGE.itemsize)
        return [raw[at : at + MESSAGE.itemsize] + each for at, each in zip(starts, data, strict=True)]
    heads["length"] = data.shape[1] - HEAD.size
    data[:, :HEAD_BYTES] = heads.view(np.uint8).reshape(len(data), -1)
    records: list[bytes] = data.view(f"V{data.shape[1]}")[:, 0].tolist()
    return records
