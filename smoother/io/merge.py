"""Streams of messages to one MCAP file, in the order of their times."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np
from mcap.records import Schema
from mcap.writer import CompressionType, Writer

from ..recording import IntArray
from .container import Message, Topic
from .schemas import schema_data

#: Messages that are encoded together; keeps memory flat however long the recording is.
_SLICE = 4096
_LIBRARY = "unocclude"


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
        self.time_ns = (
            np.maximum(np.maximum.accumulate(self.time_ns), 0) if len(self.time_ns) else self.time_ns
        )


class Output:
    """An MCAP file being written; the same input gives the same bytes."""

    def __init__(self, path: Path):
        self._path = path
        self._file: IO[bytes] | None = None
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, str, bytes], int] = {}

    def __enter__(self) -> Output:
        self._file = open(self._path, "wb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(library=_LIBRARY)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._file is not None
        with self._file:
            if kind is None:
                self._writer.finish()

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, values)

    def channel(self, topic: str, schema: str) -> int:
        """Number of a topic of protobuf messages by the schema's full name."""
        if topic not in self._channels:
            number = self._schema(Schema(data=schema_data(schema), encoding="protobuf", id=0, name=schema))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", number)
        return self._channels[topic]

    def carried(self, topic: Topic) -> int:
        """Number of a topic that is carried over as it is."""
        key = f"{topic.name}\0{topic.encoding}\0{topic.schema}"
        if key not in self._channels:
            schema = 0
            if topic.schema:
                schema = self._schema(
                    Schema(data=topic.schema_data, encoding=topic.schema_encoding, id=0, name=topic.schema)
                )
            self._channels[key] = self._writer.register_channel(
                topic.name, topic.encoding, schema, topic.metadata
            )
        return self._channels[key]

    def write(self, outgoing: Sequence[Outgoing], passed: Iterable[Message] = ()) -> None:
        """Write streams, and messages of another file between them, merged by log time.

        Parameters
        ----------
        outgoing : streams to encode.
        passed : messages carried over as they are, about in the order of their log times.
        """
        sequence: dict[int, int] = {}
        carried = iter(passed)
        waiting = next(carried, None)
        add = self._writer.add_message
        for time, channel, data in _merged(outgoing):
            while waiting is not None and waiting.log_ns <= time:
                self._carry(waiting)
                waiting = next(carried, None)
            number = sequence.get(channel, 0)
            sequence[channel] = number + 1
            add(channel, time, data, time, number)
        while waiting is not None:
            self._carry(waiting)
            waiting = next(carried, None)

    def _carry(self, message: Message) -> None:
        self._writer.add_message(
            self.carried(message.topic),
            message.log_ns,
            bytes(message.data),
            message.publish_ns,
            message.sequence,
        )

    def _schema(self, schema: Schema) -> int:
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return self._schemas[key]


def _merged(outgoing: Sequence[Outgoing]) -> Iterator[tuple[int, int, bytes]]:
    """Yield time, channel and data of all messages by time; equal times in the streams' order."""
    streams = [stream for stream in outgoing if len(stream.time_ns)]
    if not streams:
        return
    longest = max(streams, key=lambda stream: len(stream.time_ns))
    edges = [*longest.time_ns[_SLICE::_SLICE].tolist(), np.iinfo(np.int64).max]
    starts = [0] * len(streams)
    for edge in edges:
        times, rows, data = [], [], []
        for i, stream in enumerate(streams):
            stop = int(np.searchsorted(stream.time_ns, edge))
            # A stream may be far denser here than the longest is: encode it in pieces all the same.
            for start in range(starts[i], stop, _SLICE):
                part = slice(start, min(start + _SLICE, stop))
                data += stream.encode(part)
                times.append(stream.time_ns[part])
                rows.append(np.full(part.stop - part.start, stream.channel))
            starts[i] = stop
        if not times:
            continue
        time, channel = np.concatenate(times), np.concatenate(rows)
        order = np.argsort(time, kind="stable")
        for row in zip(time[order].tolist(), channel[order].tolist(), order.tolist(), strict=True):
            yield row[0], row[1], data[row[2]]
