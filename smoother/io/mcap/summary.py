"""What an MCAP file says of itself at its end: channels, where chunks lie, how many messages there are."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from .records import HEAD, MAGIC

_FOOTER = struct.Struct("<BQQQI")
#: A summary holds no more bytes than this; chunk indexes take about a hundred bytes a megabyte.
_LONGEST = 1 << 25
#: What the record begins with that stands before a summary; it is looked for in the last bytes of a file.
_DATA_END, _NEAR = HEAD.pack(Opcode.DATA_END, 4), 1 << 22
#: What reading a damaged record raises.
BROKEN = (McapError, struct.error, UnicodeDecodeError, ValueError, OverflowError, MemoryError, EOFError)


@dataclass
class Summary:
    """Records of the summary; empty where there is none that can be read.

    Attributes
    ----------
    schemas, channels : dict
        By their numbers.
    chunks : list of ChunkIndex
        In the file's order.
    counts : dict of int to int
        Messages by channel; empty where the file does not count them.
    is_sound : bool
        It is whole, and its checksum is right or was not written.
    is_checked : bool
        Its checksum is right.
    is_there : bool
        The file ends as a whole file does.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    is_sound: bool = False
    is_checked: bool = False
    is_there: bool = False


def read_summary(file: IO[bytes], size: int) -> Summary:
    """Read what stands at a file's end; nothing is raised where it is damaged or missing.

    Parameters
    ----------
    file : IO[bytes]
        Opened for reading in binary.
    size : int, bytes
        Of the file.
    """
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
