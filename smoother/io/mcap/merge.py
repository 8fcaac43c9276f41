"""Streams of messages to one MCAP file, in the order of their times, a batch of rows at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple

import numpy as np

from ...array_types import FloatArray, IntArray
from ..wire.schemas import schema_data
from .chunks import Batch, ChunkedFile
from .chunks import Encoded as Encoded
from .messages import ChunkMessages, Topic
from .stamps import nanoseconds

#: Messages that are encoded together; keeps memory flat however long the recording is.
SLICE = 2048
#: Messages of another file are written at the latest when they hold so many bytes.
_HELD_BYTES = 1 << 23
#: After all times.
END = int(np.iinfo(np.int64).max)


@dataclass
class OutputStream:
    """Messages of one channel still to be encoded.

    Attributes
    ----------
    channel : int
        The channel's number.
    time_ns : ndarray of int, shape (N,), ns
        Log times; negative ones are written as zero.
    encode : callable
        Wire form of a slice of the messages.
    """

    channel: int
    time_ns: IntArray
    encode: Callable[[slice], Encoded]

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
        self._sequence: Counter[int] = Counter()
        self._latest: dict[int, int] = {}
        self._foreign: Iterator[ChunkMessages] = iter(())
        self._next_foreign: ChunkMessages | None = None

    def __enter__(self) -> Output:
        self._open = open(self._path, "wb")
        self._file = ChunkedFile(self._open)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._open is not None
        with self._open:
            try:
                if kind is None:
                    self._file.finish()
            finally:
                self._file.close()

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

    def interleave(self, chunks: Iterable[ChunkMessages]) -> None:
        """Write these messages of another file between all that comes, about in the order of their times."""
        self._foreign = iter(chunks)
        self._next_foreign = next(self._foreign, None)

    def write(self, outgoing: Sequence[OutputStream], until: int = END) -> None:
        """Write streams by log time, and between them those of another file.

        Parameters
        ----------
        outgoing : sequence of OutputStream
            Streams to encode.
        until : int, ns
            Log time before which all of them lie, and from which on others will come.
        """
        latest = dict(self._latest)
        for stream in outgoing:  # streams that go on where an earlier part of them ended
            if len(stream.time_ns):
                stream.time_ns = np.maximum(stream.time_ns, latest.get(stream.channel, 0))
                last = int(stream.time_ns[-1])
                self._latest[stream.channel] = max(self._latest.get(stream.channel, 0), last)
        for edge, batch in _slices(outgoing, until):
            self._write(self._with_foreign(batch, edge))

    def flush(self) -> None:
        """Write all that was given so far, so that a reader of the unfinished file has it."""
        self._file.flush()

    def _with_foreign(self, batch: Batch, edge: int) -> Batch:
        """A batch with the messages of another file that come before an edge; some are written at once."""
        held = 0
        while self._next_foreign is not None:
            chunk = self._next_foreign
            late = chunk.log_ns >= edge
            stop = int(np.argmax(late)) if late.any() and edge != END else len(chunk.data)
            if stop:
                early = chunk.select(slice(0, stop))
                batch.add(early, [self._channel(topic) for topic in early.topics])
                held += sum(map(len, early.data))
            if stop < len(chunk.data):
                self._next_foreign = chunk.select(slice(stop, None))
                break
            self._next_foreign = next(self._foreign, None)
            if held > _HELD_BYTES:
                self._write(batch)
                batch, held = Batch(), 0
        return batch

    def _write(self, batch: Batch) -> None:
        records = batch.sorted(self._sequence)
        self._sequence.update(batch.own())
        self._file.messages(*records)


def _slices(outgoing: Sequence[OutputStream], until: int) -> Iterator[tuple[int, Batch]]:
    """Yield batches of messages of all streams, and the log time that each ends before."""
    streams = [stream for stream in outgoing if len(stream.time_ns)]
    longest = max((stream.time_ns for stream in streams), key=len, default=np.empty(0, np.int64))
    edges = [*longest[SLICE::SLICE].tolist(), until]
    starts = [0] * len(streams)
    for edge in edges:
        batch = Batch()
        for i, stream in enumerate(streams):
            stop = int(np.searchsorted(stream.time_ns, edge)) if edge != until else len(stream.time_ns)
            # A stream may be far denser here than the longest is: encode it in parts all the same.
            for start in range(starts[i], stop, SLICE):
                part = slice(start, min(start + SLICE, stop))
                batch.extend(stream.channel, stream.time_ns[part], stream.encode(part))
            starts[i] = stop
        yield edge, batch


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
