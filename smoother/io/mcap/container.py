"""An MCAP file read front to back in flat memory.

Records are the mcap package's; the messages of a chunk stay columns (0.05 s where the package takes 0.75 s).
Messages are read in file order, so that a truncated file gives all that it still has. Behind a damage reading
resumes at the next records that make sense; what was lost is counted. The summary at the file's end serves
for channels whose own records are lost, and shows how many messages are missing.
"""

from __future__ import annotations

import os
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..wire.layout import Buffer, cut_out, joined
from .messages import (
    ChunkMessages,
    Loss,
    McapMessage,
    Topic,
    TopicMessages,
    damage_note,
    listed,
    plain_name,
    sentences,
)
from .records import (
    BROKEN,
    CHUNK,
    CUT,
    DAMAGED,
    HEAD,
    INDEX,
    MAGIC,
    Summary,
    TopRecord,
    read_summary,
    top_records,
)

#: A message record up to its payload.
MESSAGE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)
#: Log times beyond this, ns, do not fit what times are counted in.
_LATEST = np.uint64(np.iinfo(np.int64).max - 1)
#: Messages outside chunks are gathered to chunks of this size.
_GATHER = 1 << 20
#: All metadata records together have no more bytes than this.
_METADATA_LIMIT = 1 << 26
#: What data of the compressions that are read begin with; a chunk is unpacked a part at a time, and no
#: further than this. Recorders make chunks of 1 to 64 MB.
_COMPRESSIONS = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
_PART, CHUNK_LIMIT = 1 << 18, 1 << 28


class _Block(NamedTuple):
    """Schema, channel and message records one behind the other."""

    data: bytes
    place: int  # bytes: where in the file it is
    is_checked: bool  # Its checksum is right


class _Messages(NamedTuple):
    """The messages of a block, as columns (n,)."""

    data: bytes
    heads: NDArray  # What they begin with, `MESSAGE`
    start: IntArray  # Where in `data` each payload begins and ends
    stop: IntArray
    number: IntArray  # Position of each one's topic


