"""An MCAP file read front to back in flat memory.

Records are the mcap package's; the messages of a chunk stay columns (0.05 s where the package takes 0.75 s).
A damaged chunk is left out and its times are noted, and so is every chunk that the index at the file's end
lists and that was not met. What lies behind broken framing is for `mcap recover`.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader

from ...array_types import IntArray
from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..wire.layout import cut_out
from .messages import Damage, McapMessage, Messages, Topic, damage_note, listed, plain_name, sentences

#: An MCAP file begins and ends with these bytes.
MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length that every record begins with.
HEAD = struct.Struct("<BQ")
#: What a chunk begins with, up to the name of its compression: first and last log time, size and checksum of
#: its records, letters of the name. Behind the name stand the compressed size (u64) and the records.
CHUNK = struct.Struct("<QQQII")
#: A message record up to its payload.
MESSAGE = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log", "publish"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
    }
)
_FOOTER = struct.Struct("<BQQQI")
#: Records of the data section; opcodes from `_PRIVATE` on are a program's own.
_RECORDS = {
    *(Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX),
    *(Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END),
}
_PRIVATE = 128
#: Log times beyond this, ns, do not fit what times are counted in.
_LATEST = np.uint64(np.iinfo(np.int64).max - 1)
#: Messages outside chunks are gathered to chunks of this size; recorders make chunks of 1 to 64 MB.
_GATHER, CHUNK_LIMIT = 1 << 20, 1 << 28
#: What reading a damaged record raises.
_BROKEN = (McapError, struct.error, ValueError, OverflowError, MemoryError, EOFError)
#: First and last log time, ns; None where it is not known.
_Times = tuple[int | None, int | None]
_UNKNOWN: _Times = (None, None)
#: Records of a file's end by their kind.
Summary = defaultdict[type, list[Any]]
#: Records of a chunk, where it is, and its times.
_Block = tuple[bytes, int, _Times]


class Container:
    """A file to be read once, front to back."""

    def __init__(self, path: str | os.PathLike[str], unverified: bool = False):
        self.path, self._unverified = Path(path), unverified
        self.topics: list[Topic] = []
        self.metadata: dict[str, dict[str, str]] = {}
        # Content of the record by the attachment's name: first byte, length, and where in it its data begin
        self.attachments: dict[str, tuple[int, int, int]] = {}
        self.notes: list[str] = []
        self.damage: list[Damage] = []
        self.missing: dict[str, int] = {}  # by topic, where the file's own count says so
        self._summary = Summary(list)  # empty where it cannot be read
        self._channels: dict[int, Channel] = {}  # as the summary has them
        self._is_whole = False  # it ends as a whole file does
        self._schemas: dict[int, Schema] = {}
        self._number = np.full(1 << 16, -1, np.int64)  # position in `topics` by channel
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._unknown = ""  # A compression that is not read

    # -- messages -------------------------------------------------------------------------------------------

    def messages(self, wanted: Callable[[Topic], bool]) -> Iterator[McapMessage]:
        """Yield messages one by one, in the file's order: for topics whose messages are few, or large."""
        for chunk in self.chunks():
            numbers = [each for each in np.unique(chunk.topic).tolist() if wanted(self.topics[each])]
            rows, data = chunk.select(np.flatnonzero(np.isin(chunk.topic, numbers))), memoryview(chunk.chunk)
            columns = (rows.topic.tolist(), rows.log_ns.tolist(), rows.start.tolist(), rows.stop.tolist())
            for position, log_ns, start, stop in zip(*columns, strict=True):
                yield McapMessage(self.topics[position], log_ns, bytes(data[start:stop]))

    def skimmed(self) -> Container:
        """With its metadata and attachments; chunks are not unpacked."""
        for _ in self._blocks(unpack=False):
            pass
        return self

    def attachment(self, name: str) -> memoryview:
        """The data of an attachment, mapped into the memory; ValueError where they are damaged."""
        start, length, data = self.attachments[name]
        content = np.memmap(self.path, np.uint8, "r", start, (length,)).data
        if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
            raise ValueError(f"the attachment {name} fails its checksum")
        return content[data:-4]

    def chunks(self) -> Iterator[Messages]:
        """Yield all messages a chunk at a time, in the file's order."""
        for data, place, times in self._blocks():
            at, definitions, end = _walked(data)
            for opcode, content in definitions:
                self._define(opcode, content)
            if end < len(data):
                lost = f"the last {len(data) - end} bytes of the chunk at byte {place}"
                self._lost(f"{lost} are damaged and were passed over", place, place, times)
            heads = cut_out(data, at, MESSAGE.itemsize).reshape(-1).view(MESSAGE)
            if (late := heads["log"] > _LATEST).any():
                heads["log"][late] = _LATEST
                what = f"{int(late.sum())} messages have log times after the year 2262, the latest possible"
                self._lost(what, place, place)
            for channel in np.unique(heads["channel"][self._number[heads["channel"]] < 0]).tolist():
                if (stated := self._channels.get(channel)) is not None:
                    self._enter(stated)
                    name = plain_name(stated.topic)
                    self._note(f"the record of channel {name} is missing before its messages")
            number = self._number[heads["channel"]]
            sequence, log, publish = (heads[name].astype(np.int64) for name in ("sequence", "log", "publish"))
            stop = at + HEAD.size + heads["length"].astype(np.int64)
            chunk = Messages(number, sequence, log, publish, data, at + MESSAGE.itemsize, stop)
            if (dropped := number < 0).any():
                log_ns = chunk.log_ns[dropped]
                what = f"{len(log_ns)} messages of channels that no record describes were dropped"
                self._lost(what, place, place, (int(log_ns.min()), int(log_ns.max())))
                chunk = chunk.select(np.flatnonzero(~dropped))
            if len(chunk.topic):
                first, last = int(chunk.log_ns.min()), int(chunk.log_ns.max())
                self._first_ns = first if self._first_ns is None else self._first_ns
                self._last_ns = last if self._last_ns is None else max(self._last_ns, last)
                for position in np.unique(chunk.topic).tolist():
                    self.topics[position].note(chunk.log_ns[chunk.topic == position])
            yield chunk

    # -- channels -------------------------------------------------------------------------------------------

    def _define(self, opcode: int, content: bytes) -> None:
        """Take in a schema or channel; the summary's own description counts."""
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas.setdefault(schema.id, schema)
            else:
                channel = Channel.read(stream)
                self._enter(self._channels.get(channel.id, channel))
        except _BROKEN:
            self._note("a schema or channel record is damaged")

    def _enter(self, channel: Channel) -> None:
        """A channel; recorders that split or restart make a second one of the same topic."""
        if self._number[channel.id] >= 0:
            return
        its = self._schemas.get(channel.schema_id)
        schema = (its.name, its.encoding, its.data) if its else ("", "", b"")
        topic = Topic(channel.topic, *schema, channel.message_encoding, dict(channel.metadata))
        keys = [(known.name, known.schema, known.encoding) for known in self.topics]
        key = (topic.name, topic.schema, topic.encoding)
        self._number[channel.id] = keys.index(key) if key in keys else len(keys)
        if key not in keys:
            self.topics.append(topic)

    # -- records --------------------------------------------------------------------------------------------

    def _blocks(self, unpack: bool = True) -> Iterator[_Block]:
        """Schema, channel and message records, a chunk at a time."""
        check_input(self.path, RecordingError)
        try:
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                magic = file.read(len(MAGIC))
                summary, self._is_whole = _summary_of(file, size)
                self._summary = Summary(list) if summary is None else summary
                self._schemas = {each.id: each for each in self._summary[Schema]}
                self._channels = {each.id: each for each in self._summary[Channel]}
                self._check_magic(magic)
                starts = [chunk.message_start_time for chunk in self._summary[ChunkIndex]]
                self._first_ns = min(starts, default=None)
                yield from self._read_blocks(file, size, unpack)
        except OSError as error:
            raise RecordingError(_unreadable(self.path, error)) from error
        for clause in sentences(self.damage, self._first_ns):
            self._note(clause)
        if self._unknown and not any(topic.count for topic in self.topics):
            name = plain_name(self._unknown)
            raise RecordingError(f"{self.path} is compressed with {name}; rewrite it with `mcap compress`.")
        if unpack:
            self._compare_counts()
        if self._is_whole and summary is None:
            self._note("the index at its end is damaged, so it is not known how many messages it had")

    def _read_blocks(self, file: IO[bytes], size: int, unpack: bool) -> Iterator[_Block]:
        loose = bytearray()  # messages outside chunks
        for opcode, start, length in self._records(file, size):
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                loose += _at(file, start - HEAD.size, HEAD.size + length) if unpack else b""
                if len(loose) < _GATHER:
                    continue
            if loose:
                yield bytes(loose), start, _UNKNOWN
                loose.clear()
            if opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                try:
                    self._take(opcode, file, start, length)
                except _BROKEN:
                    self._note(f"the record at byte {start}, metadata or an attachment, is damaged")
            elif opcode == Opcode.CHUNK and unpack:
                data, times = self._unpacked(_at(file, start, length), start)
                if data is not None:
                    yield data, start, times
                else:
                    what = f"the chunk at byte {start} is damaged and was left out"
                    self._lost(what, start, start + length, times)
        if loose:
            yield bytes(loose), size, _UNKNOWN

    def _records(self, file: IO[bytes], size: int) -> Iterator[tuple[int, int, int]]:
        """Opcode, first byte and length of the content of each record up to the end of the data section."""
        place, opcode, met = len(MAGIC), 0, set[int]()
        while opcode != Opcode.DATA_END:
            head = _at(file, place, HEAD.size + 16)  # a chunk begins with its first and last log time
            opcode, length = HEAD.unpack_from(head) if len(head) >= HEAD.size else (0, 0)
            start = place + HEAD.size
            if (opcode not in _RECORDS and opcode < _PRIVATE) or start + length > size:
                break
            yield opcode, start, length
            met |= {place} if opcode == Opcode.CHUNK else set()
            place = start + length
        lost = [each for each in self._summary[ChunkIndex] if each.chunk_start_offset not in met]
        if opcode == Opcode.DATA_END:
            for each in lost:
                at, own = each.chunk_start_offset, (each.message_start_time, each.message_end_time)
                what = f"the chunk that the index lists at byte {at} is not there and was left out"
                self._lost(what, at, at + each.chunk_length, own)
        elif place < size:
            times: _Times = self._last_ns, None
            if lost:
                times = min(e.message_start_time for e in lost), max(e.message_end_time for e in lost)
            elif opcode == Opcode.CHUNK and len(head) == HEAD.size + 16:
                times = struct.unpack_from("<QQ", head, HEAD.size)
            what = f"the {size - place} bytes from byte {place} on are damaged or cut and were left out"
            self._lost(f"{what}; `mcap recover` may find more in them", place, size, times)
        if opcode != Opcode.DATA_END and not self._is_whole:
            self._note("the file ends in the middle of the recording; everything before the cut was read")

    def _take(self, opcode: int, file: IO[bytes], start: int, length: int) -> None:
        """Metadata, or where the data of an attachment are."""
        if opcode == Opcode.METADATA:
            record = Metadata.read(ReadDataStream(BytesIO(_at(file, start, length))))
            self.metadata[record.name] = dict(record.metadata)
            return
        file.seek(start + 16)  # behind two times
        stream = ReadDataStream(file)
        name, _, size = stream.read_prefixed_string(), stream.read_prefixed_string(), stream.read8()
        data = file.tell() - start
        if data + size + 4 != length:
            raise ValueError("its sizes contradict each other")
        self.attachments[name] = (start, length, data)

    def _unpacked(self, content: bytes, place: int) -> tuple[bytes | None, _Times]:
        """A chunk's records, None where it is damaged; its first and last log time."""
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        except _BROKEN:
            return None, _UNKNOWN
        times, size, data = (chunk.message_start_time, chunk.message_end_time), chunk.uncompressed_size, None
        if chunk.compression not in ("", "zstd", "lz4"):
            self._unknown = chunk.compression
        elif size <= CHUNK_LIMIT:
            data = _unpack(chunk.compression, chunk.data, size)
        if data is None or len(data) != size:
            return None, times
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            if not self._unverified:
                return None, times
            what = f"the chunk at byte {place} fails its checksum; its messages are not verified"
            self._lost(what, place, place + len(content), times)
        return data, times

    def _check_magic(self, magic: bytes) -> None:
        if not magic:
            raise RecordingError(f"{self.path} is empty (0 bytes); record or copy it again.")
        if magic == MAGIC:
            return
        if not self._is_whole:
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

    def _lost(self, what: str, start: int, stop: int, times: _Times = _UNKNOWN) -> None:
        """Take down a damage; if its time is unknown, it is behind the messages before."""
        first_ns, last_ns = times
        first_ns = self._last_ns if first_ns is None else first_ns
        self.damage.append(Damage(what, start, stop, first_ns, last_ns))

    def _compare_counts(self) -> None:
        """Compare what was read with the file's own count."""
        stated, read = Counter[str](), Counter[str]()
        for statistics in self._summary[Statistics]:
            for number, count in statistics.channel_message_counts.items():
                channel = self._channels.get(number)
                stated[f"channel {number}" if channel is None else channel.topic] += count
        for topic in self.topics:
            read[topic.name] += topic.count
        self.missing = {name: count - read[name] for name, count in stated.items() if count > read[name]}
        more = {name: count - stated[name] for name, count in read.items() if 0 < stated[name] < count}
        if more:
            self._note(f"there are more messages than the file's own count says: {listed(more)}")
        if self.missing:
            self._note(f"by the file's own count messages are missing: {listed(self.missing, stated)}")


