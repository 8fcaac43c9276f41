"""Streams of messages to one MCAP file, in the order of their times, a batch of rows at a time.

A damaged MCAP file written anew: every complete message, in the order of time, with a new index.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from ..wire.layout import joined
from ..wire.schemas import schema_data
from .chunks import Batch, ChunkedFile
from .chunks import Encoded as Encoded
from .container import Container
from .messages import ChunkMessages, Loss, Topic, nanoseconds

#: Messages that are encoded together; keeps memory flat however long the recording is.
SLICE = 2048
#: Messages of another file are written at the latest when they contain this many bytes.
_HELD_BYTES = 1 << 23
#: After all times.
END = int(np.iinfo(np.int64).max)


@dataclass
class OutputStream:
    """Messages of one channel still to be encoded."""

    channel: int  # The channel's number
    time_ns: IntArray  # int (N,) ns: log times; negative ones are written as zero
    encode: Callable[[slice], Encoded]  # Wire form of a slice of the messages

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
        """Write streams by log time, and between them those of another file."""
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
            stop = int(np.argmax(late)) if late.any() and edge != END else len(late)
            if stop:
                early = chunk.select(slice(0, stop))
                batch.add(early, [self._channel(topic) for topic in early.topics])
                held += int((early.stop - early.start).sum())
            if stop < len(chunk.log_ns):
                self._next_foreign = chunk.select(slice(stop, None))
                break
            self._next_foreign = next(self._foreign, None)
            if held > _HELD_BYTES:
                self._write(batch)
                batch, held = Batch(), 0
        return batch

    def _write(self, batch: Batch) -> None:
        self._file.messages(batch, dict(self._sequence))
        self._sequence.update(batch.own())


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
    """Times of a stream."""

    t_s: FloatArray  # (N,) s: after the origin, in rising order
    origin_ns: int  # The origin, and log time less stamp
    shift_ns: int  # The origin, and log time less stamp

    def log_ns(self, rows: slice) -> IntArray:
        """Log times of some rows, ns."""
        return nanoseconds(self.t_s[rows], self.origin_ns) + self.shift_ns


class TimeBatch(NamedTuple):
    """Rows of several streams."""

    until_ns: int  # Log time that they end before
    rows: list[slice]  # Of each axis


def time_batches(axes: Sequence[TimeAxis], most: int = SLICE) -> Iterator[TimeBatch]:
    """Cut streams where the densest of them has `most` rows; there is one batch at the least."""
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


#: Metadata record that lists what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"
#: This many messages are written together.
_TOGETHER = 4096


@dataclass
class RepairReport:
    """What was still in a damaged file."""

    source: str  # The damaged file's name
    messages: dict[str, int] = field(default_factory=dict)  # Written, by topic
    # Lost by topic, as the damaged file's own count says; empty where it has none
    missing: dict[str, int] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)  # What is damaged, in the file's order
    notes: list[str] = field(default_factory=list)  # What was wrong, one sentence each
    attachments: int = 0  # That were not carried over

    def to_dict(self) -> dict[str, Any]:
        """Plain values, fit for JSON."""
        return {
            "source": self.source,
            "messages": self.messages,
            "missing": self.missing,
            "losses": [
                {
                    "what": loss.what,
                    "start_byte": loss.start,
                    "stop_byte": loss.stop,
                    "first_ns": loss.first_ns,
                    "last_ns": loss.last_ns,
                    "messages": loss.counts,
                    "messages_kept_unverified": loss.is_kept,
                }
                for loss in self.losses
            ],
            "attachments_left_out": self.attachments,
            "notes": self.notes,
        }


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> RepairReport:
    """Write what is still in a damaged MCAP file as a whole one."""
    container = Container(source, unverified=True)
    with tempfile.TemporaryFile() as payloads:
        rows, topics = spooled(container, payloads)
        if any("no record before them" in loss.what for loss in container.losses):
            container = Container(source, unverified=True, definitions=container.definitions)
            payloads.seek(0)
            payloads.truncate()
            rows, topics = spooled(container, payloads)
        report = _report(container, topics, rows)
        if not len(rows):
            raise RecordingError(
                " ".join([f"{source} has no complete message; nothing can be repaired.", *report.notes[:3]])
            )
        with writing(output, force) as temporary, Output(temporary) as file:
            for name, values in container.metadata.items():
                if name != REPAIRED:
                    file.metadata(name, values)
            if report.notes or REPAIRED in container.metadata:
                file.metadata(REPAIRED, _told(report, container.metadata.get(REPAIRED, {})))
            file.interleave(by_time(rows, topics, payloads))
            file.write([])
    return report


def repair_notes(metadata: dict[str, dict[str, str]]) -> list[str]:
    """What a repaired file had lost by its own record, as notes."""
    try:
        notes = json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))
    except (ValueError, RecursionError):
        notes = ["nothing of the lost part can be read."]
    if not isinstance(notes, list):
        notes = [notes]
    return [f"The file was repaired: {printable(str(note)[:1000])}" for note in notes[:20]]


def _told(report: RepairReport, before: dict[str, str]) -> dict[str, str]:
    """The metadata record of a repaired file; what an earlier repair said stays."""
    try:
        earlier = [str(note) for note in json.loads(before.get("notes", "[]"))]
    except (ValueError, TypeError, RecursionError):
        earlier = []
    return {
        "notes": json.dumps(list(dict.fromkeys([*earlier, *report.notes]))),
        "missing": json.dumps(report.missing),
    }


def spooled(container: Container, payloads: IO[bytes]) -> tuple[IntArray, list[Topic]]:
    """All payloads in a file; by message topic, number, log and publish time, place and size, (n, 6)."""
    parts: list[IntArray] = []
    place = 0
    topics: list[Topic] = []
    for chunk in container.chunks(lambda topic: True):
        topics = chunk.topics
        data, start, stop = joined(chunk.chunk, chunk.start, chunk.stop)
        columns = (chunk.topic, chunk.sequence, chunk.log_ns, chunk.publish_ns, place + start, stop - start)
        parts.append(np.stack(columns, axis=1))
        payloads.write(data)
        place += len(data)
    return (np.concatenate(parts) if parts else np.empty((0, 6), np.int64)), topics


def by_time(rows: IntArray, topics: list[Topic], payloads: IO[bytes]) -> Iterator[ChunkMessages]:
    """Messages by log time; those of one time in the order in which they came."""
    order = np.argsort(rows[:, 2], kind="stable")
    for start in range(0, len(order), _TOGETHER):
        mine = rows[order[start : start + _TOGETHER]]
        data = []
        for place, size in mine[:, 4:].tolist():
            payloads.seek(place)
            data.append(payloads.read(size))
        topic, sequence, log_ns, publish_ns, _, sizes = mine.T
        ends = np.cumsum(sizes)
        yield ChunkMessages(topics, topic, sequence, log_ns, publish_ns, b"".join(data), ends - sizes, ends)


def _report(container: Container, topics: list[Topic], rows: IntArray) -> RepairReport:
    counts: Counter[str] = Counter()
    for number, count in enumerate(np.bincount(rows[:, 0], minlength=len(topics)).tolist()):
        counts[topics[number].name] += count
    return RepairReport(
        Path(container.path).name,
        dict(counts),
        dict(container.missing),
        list(container.losses),
        list(container.notes),
        container.attachments,
    )