class Container:
    """A file to be read once, front to back."""

    def __init__(
        self,
        path: str | os.PathLike[str],
        unverified: bool = False,
        described: Mapping[int, Topic] | None = None,
    ):
        self.path = Path(path)
        self.topics: list[Topic] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.notes: list[str] = []
        self.losses: list[Loss] = []
        self.missing: dict[str, int] = {}  # by topic, where the file's own count says so
        self.attachments = 0  # met so far; they are not read
        self.undescribed = 0  # messages dropped for want of their channel's record
        self.described: dict[int, Topic] = {}  # channels met so far, by their numbers
        self._elsewhere = dict(described or {})
        self._unverified = unverified
        self._schemas: dict[int, Schema] = {}
        self._number = np.full(1 << 16, -1, np.int64)  # position in `topics` by channel
        self._read = np.zeros(1 << 16, np.int64)  # messages by position in `topics`
        self._summary = Summary()
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._open: list[Loss] = []  # which ended at a time that is not known yet
        self._is_cut = False
        self._metadata_bytes = 0

    # -- messages -------------------------------------------------------------------------------------------

    def by_topic(self, wanted: Callable[[Topic], bool]) -> Iterator[dict[int, TopicMessages]]:
        """Yield the messages of wanted topics a chunk at a time, by position of the topic in `topics`."""
        for data, heads, start, stop, number in self._messages():
            by_topic: dict[int, TopicMessages] = {}
            for position in dict.fromkeys(number.tolist()):
                mine = np.flatnonzero(number == position)
                topic, log_ns = self.topics[position], heads["log"][mine]
                topic.note(log_ns)
                if wanted(topic):
                    by_topic[position] = TopicMessages(log_ns.view(np.int64), data, start[mine], stop[mine])
            if by_topic:
                yield by_topic

    def batches(self, wanted: Callable[[Topic], bool]) -> Iterator[dict[int, list[McapMessage]]]:
        """The same with an object for each message: for topics whose messages are few, or large."""
        for chunk in self.by_topic(wanted):
            yield {
                position: [
                    McapMessage(self.topics[position], log_ns, memoryview(rows.chunk)[start:stop])
                    for log_ns, start, stop in zip(
                        rows.log_ns.tolist(), rows.start.tolist(), rows.stop.tolist(), strict=True
                    )
                ]
                for position, rows in chunk.items()
            }

    def messages(self) -> Iterator[McapMessage]:
        """Yield all messages in the file's order."""
        for chunk in self.chunks(lambda topic: True):
            for number, log_ns, data in zip(
                chunk.topic.tolist(), chunk.log_ns.tolist(), chunk.data, strict=True
            ):
                yield McapMessage(chunk.topics[number], log_ns, memoryview(data))

    def chunks(self, wanted: Callable[[Topic], bool]) -> Iterator[ChunkMessages]:
        """Yield the messages of wanted topics a chunk at a time, in the file's order."""
        for data, heads, start, stop, number in self._messages():
            positions = [position for position in set(number.tolist()) if wanted(self.topics[position])]
            mine = np.isin(number, positions)
            payloads: Buffer = data
            if not mine.all():
                heads, number = heads[mine], number[mine]
                payloads, start, stop = joined(data, start[mine], stop[mine])  # the others need not be kept
            if len(heads):
                sequence, log_ns, publish_ns = (
                    heads[n].astype(np.int64) for n in ("sequence", "log", "publish")
                )
                columns = (number, sequence, log_ns, publish_ns)
                yield ChunkMessages(self.topics, *columns, payloads, start, stop)

    def _messages(self) -> Iterator[_Messages]:
        for block in self._blocks():
            place, definitions, end = _walked(block.data)
            for opcode, content in definitions:
                self._define(opcode, content, block.is_checked)
            if end < len(block.data) and not self._is_cut:
                lost = f"the last {len(block.data) - end} bytes of the chunk at byte {block.place}"
                self._lost(Loss(f"{lost} are damaged and were passed over", block.place, block.place))
            heads = cut_out(block.data, place, MESSAGE.itemsize).reshape(-1).view(MESSAGE)
            late = heads["log"] > _LATEST
            if late.any():
                heads["log"][late] = _LATEST
                what = f"{int(late.sum())} messages have log times after the year 2262, the latest possible"
                self._lost(Loss(what, block.place, block.place))
            for channel in np.unique(heads["channel"][self._number[heads["channel"]] < 0]).tolist():
                self._describe_lost(channel)
            number = self._number[heads["channel"]]
            known = number >= 0
            if not known.all():
                times = heads["log"][~known]
                self.undescribed += len(times)
                what = f"{len(times)} messages of channels that no record before them describes were dropped"
                self._lost(Loss(what, block.place, block.place, int(times.min()), int(times.max())))
                heads, place, number = heads[known], place[known], number[known]
            if len(heads):
                self._met(heads["log"])
                self._read += np.bincount(number, minlength=len(self._read))
            stop = place + HEAD.size + heads["length"].astype(np.int64)
            yield _Messages(block.data, heads, place + MESSAGE.itemsize, stop, number)

    # -- channels -------------------------------------------------------------------------------------------

    def _define(self, opcode: int, content: bytes, is_checked: bool, is_known: bool = True) -> None:
        """Take in a schema or channel; of two descriptions that with a checksum counts, else the first."""
        stream = ReadDataStream(BytesIO(content))
        summary = self._summary
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                twin = summary.schemas.get(schema.id, schema)
                is_wrong = twin.name != schema.name and summary.is_checked and not is_checked
                self._schemas[schema.id] = twin if is_wrong else schema
                return
            channel = Channel.read(stream)
        except BROKEN:
            self._note("a schema or channel record is damaged")
            return
        stated = summary.channels.get(channel.id, channel)
        if stated.topic != channel.topic:
            self._note(f"channel {channel.id} is described in two ways")
            channel = stated if summary.is_checked and not is_checked else channel
        if not is_known:
            self._elsewhere.setdefault(channel.id, self._topic(channel))
        elif self._number[channel.id] < 0:
            self._enter(channel.id, self._topic(channel))

    def _describe_lost(self, channel: int) -> None:
        """A channel whose own record is lost or comes late, as the file's end describes it."""
        stated = self._summary.channels.get(channel)
        topic = self._elsewhere.get(channel) or (None if stated is None else self._topic(stated))
        if topic is not None:
            self._enter(channel, topic)
            self._note(f"the record of channel {topic.label} is missing and was taken from elsewhere")

    def _topic(self, channel: Channel) -> Topic:
        its = self._schemas.get(channel.schema_id) or self._summary.schemas.get(channel.schema_id)
        schema = (its.name, its.encoding, its.data) if its else ("", "", b"")
        return Topic(channel.topic, *schema, channel.message_encoding, dict(channel.metadata))

    def _enter(self, channel: int, topic: Topic) -> None:
        # Recorders that split or restart make a second channel of the same topic.
        keys = [(known.name, known.schema, known.encoding) for known in self.topics]
        key = (topic.name, topic.schema, topic.encoding)
        self.described[channel] = topic
        self._number[channel] = keys.index(key) if key in keys else len(keys)
        if key not in keys:
            self.topics.append(
                Topic(*key[:2], topic.schema_encoding, topic.schema_data, key[2], topic.metadata)
            )

    def _name_of(self, channel: int) -> str:
        """Topic of a channel, as far as it is known."""
        named = self.described.get(channel) or self._elsewhere.get(channel)
        stated = self._summary.channels.get(channel)
        return named.name if named else stated.topic if stated else f"channel {channel}"

    # -- records --------------------------------------------------------------------------------------------

    def _blocks(self) -> Iterator[_Block]:
        check_input(self.path, RecordingError)
        try:
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                magic = file.read(len(MAGIC))
                self._summary = read_summary(file, size)
                self._check_magic(magic)
                if self._summary.chunks:
                    self._first_ns = min(chunk.message_start_time for chunk in self._summary.chunks)
                yield from self._read_blocks(file, size)
        except OSError as error:
            raise RecordingError(_unreadable(self.path, error)) from error
        for clause in sentences(self.losses, self._first_ns):
            self._note(clause)
        self._compare_counts()
        if self._summary.is_damaged:
            self._note("the index at its end is damaged, so it is not known how many messages it had")
        if self._is_cut:
            self._note("the file ends in the middle of the recording; everything before the cut was read")

    def _read_blocks(self, file: IO[bytes], size: int) -> Iterator[_Block]:
        loose = bytearray()  # messages outside chunks
        place = 0
        left_out: Loss | None = None  # a chunk whose index records follow
        for record in top_records(file, size):
            opcode, start, length, is_mended = record
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                place = place if loose else start - HEAD.size
                loose += _at(file, start - HEAD.size, HEAD.size + length)
                if len(loose) < _GATHER:
                    continue
            if loose:
                yield _Block(bytes(loose), place, False)
                loose.clear()
            if opcode == Opcode.MESSAGE_INDEX:
                if left_out is not None:
                    channel, entries = INDEX.unpack(_at(file, start, INDEX.size))
                    name = self._name_of(channel)
                    left_out.counts[name] = left_out.counts.get(name, 0) + entries // 16
                continue
            left_out = None
            if opcode == Opcode.ATTACHMENT:
                self.attachments += 1
            elif opcode == Opcode.METADATA:
                self._take_metadata(_at(file, start, length))
            elif opcode == DAMAGED:
                what = f"the {length} bytes from byte {start} on are damaged and were left out"
                self._lost(self._timed(Loss(what, start, start + length)))
            elif opcode == CUT and not length:
                self._is_cut = True
            elif opcode in (Opcode.CHUNK, CUT):
                self._is_cut |= opcode == CUT
                if is_mended:
                    self._note(f"the head of the chunk at byte {start} is damaged; the chunk was read")
                found = self._unpacked(_at(file, start, length), record)
                if isinstance(found, Loss):
                    left_out = found
                    self._lost(self._timed(found))
                else:
                    yield found
        if loose:
            yield _Block(bytes(loose), place, False)

    def _unpacked(self, content: bytes, record: TopRecord) -> _Block | Loss:
        """A chunk's records, of a cut chunk those before the place; what was lost of one left out."""
        place = record.start
        at = (
            CHUNK.size + CHUNK.unpack_from(content)[4] + 8 if len(content) >= CHUNK.size else len(content) + 1
        )
        if len(content) < at:  # cut off before its records
            return _Block(b"", place, False)
        first, last, stated, crc, letters = CHUNK.unpack_from(content)
        packed = memoryview(content)[at:]
        name = content[CHUNK.size : CHUNK.size + letters].decode("latin-1")
        loss = Loss(
            f"the chunk at byte {place} is damaged and was left out", place, place + len(content), first, last
        )
        if name not in ("", *_COMPRESSIONS.values()):
            damaged, name = name, _COMPRESSIONS.get(bytes(packed[:4]), "?")
            if name == "?" and not self._read.any():
                raise RecordingError(
                    f"{self.path} is compressed with {plain_name(damaged)}; rewrite it with `mcap compress`."
                )
        if stated > CHUNK_LIMIT or name == "?":
            if stated > CHUNK_LIMIT:
                loss.what = f"the chunk at byte {place} states {stated} bytes, too many, and was left out"
            return loss
        data = _unpack(name, packed, stated)
        is_whole = len(data) == stated and crc in (0, zlib.crc32(data))
        if is_whole or record.opcode == CUT:
            return _Block(data, place, is_whole and bool(crc))
        if len(data) < stated:
            loss.what = f"the chunk at byte {place} is damaged; {len(data)} of its {stated} bytes were read"
            self._lost(loss)
            return _Block(data, place, False)
        loss.what = f"the chunk at byte {place} fails its checksum and was left out"
        if not self._unverified:
            for opcode, definition in _walked(data)[1]:  # for want of better ones
                self._define(opcode, definition, False, is_known=False)
            return loss
        loss.what, loss.is_kept = (
            f"the chunk at byte {place} fails its checksum; its messages are not verified",
            True,
        )
        self._lost(loss)
        return _Block(data, place, False)

    def _take_metadata(self, content: bytes) -> None:
        self._metadata_bytes += len(content)
        if self._metadata_bytes > _METADATA_LIMIT:
            self._note("its metadata records are too long and were left out")
            return
        try:
            record = Metadata.read(ReadDataStream(BytesIO(content)))
        except BROKEN:
            self._note("a metadata record is damaged")
            return
        self.metadata[record.name] = dict(record.metadata)

    def _check_magic(self, magic: bytes) -> None:
        if not magic:
            raise RecordingError(f"{self.path} is empty (0 bytes); record or copy it again.")
        if magic == MAGIC:
            return
        alike = sum(a == b for a, b in zip(magic, MAGIC, strict=False))
        if not self._summary.is_there and alike < len(MAGIC) - 2:
            raise RecordingError(
                f"{self.path} is not an MCAP file; convert a ROS bag with `mcap convert`, and the files of"
                " devices with `unocclude import files`."
            )
        self._note("the first bytes are damaged")

    # -- damage ---------------------------------------------------------------------------------------------

    def _note(self, what: str) -> None:
        """Say what was wrong, once."""
        note = damage_note(self.path.name, f"{what}.")
        if note not in self.notes:
            self.notes.append(note)

    def _lost(self, loss: Loss) -> None:
        """Take down a loss; if its time is unknown, it is between the messages around it."""
        if loss.first_ns is None and self._last_ns is not None:
            loss.first_ns = self._last_ns
            self._open.append(loss)
        self.losses.append(loss)

    def _timed(self, loss: Loss) -> Loss:
        """With the times of the chunks that were there, by the file's own index."""
        indexes = self._summary.chunks
        lost = [each for each in indexes if loss.start - HEAD.size <= each.chunk_start_offset < loss.stop]
        if lost:
            loss.first_ns = min(each.message_start_time for each in lost)
            loss.last_ns = max(each.message_end_time for each in lost)
        return loss

    def _met(self, log_ns: NDArray[np.uint64]) -> None:
        """Messages (n,), at least one: what was lost before is between the ones before and these."""
        first, last = int(log_ns.min()), int(log_ns.max())
        for loss in self._open:
            loss.last_ns = max(first, loss.first_ns or 0)
        self._open.clear()
        self._first_ns = first if self._first_ns is None else self._first_ns
        self._last_ns = last if self._last_ns is None else max(self._last_ns, last)

    def _compare_counts(self) -> None:
        """Compare what was read with the file's own count."""
        stated, read = Counter[str](), Counter[str]()
        for channel, count in self._summary.counts.items():
            stated[self._name_of(channel)] += count
        for topic, count in zip(self.topics, self._read.tolist(), strict=False):
            read[topic.name] += count
        self.missing = {name: count - read[name] for name, count in stated.items() if count > read[name]}
        more = {name: count - stated[name] for name, count in read.items() if 0 < stated[name] < count}
        if more:
            self._note(f"there are more messages than the file's own count says: {listed(more)}")
        if self.missing:
            self._note(f"by the file's own count messages are missing: {listed(self.missing, stated)}")


