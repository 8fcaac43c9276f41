"""The records of an MCAP file, where those of a chunk are, and the summary at the file's end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics
from numpy.typing import NDArray

from ...array_types import IntArray
from ..wire.layout import cut_out

#: An MCAP file begins and ends with these bytes.
MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length that every record begins with.
HEAD = struct.Struct("<BQ")
#: What a chunk begins with, up to the name of its compression: first and last log time, size and checksum of
#: its records, letters of the name. Behind the name stand the compressed size (u64) and the records.
CHUNK = struct.Struct("<QQQII")
#: A chunk's index of a channel up to its entries: the channel, and the bytes of the entries.
INDEX = struct.Struct("<HI")
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
#: Length that a message without payload states.
_SHORTEST = MESSAGE.itemsize - HEAD.size
#: More gaps than this between the messages of an index are not looked into one by one.
_MOST_GAPS = 64
#: A chunk with more records of kinds that do not belong into one is damaged.
_MOST_FOREIGN = 100_000
#: Least length of the records that belong into a chunk.
_LEAST_INSIDE = {Opcode.SCHEMA: 14, Opcode.CHANNEL: 16, Opcode.MESSAGE: _SHORTEST}
#: A damaged chunk is searched by this many bytes at a time.
_AT_A_TIME = 1 << 20


class Definition(NamedTuple):
    """A schema or channel record: its opcode, and where it begins and ends."""

    opcode: int
    start: int
    stop: int


class RecordPlaces(NamedTuple):
    """What a chunk contains."""

    place: IntArray  # int (n,): Where message records begin
    heads: NDArray  # (n,): what they begin with, `MESSAGE`
    definitions: list[Definition]  # Schemas and channels, in order
    is_cut: bool  # The last record goes beyond the end
    damaged: int = 0  # bytes: that make no sense and were passed over


def find(chunk: bytes, index: Sequence[bytes], is_whole: bool = False) -> RecordPlaces:
    """All messages, schemas and channels of a chunk."""
    return _indexed(chunk, index) or _walked(chunk, 0, len(chunk), is_whole)


def _indexed(chunk: bytes, index: Sequence[bytes]) -> RecordPlaces | None:
    """The same by the index; None unless each record begins where the one before ends."""
    try:
        entries = [np.frombuffer(content, "<u8", offset=INDEX.size) for content in index]
        place = np.sort(np.concatenate([each.reshape(-1, 2)[:, 1] for each in entries]))
    except ValueError:  # no index, or not of whole entries
        return None
    if not len(place) or place[-1] > len(chunk) - MESSAGE.itemsize:
        return None
    place = place.astype(np.int64)
    heads = _heads(chunk, place)
    length = heads["length"]
    if (heads["opcode"] != Opcode.MESSAGE).any() or (length < _SHORTEST).any() or (length > len(chunk)).any():
        return None
    starts = np.append(place, len(chunk))
    stops = np.concatenate([np.zeros(1, np.int64), place + HEAD.size + length.astype(np.int64)])
    gaps = np.flatnonzero(starts != stops)
    if len(gaps) > _MOST_GAPS or (stops > starts).any():
        return None
    definitions: list[Definition] = []
    for gap in gaps.tolist():
        between = _walked(chunk, int(stops[gap]), int(starts[gap]))
        if between.is_cut or len(between.place):
            return None
        definitions += between.definitions
    return RecordPlaces(place, heads, definitions, False)


def _walked(chunk: bytes, start: int, stop: int, is_whole: bool = False) -> RecordPlaces:
    places: list[int] = []
    definitions: list[Definition] = []
    is_cut, position, damaged, foreign = False, start, 0, 0
    head, message, last, add = HEAD.unpack_from, int(Opcode.MESSAGE), stop - HEAD.size, places.append
    while position <= last:
        opcode, length = head(chunk, position)
        end = position + HEAD.size + length
        if end > stop and not is_whole:
            is_cut = True
            break
        if end > stop or not opcode:
            resume = _resume(chunk, position + 1, stop)
            damaged += resume - position
            position = resume
            continue
        if opcode == message and length >= _SHORTEST:
            add(position)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(Definition(opcode, position + HEAD.size, end))
        else:
            foreign += 1
            if foreign > _MOST_FOREIGN:
                damaged += stop - position
                break
        position = end
    place = np.array(places, np.int64)
    return RecordPlaces(place, _heads(chunk, place), definitions, is_cut, damaged)


def _resume(chunk: bytes, start: int, stop: int) -> int:
    """Where the next records that make sense begin: several in a row, or one that ends the chunk."""
    block, tried = np.frombuffer(chunk, np.uint8), 0
    for first in range(start, stop, _AT_A_TIME):
        part = block[first : min(first + _AT_A_TIME + HEAD.size, stop)]
        for place in candidates(part, Opcode.CHUNK).tolist():
            if _make_sense(chunk, first + place, stop):
                return first + place
            tried += 1
            if tried > _MOST_FOREIGN:
                return stop
    return stop


def _make_sense(chunk: bytes, position: int, stop: int) -> bool:
    """Whether three records of a chunk begin here, or fewer that reach its end."""
    for _ in range(3):
        if position + HEAD.size > stop:
            return position == stop
        opcode, length = HEAD.unpack_from(chunk, position)
        least = _LEAST_INSIDE.get(opcode)
        if least is None or length < least or position + HEAD.size + length > stop:
            return False
        position += HEAD.size + length
    return True


def candidates(block: NDArray[np.uint8], kinds: int) -> IntArray:
    """Places (n,) in bytes where a record of the first kinds may begin: opcodes below, lengths below 2^40."""
    if len(block) < HEAD.size:
        return np.empty(0, np.int64)
    last = len(block) - HEAD.size + 1
    opcode = block[:last]
    may = (opcode > 0) & (opcode < kinds)
    for place in (6, 7, 8):
        may &= block[place : place + last] == 0
    return np.flatnonzero(may)


def _heads(chunk: bytes, place: IntArray) -> NDArray:
    return cut_out(chunk, place, MESSAGE.itemsize).reshape(-1).view(MESSAGE)


_FOOTER = struct.Struct("<BQQQI")
#: A summary has no more bytes than this; chunk indexes take about a hundred bytes a megabyte.
_LONGEST = 1 << 25
#: The beginning of the record that precedes a summary; it is looked for in the last bytes of a file.
_DATA_END, _NEAR = HEAD.pack(Opcode.DATA_END, 4), 1 << 22
#: What reading a damaged record raises.
BROKEN = (McapError, struct.error, UnicodeDecodeError, ValueError, OverflowError, MemoryError, EOFError)


@dataclass
class Summary:
    """Records of the summary; empty where there is none that can be read."""

    schemas: dict[int, Schema] = field(default_factory=dict)  # By their numbers
    channels: dict[int, Channel] = field(default_factory=dict)  # By their numbers
    chunks: list[ChunkIndex] = field(default_factory=list)  # In the file's order
    counts: dict[int, int] = field(default_factory=dict)  # Messages by channel
    is_sound: bool = False  # It is whole, and its checksum is right or was not written
    is_checked: bool = False  # Its checksum is right
    is_there: bool = False  # The file ends as a whole file does


def read_summary(file: IO[bytes], size: int) -> Summary:
    """Read what is at a file's end; nothing is raised where it is damaged or missing."""
    summary = Summary()
    tail = _FOOTER.size + len(MAGIC)
    if size < tail + len(MAGIC):
        return summary
    file.seek(size - tail)
    end = file.read(tail)
    opcode, length, start, _, crc = _FOOTER.unpack_from(end)
    summary.is_there = end[-len(MAGIC) :] == MAGIC or (opcode == Opcode.FOOTER and length == 20)
    stop = size - tail
    if not summary.is_there:
        return summary
    content, is_checked = b"", False
    for number in range(2):
        if is_checked or (number and not crc):
            break
        place = _behind_data(file, stop) if number else start  # bytes put in or taken out move it
        if not len(MAGIC) <= place < stop or stop - place > _LONGEST:
            continue
        file.seek(place)
        candidate = file.read(stop - place)
        is_checked = bool(crc) and zlib.crc32(end[: _FOOTER.size - 4], zlib.crc32(candidate)) == crc
        content = candidate if is_checked or not content else content
    if not content:
        return summary
    summary.is_checked = is_checked
    summary.is_sound = _take(summary, content) and (is_checked or not crc)
    summary.chunks.sort(key=lambda index: index.chunk_start_offset)
    return summary


def _behind_data(file: IO[bytes], stop: int) -> int:
    """Where the last record that ends the data ends; 0 where there is none near the file's end."""
    first = max(stop - _NEAR, 0)
    file.seek(first)
    place = file.read(stop - first).rfind(_DATA_END)
    return first + place + len(_DATA_END) + 4 if place >= 0 else 0


def _take(summary: Summary, content: bytes) -> bool:
    """Take in the records of a summary as far as they make sense; whether all of them do."""
    position, is_sound = 0, True
    while position + HEAD.size <= len(content):
        opcode, length = HEAD.unpack_from(content, position)
        position += HEAD.size
        if not opcode or position + length > len(content):
            return False
        stream = ReadDataStream(BytesIO(content[position : position + length]))
        position += length
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                summary.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                summary.channels[channel.id] = channel
            elif opcode == Opcode.CHUNK_INDEX:
                summary.chunks.append(ChunkIndex.read(stream))
            elif opcode == Opcode.STATISTICS:
                summary.counts = dict(Statistics.read(stream).channel_message_counts)
        except BROKEN:
            is_sound = False
    return is_sound and position == len(content)
