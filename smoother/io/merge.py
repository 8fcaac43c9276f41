"""Streams of messages to one MCAP file, in the order of their times."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np
from numpy.typing import NDArray

from ..recording import IntArray
from .chunks import ChunkedFile
from .messages import Run, Topic
from .schemas import schema_data

#: Messages that are encoded together; keeps memory flat however long the recording is.
_SLICE = 4096
#: Messages carried over are written at the latest when they hold so many bytes.
_HELD_BYTES = 1 << 23
_END = int(np.iinfo(np.int64).max)


@dataclass
class Outgoing:
    """Messages of one channel still to be encoded.

    Attributes
    ----------
    channel : the channel's number.
    time_ns : (N,) log times, ns; negative ones are written as zero.
    encode : wire form of a slice of the messages.
    """

    channel: int
    time_ns: IntArray
    encode: Callable[[slice], list[bytes]]

    def __post_init__(self) -> None:
        # Log times must not run back, or slices could not be cut; stamps inside stay as they are.
        if len(self.time_ns):
            self.time_ns = np.maximum(np.maximum.accumulate(self.time_ns), 0)


class Output:
    """An MCAP file being written; the same input gives the same bytes."""

    def __init__(self, path: Path):
        self._path = path
        self._open: IO[bytes] | None = None
        self._channels: dict[tuple[str, str, str], int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._sequence: dict[int, int] = {}

    def __enter__(self) -> Output:
        self._open = open(self._path, "wb")
        self._file = ChunkedFile(self._open)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._open is not None
        with self._open:
            if kind is None:
                self._file.finish()

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._file.metadata(name, values)

    def channel(self, topic: str, schema: str) -> int:
        """Number of a topic of protobuf messages by the schema's full name."""
        return self._channel(Topic(topic, schema, "protobuf", schema_data(schema), "protobuf"))

    def _channel(self, topic: Topic) -> int:
        key = (topic.name, topic.encoding, topic.schema)
        if key not in self._channels:
            schema = 0
            if topic.schema:
                its = (topic.schema, topic.schema_encoding, topic.schema_data)
                if its not in self._schemas:
                    self._schemas[its] = self._file.schema(*its)
                schema = self._schemas[its]
            self._channels[key] = self._file.channel(topic.name, topic.encoding, schema, topic.metadata)
        return self._channels[key]

    def write(self, outgoing: Sequence[Outgoing], passed: Iterable[Run] = ()) -> None:
        """Write streams, and messages of another file between them, by log time.

        Parameters
        ----------
        outgoing : streams to encode.
        passed : messages carried over as they are, about in the order of their log times.
        """
        carried = iter(passed)
        waiting = next(carried, None)
        for edge, batch in _slices(outgoing):
            held = 0
            while waiting is not None:
                late = waiting.log_ns >= edge
                stop = int(np.argmax(late)) if late.any() and edge != _END else len(waiting.data)
                if stop:
                    part = waiting.part(slice(0, stop))
                    batch.add(part, [self._channel(topic) for topic in part.topics])
                    held += sum(map(len, part.data))
                if stop < len(waiting.data):
                    waiting = waiting.part(slice(stop, None))
                    break
                waiting = next(carried, None)
                if held > _HELD_BYTES:
                    self._write(batch)
                    batch, held = _Batch(), 0
            self._write(batch)

    def _write(self, batch: _Batch) -> None:
        channel, sequence, log_ns, publish_ns, data = batch.sorted()
        if not data:
            return
        # Our own messages are numbered here; those carried over keep their numbers.
        for number in np.unique(channel[sequence < 0]).tolist():
            mine = (channel == number) & (sequence < 0)
            first = self._sequence.get(number, 0)
            sequence[mine] = first + np.arange(mine.sum())
            self._sequence[number] = first + int(mine.sum())
        self._file.messages(channel, sequence, log_ns, publish_ns, data)


class _Batch:
    """Messages to be sorted and written together."""

    def __init__(self) -> None:
        self._encoded: list[tuple[int, IntArray, list[bytes]]] = []
        self._carried: list[NDArray] = []
        self._carried_data: list[bytes] = []

    def extend(self, channel: int, time_ns: IntArray, data: list[bytes]) -> None:
        self._encoded.append((channel, time_ns, data))

    def add(self, run: Run, channels: list[int]) -> None:
        """Messages carried over; `channels` of the run's topics."""
        channel = np.array(channels, np.int64)[run.topic]
        self._carried.append(np.stack([channel, run.sequence, run.log_ns, run.publish_ns], axis=1))
        self._carried_data += run.data

    def sorted(self) -> tuple[IntArray, IntArray, IntArray, NDArray, list[bytes]]:
        """Channel, sequence (-1: to be numbered), log time, publish time, data; by log time."""
        parts = [np.zeros((0, 4), np.int64), *self._carried]
        for channel, time_ns, _ in self._encoded:
            part = np.full((len(time_ns), 4), -1, np.int64)
            part[:, 0] = channel
            part[:, 2] = part[:, 3] = time_ns
            parts.append(part)
        table = np.concatenate(parts)
        data = list(chain(self._carried_data, *(part for _, _, part in self._encoded)))
        order = np.argsort(table[:, 2], kind="stable")
        table = table[order]
        return table[:, 0], table[:, 1], table[:, 2], table[:, 3], [data[i] for i in order.tolist()]


def _slices(outgoing: Sequence[Outgoing]) -> Iterator[tuple[int, _Batch]]:
    """Yield runs of time: where each ends, and the messages of all streams in it."""
    streams = [stream for stream in outgoing if len(stream.time_ns)]
    longest = max((stream.time_ns for stream in streams), key=len, default=np.empty(0, np.int64))
    starts = [0] * len(streams)
    for edge in [*longest[_SLICE::_SLICE].tolist(), _END]:
        batch = _Batch()
        for i, stream in enumerate(streams):
            stop = int(np.searchsorted(stream.time_ns, edge)) if edge != _END else len(stream.time_ns)
            # A stream may be far denser here than the longest is: encode it in pieces all the same.
            for start in range(starts[i], stop, _SLICE):
                part = slice(start, min(start + _SLICE, stop))
                batch.extend(stream.channel, stream.time_ns[part], stream.encode(part))
            starts[i] = stop
        yield edge, batch
