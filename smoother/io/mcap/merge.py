"""Streams of messages to one MCAP file, in the order of their times; a damaged file written anew.

The mcap package packs each message in Python, which would take longer than solving the motion. Here the
messages of a batch are packed together by NumPy; all other records are the package's.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.outputs import writing
from ...runtime.printable import printable
from ..wire.protobuf import Encoder
from ..wire.schemas import schema_data
from .container import CHUNK, HEAD, MAGIC, MESSAGE, Container
from .messages import Messages, Topic, damage_note

#: Messages that are encoded together; keeps memory flat however long the recording is.
SLICE = 2048
_CHUNK_BYTES = 1 << 20
#: A chunk's index of a channel up to its entries: the channel, and the bytes of the entries.
_INDEX = struct.Struct("<HI")
#: Compression. Level 1 takes half as long again, on drawn motions six times, for files that are 1 % smaller.
_COMPRESSION, _LEVEL = "zstd", -1

#: Messages of one stream: rows (n, size), or one by one.
Encoded = NDArray[np.uint8] | list[bytes]


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
        self._file: IO[bytes] | None = None
        self._channels: dict[tuple[str, str, str], Channel] = {}
        self._schemas: dict[tuple[str, str, bytes], Schema] = {}
        self._latest: dict[int, int] = {}
        self._counts: Counter[int] = Counter()
        self._chunks, self._first_ns, self._last_ns = 0, np.iinfo(np.int64).max, 0
        self._chunk_indexes = RecordBuilder()  # 0.1 kB a chunk, so that a session may last a day
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []

    def __enter__(self) -> Output:
        self._file = open(self._path, "wb")
        self._put(MAGIC)
        self._put(_packed(Header(profile="", library="unocclude")))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._file is not None
        with self._file:
            if kind is None:
                self._finish()

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        record = _packed(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=self._put(record), length=len(record), name=name))

    def attachment(self, name: str, data: IO[bytes], media_type: str = "application/octet-stream") -> None:
        """Write an attachment of what a file has from its start on, a part at a time."""
        size = data.seek(0, os.SEEK_END)
        builder = RecordBuilder()
        builder.write(bytes(16))  # times
        builder.write_prefixed_string(name)
        builder.write_prefixed_string(media_type)
        builder.write8(size)
        head = builder.end()
        at = self._put(HEAD.pack(Opcode.ATTACHMENT, len(head) + size + 4) + head)
        crc = zlib.crc32(head)
        data.seek(0)
        while part := data.read(_CHUNK_BYTES):
            crc = zlib.crc32(part, crc)
            self._put(part)
        length = self._put(struct.pack("<I", crc)) + 4 - at
        self._attachments.append(AttachmentIndex(at, length, 0, 0, size, name, media_type))

    def channel(self, topic: str, schema: str) -> int:
        """Number of a topic of protobuf messages by the schema's full name."""
        return self._channel(Topic(topic, schema, "protobuf", schema_data(schema), "protobuf"))

    def _channel(self, topic: Topic) -> int:
        key = (topic.name, topic.encoding, topic.schema)
        if key in self._channels:
            return int(self._channels[key].id)
        its, schema_id = (topic.schema, topic.schema_encoding, topic.schema_data), 0
        if topic.schema:
            if its not in self._schemas:
                name, encoding, data = its
                self._schemas[its] = Schema(
                    id=len(self._schemas) + 1, name=name, encoding=encoding, data=data
                )
                self._put(_packed(self._schemas[its]))
            schema_id = self._schemas[its].id
        self._channels[key] = Channel(
            id=len(self._channels) + 1,
            topic=topic.name,
            message_encoding=topic.encoding,
            schema_id=schema_id,
            metadata=topic.metadata,
        )
        self._put(_packed(self._channels[key]))
        return int(self._channels[key].id)

    def copy(self, topics: Sequence[Topic], messages: Messages) -> None:
        """Write messages of another file by log time."""
        channels = np.zeros(len(topics), np.int64)
        for position in np.unique(messages.topic).tolist():
            channels[position] = self._channel(topics[position])
        columns = (channels[messages.topic], messages.sequence, messages.log_ns, messages.publish_ns)
        self._write(np.stack(columns), messages.payloads())

    def write(self, outgoing: Sequence[OutputStream]) -> None:
        """Write streams by log time, a batch at a time."""
        latest = dict(self._latest)
        streams = [stream for stream in outgoing if len(stream.time_ns)]
        for stream in streams:  # streams that go on where an earlier part of them ended
            stream.time_ns = np.maximum(stream.time_ns, latest.get(stream.channel, 0))
            last = int(stream.time_ns[-1])
            self._latest[stream.channel] = max(self._latest.get(stream.channel, 0), last)
        longest = max((stream.time_ns for stream in streams), key=len, default=np.empty(0, np.int64))
        starts = [0] * len(streams)
        for edge in [*longest[SLICE::SLICE].tolist(), None]:
            columns, payloads = [np.empty((4, 0), np.int64)], list[bytes]()
            for i, stream in enumerate(streams):
                stop = len(stream.time_ns) if edge is None else int(np.searchsorted(stream.time_ns, edge))
                # a stream may be far denser here than the longest is: it is encoded in parts all the same
                for start in range(starts[i], stop, SLICE):
                    part = slice(start, min(start + SLICE, stop))
                    time_ns = stream.time_ns[part]
                    columns.append(
                        np.stack([np.full_like(time_ns, stream.channel), 0 * time_ns, time_ns, time_ns])
                    )
                    encoded = stream.encode(part)
                    payloads += encoded if isinstance(encoded, list) else [row.tobytes() for row in encoded]
                starts[i] = stop
            self._write(np.concatenate(columns, axis=1), payloads)

    def stream(
        self,
        topic: str,
        schema: str,
        time_ns: IntArray,
        constants: Mapping[str, Any],
        columns: Callable[[slice], dict[str, NDArray]],
    ) -> OutputStream:
        """Protobuf messages of a topic, to be written, that differ in the columns of their rows alone."""
        encode = Encoder(schema, constants)
        return OutputStream(self.channel(topic, schema), time_ns, lambda part: encode(columns(part)))

    def each(
        self, topic: str, schema: str, time_ns: IntArray, encode: Callable[[int], bytes]
    ) -> OutputStream:
        """Protobuf messages of a topic, to be written, that are encoded one by one, by their numbers."""
        channel = self.channel(topic, schema)
        return OutputStream(channel, time_ns, lambda part: [encode(k) for k in range(part.start, part.stop)])

    def flush(self) -> None:
        """Write all that was given so far, so that a reader of the unfinished file has it."""
        assert self._file is not None
        self._file.flush()

    def _write(self, columns: IntArray, payloads: list[bytes]) -> None:
        """Write messages by log time, those of one time as they came, in chunks of about a megabyte.

        Columns are channels, numbers, log and publish times (4, n).
        """
        order = np.argsort(columns[2], kind="stable")
        columns, payloads = columns[:, order], [payloads[row] for row in order.tolist()]
        heads = np.empty(len(order), MESSAGE)
        heads["opcode"] = Opcode.MESSAGE
        heads["length"] = MESSAGE.itemsize - HEAD.size + np.fromiter(map(len, payloads), np.int64, len(order))
        heads["channel"], heads["sequence"], heads["log"], heads["publish"] = columns
        packed, starts = heads.tobytes(), range(0, heads.nbytes, MESSAGE.itemsize)
        records = [
            packed[at : at + MESSAGE.itemsize] + data for at, data in zip(starts, payloads, strict=True)
        ]
        ends, start = np.cumsum(heads["length"].astype(np.int64) + HEAD.size), 0
        while start < len(records):
            before = int(ends[start - 1]) if start else 0
            stop = max(int(np.searchsorted(ends, before + _CHUNK_BYTES, "right")), start + 1)
            rows, offsets = slice(start, stop), np.append(before, ends[start : stop - 1]) - before
            self._write_chunk(b"".join(records[rows]), columns[0, rows], columns[2, rows], offsets)
            start = stop

    def _write_chunk(self, data: bytes, channel: IntArray, log_ns: IntArray, offsets: IntArray) -> None:
        first, last, name = int(log_ns.min()), int(log_ns.max()), _COMPRESSION.encode()
        packed = zstandard.ZstdCompressor(level=_LEVEL).compress(data)
        head = CHUNK.pack(first, last, len(data), zlib.crc32(data), len(name)) + name
        head += struct.pack("<Q", len(packed))
        at = self._put(HEAD.pack(Opcode.CHUNK, len(head) + len(packed)) + head + packed)
        index = {}
        for number in np.unique(channel).tolist():
            mine = channel == number
            entries = np.stack([log_ns[mine], offsets[mine]], axis=1).astype("<u8").tobytes()
            content = _INDEX.pack(number, len(entries)) + entries
            index[number] = HEAD.pack(Opcode.MESSAGE_INDEX, len(content)) + content
            self._counts[number] += int(mine.sum())
        index_at = self._put(b"".join(index.values()))
        ChunkIndex(
            message_start_time=first,
            message_end_time=last,
            chunk_start_offset=at,
            chunk_length=index_at - at,
            message_index_offsets=dict(
                zip(index, itertools.accumulate(map(len, index.values()), initial=index_at), strict=False)
            ),
            message_index_length=sum(map(len, index.values())),
            compression=_COMPRESSION,
            compressed_size=len(packed),
            uncompressed_size=len(data),
        ).write(self._chunk_indexes)
        self._chunks += 1
        self._first_ns, self._last_ns = min(self._first_ns, first), max(self._last_ns, last)

    def _finish(self) -> None:
        """Write the index that players look for at the file's end."""
        end = _packed(DataEnd(data_section_crc=0))
        start = self._put(end) + len(end)
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_start_time=self._first_ns if self._chunks else 0,
            message_end_time=self._last_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        summary = _packed(*self._schemas.values(), *self._channels.values(), statistics)
        summary += self._chunk_indexes.end() + _packed(*self._attachments, *self._metadata)
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0), zlib.crc32(summary))
        footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=crc)
        self._put(summary + _packed(footer) + MAGIC)

    def _put(self, data: bytes) -> int:
        """Write bytes; where they begin."""
        assert self._file is not None
        self._file.write(data)
        return self._file.tell() - len(data)


