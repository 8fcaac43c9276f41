"""An MCAP file written a chunk at a time, messages in the order of their times.

The mcap package packs each message in Python, which would take longer than solving the motion.
Here messages come packed (`Batch`); all other records are the package's.
"""

from __future__ import annotations

import itertools
import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import IO, Any, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from ...array_types import IntArray
from ..wire.layout import Buffer, copy_runs, runs
from .messages import ChunkMessages
from .records import CHUNK, HEAD, INDEX, MAGIC, MESSAGE

#: Messages of one stream: rows (n, size), or one by one.
Encoded = NDArray[np.uint8] | list[bytes]


class Records(NamedTuple):
    """Messages with their heads, as they are in a file."""

    channel: IntArray  # int (n,): numbers of their channels
    log_ns: IntArray  # int (n,) ns: log times
    sizes: IntArray  # int (n,) bytes: of the records
    records: memoryview  # Heads and payloads, one record behind the other


class Payloads(NamedTuple):
    """Messages of any sizes: a buffer, where in it each starts (n,), and its size (n,), bytes."""

    source: Buffer
    start: IntArray
    size: IntArray


class Batch:
    """Messages to be sorted and written together."""

    def __init__(self) -> None:
        self._columns: list[IntArray] = []
        self._payloads: list[NDArray[np.uint8] | Payloads] = []

    def extend(self, channel: int, time_ns: IntArray, data: Encoded) -> None:
        """Our own messages, to be numbered."""
        if not len(time_ns):
            return
        columns = np.full((4, len(time_ns)), -1, np.int64)
        columns[0], columns[2:] = channel, time_ns
        self._columns.append(columns)
        if isinstance(data, list):
            sizes = np.fromiter(map(len, data), np.int64, len(data))
            self._payloads.append(Payloads(b"".join(data), np.cumsum(sizes) - sizes, sizes))
        else:
            self._payloads.append(data)

    def add(self, messages: ChunkMessages, channels: list[int]) -> None:
        """Messages of another file, which keep their numbers; `channels` are those of its topics."""
        channel = np.array(channels, np.int64)[messages.topic]
        self._columns.append(np.stack([channel, messages.sequence, messages.log_ns, messages.publish_ns]))
        self._payloads.append(Payloads(messages.chunk, messages.start, messages.stop - messages.start))

    def own(self) -> Counter[int]:
        """How many messages of our own it has, by channel."""
        counts: Counter[int] = Counter()
        for columns in self._columns:
            if columns[1, 0] < 0:
                counts[int(columns[0, 0])] += columns.shape[1]
        return counts

    def sorted(self, numbers: Mapping[int, int]) -> Records:
        """All messages by log time; those of one time in the order in which they came."""
        if not self._columns:
            nothing = np.empty(0, np.int64)
            return Records(nothing, nothing, nothing, memoryview(b""))
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
        sizes = MESSAGE.itemsize + np.concatenate([_sizes(data) for data in self._payloads])
        heads["length"] = sizes - HEAD.size
        ends = np.cumsum(sizes[order])
        place = np.empty_like(ends)
        place[order] = ends - sizes[order]
        records = np.empty(ends[-1], np.uint8).data
        runs(records, MESSAGE.itemsize)[place] = heads.view(f"V{MESSAGE.itemsize}")
        first = 0
        for data in self._payloads:
            mine = place[first : first + len(_sizes(data))] + MESSAGE.itemsize
            first += len(mine)
            if isinstance(data, Payloads):
                copy_runs(data.source, data.start, data.size, records, mine)
            elif size := data.shape[1]:
                runs(records, size)[mine] = data.view(f"V{size}")[:, 0]
        return Records(channel[order], log_ns[order], sizes[order], records)


def _sizes(data: NDArray[np.uint8] | Payloads) -> IntArray:
    return data.size if isinstance(data, Payloads) else np.full(len(data), data.shape[1])


_CHUNK_BYTES = 1 << 20
_LIBRARY = "unocclude"
_COMPRESSION = "zstd"
#: Of zstd: level 1 takes half as long again, on drawn motions six times, for files that are 1 % smaller.
_LEVEL = -1
#: Threads that compress.
_THREADS = 2


