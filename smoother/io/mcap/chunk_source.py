"""Chunks, schemas and channels of an MCAP file; what is damaged, repeated or too large is counted."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import IO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from .messages import DamageLog, Loss, Topic, plain_name
from .records import BROKEN, CHUNK, HEAD, INDEX, Summary, find
from .top_level import (
    COMPRESSIONS,
    CUT,
    DAMAGED,
    LIMIT_NAME,
    TopRecord,
    chunk_limit,
    is_unknown,
    top_records,
    unpack,
    whole_limit,
)


class Definitions:
    """The channels of a file."""

    def __init__(
        self,
        log: DamageLog,
        schemas: dict[int, Schema] | None = None,
        channels: dict[int, Channel] | None = None,
    ):
        self.topics: list[Topic] = []
        self.number = np.full(1 << 16, -1, np.int64)
        self.summary = Summary()
        self._log = log
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._others = dict(schemas or {}), dict(channels or {})

    def define(self, opcode: int, content: bytes, is_checked: bool) -> int | None:
        """Take in a schema or a channel; the number of a channel that is new."""
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                its = self.summary.schemas.get(schema.id)
                if its is not None and its.name != schema.name and self.summary.is_checked and not is_checked:
                    schema = its
                self.schemas[schema.id] = schema
                return None
            channel = Channel.read(stream)
        except BROKEN:
            self._log.note("a schema or channel record is damaged")
            return None
        twin = self.summary.channels.get(channel.id)
        if twin is not None and twin.topic != channel.topic and self.summary.is_sound:
            self._log.note(f"channel {channel.id} is described in two ways")
            if self.summary.is_checked and not is_checked:
                channel = twin
        if self.number[channel.id] >= 0:
            return None
        self._take(channel, self.schemas)
        return int(channel.id)

    def define_lost(self, numbers: NDArray[np.uint16]) -> None:
        """Channels whose own records are lost or come late, as the file's end describes them."""
        others = [self._others, (self.summary.schemas, self.summary.channels)]
        for number in numbers.tolist():
            for schemas, channels in others:
                if self.number[number] < 0 and number in channels:
                    self._take(channels[number], {**schemas, **self.schemas})
                    name = plain_name(channels[number].topic)
                    self._log.note(f"the record of channel {name} is missing and was taken from elsewhere")

    def is_described(self, channel: int) -> bool:
        """Whether a channel is described elsewhere than in the chunk at hand."""
        is_there = channel in self._others[1] or channel in self.summary.channels
        if is_there:
            self._log.note(f"messages of {plain_name(self.name_of(channel))} come before its record")
        return is_there

    def take_unverified(self, data: bytes) -> None:
        """Schemas and channels of a chunk that fails its checksum, for want of better ones."""
        schemas, channels = self._others
        for definition in find(data, [], True).definitions:
            stream = ReadDataStream(BytesIO(data[definition.start : definition.stop]))
            try:
                if definition.opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream)
                    schemas.setdefault(schema.id, self.summary.schemas.get(schema.id) or schema)
                else:
                    channel = Channel.read(stream)
                    channels.setdefault(channel.id, self.summary.channels.get(channel.id) or channel)
            except BROKEN:
                continue

    def name_of(self, channel: int) -> str:
        """Topic of a channel, as far as it is known."""
        position = int(self.number[channel])
        if position >= 0:
            return self.topics[position].name
        for _, channels in (self._others, (self.summary.schemas, self.summary.channels)):
            if channel in channels:
                return channels[channel].topic
        return f"channel {channel}"

    def _take(self, channel: Channel, schemas: dict[int, Schema]) -> None:
        self.channels[channel.id] = channel
        its = schemas.get(channel.schema_id) or self.summary.schemas.get(channel.schema_id)
        name, encoding, data = (its.name, its.encoding, its.data) if its else ("", "", b"")
        topic = Topic(channel.topic, name, encoding, data, channel.message_encoding, dict(channel.metadata))
        # Recorders that split or restart make a second channel of the same topic.
        for position, known in enumerate(self.topics):
            if (known.name, known.schema, known.encoding) == (topic.name, topic.schema, topic.encoding):
                self.number[channel.id] = position
                break
        else:
            self.number[channel.id] = len(self.topics)
            self.topics.append(topic)