def _packed(*records: Any) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


#: Metadata record that lists what the file had lost when it was repaired.
REPAIRED = "unocclude.repair"


def repair_container(
    source: str | os.PathLike[str], output: str | os.PathLike[str], force: bool = False
) -> dict[str, Any]:
    """Write what is still in a damaged MCAP file as a whole one; what was there and is lost, as JSON."""
    container = Container(source, unverified=True)
    with writing(output, force) as temporary, Output(temporary) as file:
        for chunk in container.chunks():
            file.copy(container.topics, chunk)
        messages: Counter[str] = Counter()
        for topic in container.topics:
            messages[topic.name] += topic.count
        if not +messages:
            why = [f"{source} has no complete message; nothing can be repaired.", *container.notes[:3]]
            raise RecordingError(" ".join(why))
        for name, values in container.metadata.items():
            if name != REPAIRED:
                file.metadata(name, values)
        name, left_out = damage_note(container.path.name, ""), 0
        told = [note.removeprefix(name) for note in container.notes]
        if notes := list(dict.fromkeys([*_noted(container.metadata), *told])):
            file.metadata(REPAIRED, {"notes": json.dumps(notes), "missing": json.dumps(container.missing)})
        for name in container.attachments:
            try:
                file.attachment(name, BytesIO(container.attachment(name)))
            except ValueError:
                left_out += 1
    return {
        "source": container.path.name,
        "messages": dict(+messages),  # Written, by topic
        "missing": container.missing,  # Lost by topic, as the file's own count says; empty where it has none
        "losses": [dataclasses.asdict(each) for each in container.damage],  # In the file's order
        "notes": container.notes,  # What was wrong, one sentence each
        "attachments_left_out": left_out,
    }


def repair_notes(metadata: dict[str, dict[str, str]]) -> list[str]:
    """What a repaired file had lost by its own record, as notes."""
    return [damage_note("that was repaired", printable(note[:1000])) for note in _noted(metadata)[:20]]


def _noted(metadata: dict[str, dict[str, str]]) -> list[str]:
    try:
        return [str(note) for note in json.loads(metadata.get(REPAIRED, {}).get("notes", "[]"))]
    except (ValueError, TypeError, RecursionError):
        return ["nothing of the lost part can be read."]
