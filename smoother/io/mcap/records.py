"""Records of an MCAP file one after the other, behind a damage the next that make sense, and its summary."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

#: An MCAP file begins and ends with these bytes.
MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length that every record begins with.
HEAD = struct.Struct("<BQ")
#: What a chunk begins with, up to the name of its compression: first and last log time, size and checksum of
#: its records, letters of the name. Behind the name stand the compressed size (u64) and the records.
CHUNK = struct.Struct("<QQQII")
#: A chunk's index of a channel up to its entries: the channel, and the bytes of the entries.
INDEX = struct.Struct("<HI")
_FOOTER = struct.Struct("<BQQQI")
#: A name of a compression is no longer than this.
_LETTERS = 16
#: Least length of a record by its opcode (others: 4), and opcodes whose records have no other length.
_LEAST = {Opcode.FOOTER: 20, Opcode.SCHEMA: 14, Opcode.CHANNEL: 16, Opcode.MESSAGE: 22, Opcode.CHUNK: 40}
_EXACT = (Opcode.FOOTER, Opcode.DATA_END)
#: Opcodes from here on are a program's own.
_PRIVATE = 128
#: Where a record may begin: an opcode, and a length below 2^40. So many in a row are no coincidence, and
#: so many that only look like it end a search, which takes so many bytes at a time.
_MAY_BEGIN, _IN_A_ROW, _MOST_TRIED, _AT_A_TIME = (
    re.compile(rb"[\x01-\x0f](?=.{5}\0{3})", re.S),
    3,
    100_000,
    1 << 22,
)
#: A summary has no more bytes than this; chunk indexes take about a hundred bytes a megabyte.
_LONGEST_SUMMARY = 1 << 25
#: What reading a damaged record raises.
BROKEN = (McapError, struct.error, UnicodeDecodeError, ValueError, OverflowError, MemoryError, EOFError)


class TopRecord(NamedTuple):
    """A record, or a part of the file that contains none."""

    opcode: (
        int  # `DAMAGED` for a part that makes no sense, `CUT` where the file ends in the middle of a record
    )
    start: int  # bytes: where its content begins; of what is damaged, where that itself does
    length: int  # bytes: of its content as far as the file has it
    is_mended: bool = False  # Its opcode or length is damaged, and what is inside shows what it is


DAMAGED, CUT = -1, -2


def top_records(file: IO[bytes], size: int) -> Iterator[TopRecord]:
    """Yield the records up to the end of the data section, and what is damaged between them."""
    place = len(MAGIC)
    while True:
        record = _whole_record(file, place, size)
        if record is not None:
            yield record
            if record.opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            place = record.start + record.length
            continue
        resume = None if place + HEAD.size > size else _next_record(file, place + 1, size)
        if resume is None:
            opcode, _ = _head(file, place)
            content = min(place + HEAD.size, size)
            yield TopRecord(CUT, content, size - content if opcode == Opcode.CHUNK else 0)
            return
        yield TopRecord(DAMAGED, place, resume - place)
        place = resume


def _head(file: IO[bytes], place: int) -> tuple[int, int]:
    """Opcode and length of a record; zeros beyond the end."""
    file.seek(place)
    head = file.read(HEAD.size)
    return HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)


def _whole_record(file: IO[bytes], place: int, size: int) -> TopRecord | None:
    """The record here, if a whole one is, as far as opcode, length and lengths inside tell."""
    opcode, length = _head(file, place)
    content = place + HEAD.size
    is_known = 0 < opcode < Opcode.DATA_END + 1 and length >= _LEAST.get(Opcode(opcode), 4)
    is_known &= opcode not in _EXACT or length == _LEAST.get(Opcode(opcode), 4)
    if is_known and opcode != Opcode.CHUNK:
        return TopRecord(opcode, content, length) if content + length <= size else None
    inner = _chunk_length(file, content)
    if inner is not None and content + inner <= size:
        is_followed = opcode == Opcode.CHUNK and _whole_record(file, content + inner, size) is not None
        if inner == length or is_followed:
            return TopRecord(Opcode.CHUNK, content, inner, inner != length or opcode != Opcode.CHUNK)
    if opcode >= _PRIVATE and content + length <= size:
        return TopRecord(opcode, content, length)
    return None


def _chunk_length(file: IO[bytes], content: int) -> int | None:
    """The length that the sizes inside a chunk add up to; None for what is not a chunk."""
    file.seek(content)
    head = file.read(CHUNK.size + _LETTERS + 8)
    letters = CHUNK.unpack_from(head)[4] if len(head) >= CHUNK.size else _LETTERS + 1
    start = CHUNK.size + letters
    if letters > _LETTERS or len(head) < start + 8 or not head[CHUNK.size : start].isalnum() | (letters == 0):
        return None
    return start + 8 + int.from_bytes(head[start : start + 8], "little")


def _next_record(file: IO[bytes], place: int, size: int) -> int | None:
    """Where the next records that make sense begin: several in a row, or up to the file's end."""
    tried = 0
    while place < size:
        file.seek(place)
        block = file.read(_AT_A_TIME)
        for found in _MAY_BEGIN.finditer(block):
            tried += 1
            if _begin(file, place + found.start(), size):
                return place + found.start()
            if tried > _MOST_TRIED:
                return None
        place += max(len(block) - HEAD.size + 1, 1)
    return None


def _begin(file: IO[bytes], place: int, size: int) -> bool:
    for _ in range(_IN_A_ROW):
        record = _whole_record(file, place, size)
        if record is None:
            return False
        place = record.start + record.length
        if record.opcode in (Opcode.CHUNK, Opcode.FOOTER) or place == size:
            return True
    return True


@dataclass
class Summary:
    """Records of the summary; empty where there is none that can be read."""

    schemas: dict[int, Schema] = field(default_factory=dict)  # By their numbers
    channels: dict[int, Channel] = field(default_factory=dict)  # By their numbers
    chunks: list[ChunkIndex] = field(default_factory=list)  # In the file's order
    counts: dict[int, int] = field(default_factory=dict)  # Messages by channel
    is_there: bool = False  # The file ends as a whole file does
    is_damaged: bool = False  # It is there and cannot be read
    is_checked: bool = False  # Its checksum is right


def read_summary(file: IO[bytes], size: int) -> Summary:
    """Read what is at a file's end; nothing is raised where it is damaged or missing."""
    tail = _FOOTER.size + len(MAGIC)
    if size < tail + len(MAGIC):
        return Summary()
    file.seek(size - tail)
    end = file.read(tail)
    opcode, length, start, _, crc = _FOOTER.unpack_from(end)
    is_there = end[-len(MAGIC) :] == MAGIC or (opcode == Opcode.FOOTER and length == 20)
    stop = size - tail
    if not is_there or not start:
        return Summary(is_there=is_there)
    content = b""
    if len(MAGIC) <= start < stop and stop - start <= _LONGEST_SUMMARY:
        file.seek(start)
        content = file.read(stop - start)
    is_checked = bool(crc) and zlib.crc32(end[: _FOOTER.size - 4], zlib.crc32(content)) == crc
    if not content or (crc and not is_checked):
        return Summary(is_there=True, is_damaged=True)
    summary = Summary(is_there=True, is_checked=is_checked)
    place = 0
    try:
        while place < len(content):
            opcode, length = HEAD.unpack_from(content, place)
            stream = ReadDataStream(BytesIO(content[place + HEAD.size : place + HEAD.size + length]))
            place += HEAD.size + length
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
        return Summary(is_there=True, is_damaged=True)
    return summary