def _walked(data: bytes) -> tuple[IntArray, list[tuple[int, bytes]], int]:
    """Where a chunk's messages begin, its schemas and channels in order, and where what makes sense ends."""
    places: list[int] = []
    definitions: list[tuple[int, bytes]] = []
    head, message, place, last = HEAD.unpack_from, int(Opcode.MESSAGE), 0, len(data) - HEAD.size
    shortest = MESSAGE.itemsize - HEAD.size
    while place <= last:
        opcode, length = head(data, place)
        end = place + HEAD.size + length
        if end > len(data) or not opcode:
            break
        if opcode == message and length >= shortest:
            places.append(place)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append((opcode, data[place + HEAD.size : end]))
        place = end
    return np.array(places, np.int64), definitions, place


def _unpack(compression: str, packed: memoryview, size: int) -> bytes:
    """A chunk's records; of a damaged chunk those before the damage, never more than `size` bytes."""
    if not compression:
        return bytes(packed[:size])
    import zstandard
    from lz4.frame import LZ4FrameFile  # type: ignore[import-untyped]

    out = bytearray()
    try:
        zstd = zstandard.ZstdDecompressor()
        if compression == "zstd" and zstandard.get_frame_parameters(packed).content_size == size:
            return zstd.decompress(packed)  # twice as fast
    except (zstandard.ZstdError, MemoryError):
        pass
    source = zstd.stream_reader(packed) if compression == "zstd" else LZ4FrameFile(BytesIO(packed))
    try:
        while len(out) < size and (more := source.read(min(_PART, size - len(out)))):
            out += more
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        pass
    return bytes(out)


def _at(file: IO[bytes], place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(size)


def _unreadable(path: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{path} does not exist; check the name."
    if isinstance(error, IsADirectoryError) or path.is_dir():
        return f"{path} is a folder; name an MCAP file, or import plain files with `unocclude import csv`."
    return f"{path} cannot be read: {error.strerror or error}."