def _summary_of(file: IO[bytes], size: int) -> tuple[Summary | None, bool]:
    """What is at a file's end, None where it is damaged, and whether the file ends as a whole one does."""
    tail = _FOOTER.size + len(MAGIC)
    end = _at(file, size - tail, tail) if size >= tail + len(MAGIC) else b""
    if end[-len(MAGIC) :] != MAGIC:
        return Summary(list), False
    opcode, length, start, _, crc = _FOOTER.unpack_from(end)
    if not start:
        return Summary(list), True
    content = _at(file, start, size - tail - start) if len(MAGIC) <= start < size - tail else b""
    is_checked = not crc or zlib.crc32(end[: _FOOTER.size - 4], zlib.crc32(content)) == crc
    if opcode != Opcode.FOOTER or length != 20 or not content or not is_checked:
        return None, True
    summary = Summary(list)
    try:
        for record in StreamReader(BytesIO(content + end), skip_magic=True).records:
            summary[type(record)].append(record)
    except _BROKEN:
        return None, True
    return summary, True


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


def _unpack(compression: str, packed: bytes, size: int) -> bytes | None:
    """A chunk's records, never more than `size` bytes; None where they cannot be unpacked."""
    if not compression:
        return packed
    import zstandard
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    try:
        if compression == "lz4":
            return bytes(LZ4FrameDecompressor().decompress(packed, max_length=size))
        if zstandard.frame_content_size(packed) > size:
            return None
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        return None


def _at(file: IO[bytes], place: int, size: int) -> bytes:
    file.seek(place)
    return file.read(size)


def _unreadable(path: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{path} does not exist; check the name."
    if isinstance(error, IsADirectoryError) or path.is_dir():
        return f"{path} is a folder; name an MCAP file, or import plain files with `unocclude import csv`."
    return f"{path} cannot be read: {error.strerror or error}."