class ChunkedFile:
    """Writes an MCAP file: chunks of messages, and the index that players look for at its end."""

    def __init__(self, file: IO[bytes]):
        self._file = file
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._chunks = _ChunkIndexes()
        self._metadata: list[MetadataIndex] = []
        self._packers = ThreadPoolExecutor(_THREADS)
        self._writer = ThreadPoolExecutor(1)
        self._waiting: deque[Future[object]] = deque()
        file.write(MAGIC)
        self._record(Header(profile="", library=_LIBRARY))

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self._later(self._named, Metadata(name=name, metadata=values))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Write a schema; its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._later(self._record, self._schemas[-1])
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Write a channel; its number."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata=metadata
        )
        self._channels.append(channel)
        self._later(self._record, channel)
        return number

    def messages(self, batch: Batch, numbers: Mapping[int, int]) -> None:
        """Write messages by log time, in chunks of about a megabyte, once those before them are written."""
        self._settle()
        self._later(self._messages, batch, numbers)

    def flush(self) -> None:
        """Write what still waits."""
        self._settle()
        self._file.flush()

    def close(self) -> None:
        """Leave off; what still waits is not written."""
        for threads in (self._writer, self._packers):
            threads.shutdown(cancel_futures=True)

    def finish(self) -> None:
        """Write the index; the file stays open."""
        self._settle()
        self._record(DataEnd(data_section_crc=0))
        start = self._file.tell()
        builder = RecordBuilder()
        offsets = []
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks.count,
            message_count=sum(self._counts.values()),
            message_start_time=self._chunks.first_ns or 0,
            message_end_time=self._chunks.last_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[Any]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, [self._chunks] if self._chunks.count else []),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        for opcode, records in groups:
            begin = builder.count
            for record in records:
                record.write(builder)
            if records:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode, group_start=start + begin, group_length=builder.count - begin
                    )
                )
        offset_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        summary = builder.end()
        crc = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start), zlib.crc32(summary))
        self._file.write(summary)
        self._record(Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc))
        self._file.write(MAGIC)

    def _messages(self, batch: Batch, numbers: Mapping[int, int]) -> None:
        channel, log_ns, sizes, records = batch.sorted(numbers)
        ends = np.cumsum(sizes)
        start, chunks = 0, []
        while start < len(ends):
            before = int(ends[start - 1]) if start else 0
            stop = max(int(np.searchsorted(ends, before + _CHUNK_BYTES, "right")), start + 1)
            packing = self._packers.submit(_pack, records[before : int(ends[stop - 1])])
            chunks.append((packing, slice(start, stop), before))
            start = stop
        for packing, part, before in chunks:
            self._chunk(packing.result(), channel[part], log_ns[part], ends[part] - sizes[part] - before)

    def _chunk(self, packed: _Packed, channel: IntArray, log_ns: IntArray, offsets: IntArray) -> None:
        first, last = int(log_ns.min()), int(log_ns.max())
        at, length = self._file.tell(), len(packed.data)
        name = _COMPRESSION.encode()
        head = CHUNK.pack(first, last, packed.size, packed.crc, len(name)) + name + struct.pack("<Q", length)
        self._file.write(HEAD.pack(Opcode.CHUNK, len(head) + length) + head)
        self._file.write(packed.data)
        index_at = self._file.tell()
        index = self._index(channel, log_ns, offsets)
        places = itertools.accumulate(map(len, index.values()), initial=index_at)
        self._file.write(b"".join(index.values()))
        self._chunks.add(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=at,
                chunk_length=index_at - at,
                message_index_offsets=dict(zip(index, places, strict=False)),
                message_index_length=self._file.tell() - index_at,
                compression=_COMPRESSION,
                compressed_size=length,
                uncompressed_size=packed.size,
            )
        )

    def _index(self, channel: IntArray, log_ns: IntArray, offsets: IntArray) -> dict[int, bytes]:
        """Records, by channel, of where in a chunk its messages lie."""
        order = np.argsort(channel.astype(np.uint16), kind="stable")
        rows = np.stack([log_ns[order], offsets[order]], axis=1).astype("<u8").tobytes()
        counts = np.bincount(channel)
        index, start = {}, 0
        for number in np.flatnonzero(counts).tolist():
            entries = rows[16 * start : 16 * (start + int(counts[number]))]
            start += int(counts[number])
            head = HEAD.pack(Opcode.MESSAGE_INDEX, INDEX.size + len(entries))
            index[number] = head + INDEX.pack(number, len(entries)) + entries
            self._counts[number] = self._counts.get(number, 0) + int(counts[number])
        return index

    def _named(self, metadata: Metadata) -> None:
        offset = self._file.tell()
        length = self._record(metadata)
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=metadata.name))

    def _later(self, job: Callable[..., object], *values: object) -> None:
        """Write something after all that came before it."""
        self._waiting.append(self._writer.submit(job, *values))

    def _settle(self) -> None:
        """Wait until all is written."""
        while self._waiting:
            self._waiting.popleft().result()

    def _record(self, record: Any) -> int:
        builder = RecordBuilder()
        record.write(builder)
        return self._file.write(builder.end())


class _ChunkIndexes:
    """Where all chunks lie, as records for the file's end: 0.1 kB a chunk, so that a session may last a
    day.
    """

    def __init__(self) -> None:
        self.count, self.last_ns = 0, 0
        self.first_ns: int | None = None
        self._records = RecordBuilder()

    def add(self, index: ChunkIndex) -> None:
        """One chunk more."""
        index.write(self._records)
        self.count += 1
        first_ns = index.message_start_time
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = max(self.last_ns, index.message_end_time)

    def write(self, builder: RecordBuilder) -> None:
        """All records, once."""
        builder.write(self._records.end())


class _Packed(NamedTuple):
    """A chunk as it is written, and the size and checksum of what is in it."""

    data: bytes
    size: int
    crc: int


def _pack(data: memoryview) -> _Packed:
    # a compressor belongs to one thread
    packed = zstandard.ZstdCompressor(level=_LEVEL).compress(data)
    return _Packed(packed, len(data), zlib.crc32(data))
