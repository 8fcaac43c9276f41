"""An MCAP file written a chunk at a time.

The mcap package packs each message in Python, which would take longer than solving the motion.
Here numpy packs the heads of a whole batch; all other records are the package's.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from typing import IO, Any

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
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

from ..recording import IntArray

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK_BYTES = 1 << 20
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)
_LIBRARY = "unocclude"


class ChunkedFile:
    """Writes an MCAP file: chunks of messages, and the index that players look for at its end.

    Parameters
    ----------
    file : opened for writing in binary.
    """

    def __init__(self, file: IO[bytes]):
        self._file = file
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._compressor = zstandard.ZstdCompressor()
        file.write(_MAGIC)
        self._record(Header(profile="", library=_LIBRARY))

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        offset = self._file.tell()
        length = self._record(Metadata(name=name, metadata=values))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Write a schema; its number."""
        self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._record(self._schemas[-1])
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Write a channel; its number."""
        number = len(self._channels) + 1
        channel = Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata=metadata
        )
        self._channels.append(channel)
        self._record(channel)
        return number

    def messages(
        self,
        channel: IntArray,
        sequence: IntArray,
        log_ns: IntArray,
        publish_ns: IntArray,
        payloads: Sequence[bytes],
    ) -> None:
        """Write messages in the order given, in chunks of about a megabyte."""
        count = len(payloads)
        if not count:
            return
        sizes = np.fromiter(map(len, payloads), np.int64, count)
        heads = np.empty(count, _HEAD)
        heads["opcode"] = Opcode.MESSAGE
        heads["length"] = sizes + _HEAD.itemsize - 9
        heads["channel"], heads["sequence"] = channel, sequence
        heads["log"], heads["publish"] = log_ns, publish_ns
        raw, step = heads.tobytes(), _HEAD.itemsize
        ends = np.cumsum(sizes + step)
        start = 0
        while start < count:
            before = ends[start - 1] if start else 0
            stop = max(int(np.searchsorted(ends, before + _CHUNK_BYTES, "right")), start + 1)
            pieces: list[bytes] = [b""] * (2 * (stop - start))
            pieces[0::2] = [raw[at : at + step] for at in range(start * step, stop * step, step)]
            pieces[1::2] = payloads[start:stop]
            offsets = ends[start:stop] - sizes[start:stop] - step - before
            self._chunk(b"".join(pieces), channel[start:stop], log_ns[start:stop], offsets)
            start = stop

    def finish(self) -> None:
        """Write the index; the file stays open."""
        self._record(DataEnd(data_section_crc=0))
        start = self._file.tell()
        builder = RecordBuilder()
        offsets = []
        log = [(index.message_start_time, index.message_end_time) for index in self._chunks]
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_start_time=min((first for first, _ in log), default=0),
            message_end_time=max((last for _, last in log), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Sequence[Any]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
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
        self._file.write(_MAGIC)

    def _chunk(self, data: bytes, channel: IntArray, log_ns: IntArray, offsets: IntArray) -> None:
        packed = self._compressor.compress(data)
        first, last = int(log_ns.min()), int(log_ns.max())
        chunk = Chunk(
            compression="zstd",
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        at = self._file.tell()
        length = self._record(chunk)
        index_at = self._file.tell()
        index_offsets = {}
        for number in np.unique(channel).tolist():
            mine = channel == number
            entries = np.column_stack([log_ns[mine], offsets[mine]]).astype("<u8").tobytes()
            index_offsets[number] = self._file.tell()
            self._file.write(
                struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), number, len(entries))
            )
            self._file.write(entries)
            self._counts[number] = self._counts.get(number, 0) + int(mine.sum())
        self._chunks.append(
            ChunkIndex(
                message_start_time=first,
                message_end_time=last,
                chunk_start_offset=at,
                chunk_length=length,
                message_index_offsets=index_offsets,
                message_index_length=self._file.tell() - index_at,
                compression="zstd",
                compressed_size=len(packed),
                uncompressed_size=len(data),
            )
        )

    def _record(self, record: Any) -> int:
        builder = RecordBuilder()
        record.write(builder)
        return self._file.write(builder.end())