#: Messages outside chunks are gathered to chunks of this size.
_GATHER = 1 << 20
#: All metadata records together have no more bytes than this.
_METADATA_LIMIT = 1 << 26


class ChunkSource:
    """Reads the chunks of one file."""

    def __init__(self, path: Path, log: DamageLog, definitions: Definitions, unverified: bool):
        self.metadata: dict[str, dict[str, str]] = {}
        self.place = 0
        self.attachments = 0
        self.is_checked = False
        self._path = path
        self._log = log
        self._definitions = definitions
        self._unverified = unverified
        self._summary = Summary()
        self._unpacked = 0
        self._metadata_bytes = 0
        self._offsets: dict[tuple[int, int, int, int], int] = {}

    def chunks(self, file: IO[bytes], size: int) -> Iterator[tuple[bytes, list[bytes]]]:
        """Yield chunks of schema, channel and message records, each with the index records behind it."""
        self._summary = self._definitions.summary
        if self._summary.is_sound and self._summary.chunks:
            self._log.first_ns = min(chunk.message_start_time for chunk in self._summary.chunks)
        yield from self._records(file, size)

    def _records(self, file: IO[bytes], size: int) -> Iterator[tuple[bytes, list[bytes]]]:
        gathered = bytearray()
        last_start = 0  # of the last record in `gathered`
        waiting: list[bytes] = []  # a chunk whose index records are being read
        index: list[bytes] = []
        with open(self._path, "rb") as walked:  # a handle of its own: its buffer stays where it reads heads
            for record in top_records(walked, size):
                opcode, start, length, why = record
                if opcode == Opcode.MESSAGE_INDEX and waiting:
                    file.seek(start)
                    index.append(file.read(length))
                    continue
                if waiting:
                    yield waiting.pop(), index
                    index = []
                    if self._log.is_cut:
                        return
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    break
                if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                    if not gathered:
                        self.place = start - HEAD.size
                    last_start = len(gathered)
                    file.seek(start - HEAD.size)
                    gathered += file.read(HEAD.size + length)
                    if len(gathered) > _GATHER:
                        held = bytes(gathered[last_start:])  # may yet turn out to be damaged
                        self.is_checked = False
                        if last_start:
                            yield bytes(gathered[:last_start]), []
                            gathered, last_start, self.place = bytearray(held), 0, start - HEAD.size
                    continue
                if gathered:
                    if opcode == DAMAGED and start <= self.place + last_start:
                        del gathered[last_start:]
                    self.is_checked = False
                    yield bytes(gathered), []
                    gathered, last_start = bytearray(), 0
                if opcode == Opcode.ATTACHMENT:
                    self.attachments += 1
                elif opcode == Opcode.METADATA:
                    self._metadata(file, start, length)
                elif opcode == Opcode.CHUNK:
                    waiting += self._chunk(file, record, size)
                elif opcode in (DAMAGED, CUT):
                    self._note_damage(opcode, start, length)
                if why:
                    self._log.note(f"{why} of the chunk at byte {start} is damaged; the chunk was read")
        if waiting:
            yield waiting.pop(), index
        if gathered:
            self.is_checked = False
            yield bytes(gathered), []

    def _note_damage(self, opcode: int, start: int, length: int) -> None:
        if opcode == CUT:
            self._log.is_cut = True
            return
        lost = [c for c in self._summary.chunks if start <= c.chunk_start_offset < start + length]
        loss = Loss(
            f"the {length} bytes from byte {start} on are damaged and were left out", start, start + length
        )
        if lost:
            loss.first_ns = min(chunk.message_start_time for chunk in lost)
            loss.last_ns = max(chunk.message_end_time for chunk in lost)
        self._log.lost(loss)

    def _chunk(self, file: IO[bytes], record: TopRecord, size: int) -> list[bytes]:
        """A chunk's records, of a cut or damaged chunk those before the place; nothing of one left out."""
        file.seek(record.start)
        there = min(record.length, size - record.start)
        self.place = offset = record.start
        self._log.is_cut |= there < record.length
        if there > 2 * chunk_limit():
            return self._left_out(file, record, f"the chunk at byte {offset} is too large and was left out")
        content = memoryview(file.read(there))
        first, last, stated, crc, letters = (
            CHUNK.unpack_from(content) if len(content) >= CHUNK.size else (0, 0, 0, 0, 0)
        )
        start = CHUNK.size + letters
        if len(content) < start + 8:  # cut off before its records, maybe within the name of its compression
            if not self._log.is_cut:
                what = f"the chunk at byte {offset} is damaged and was left out"
                return self._left_out(file, record, what)
            return [b""]
        if self._is_twin(file, (first, last, crc, len(content)), offset, content):
            what = f"the chunk at byte {offset} is there twice and was read once"
            self._log.note(what)
            return []
        packed = content[start + 8 :]
        if stated > chunk_limit() or self._unpacked + stated > whole_limit(size):
            what = (
                f"the chunk at byte {offset} states {stated} bytes, which exceeds a container; it was left"
                f" out (the variable {LIMIT_NAME} sets the limit in MB)"
            )
            return self._left_out(file, record, what, (first, last))
        compression = bytes(content[CHUNK.size : start]).decode("latin-1")
        if is_unknown(compression, packed) and self._knows_others():
            what = f"the chunk at byte {offset} has a damaged head and was left out"
            return self._left_out(file, record, what, (first, last))
        data = unpack(compression, packed, stated, self._path)
        self._unpacked += len(data)
        self.is_checked = bool(crc) and len(data) == stated and zlib.crc32(data) == crc
        if self.is_checked or self._log.is_cut or (len(data) == stated and not crc):
            return [data]
        if crc:  # the stated size itself may be wrong
            more = unpack(compression, packed, chunk_limit(), self._path)
            if zlib.crc32(more) == crc:
                self._log.note(f"the chunk at byte {offset} states a wrong size and is damaged; it was read")
                self.is_checked = True
                return [more]
        if len(data) < stated:
            what = f"the chunk at byte {offset} is damaged; {len(data)} of its {stated} bytes were read"
            self._log.lost(Loss(what, offset, offset + there, first, last))
            return [data]
        what = f"the chunk at byte {offset} fails its checksum and was left out"
        if self._unverified:
            what = f"the chunk at byte {offset} fails its checksum; its messages are not verified"
        self._left_out(file, record, what, (first, last))
        self._definitions.take_unverified(data)
        if not self._unverified:
            return []
        self._log.losses[-1].is_kept = True
        return [data]

    def _knows_others(self) -> bool:
        """Whether other chunks of the file are of a compression that is read."""
        return self._unpacked > 0 or any(c.compression in COMPRESSIONS for c in self._summary.chunks)

    def _left_out(
        self, file: IO[bytes], record: TopRecord, what: str, times: tuple[int, int] | None = None
    ) -> list[bytes]:
        """Take down a chunk that was left out, with its contents by the index records."""
        counts: dict[str, int] = {}
        stop = min(record.start + record.length, file.seek(0, SEEK_END))  # a damaged length exceeds the file
        position = stop
        while True:
            file.seek(position)
            head = file.read(HEAD.size + INDEX.size)
            if len(head) < HEAD.size + INDEX.size or head[0] != Opcode.MESSAGE_INDEX:
                break
            channel, entries = INDEX.unpack_from(head, HEAD.size)
            name = self._definitions.name_of(channel)
            counts[name] = counts.get(name, 0) + entries // 16
            position += HEAD.size + INDEX.size + entries
        indexed = [c for c in self._summary.chunks if c.chunk_start_offset == record.start - HEAD.size]
        if indexed and self._summary.is_sound:
            times = indexed[0].message_start_time, indexed[0].message_end_time
        first, last = times or (None, None)
        self._log.lost(Loss(what, record.start, stop, first, last, counts))
        return []

    def _is_twin(
        self, file: IO[bytes], key: tuple[int, int, int, int], offset: int, content: memoryview
    ) -> bool:
        """Whether this very chunk has come before."""
        earlier = self._offsets.setdefault(key, offset)
        if earlier == offset:
            return False
        file.seek(earlier)
        return file.read(len(content)) == content

    def _metadata(self, file: IO[bytes], start: int, length: int) -> None:
        self._metadata_bytes += length
        if self._metadata_bytes > _METADATA_LIMIT:
            self._log.note("its metadata records are too long and were left out")
            return
        file.seek(start)
        try:
            record = Metadata.read(ReadDataStream(BytesIO(file.read(length))))
        except BROKEN:
            self._log.note("a metadata record is damaged")
            return
        self.metadata[record.name] = dict(record.metadata)
