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
    if not summary.is_there or not len(MAGIC) <= start < stop or stop - start > _LONGEST:
        return summary
    file.seek(start)
    content = file.read(stop - start)
    summary.is_sound = _take(summary, content)
    if crc:
        summary.is_checked = zlib.crc32(end[: _FOOTER.size - 4], zlib.crc32(content)) == crc
        summary.is_sound &= summary.is_checked
    summary.chunks.sort(key=lambda index: index.chunk_start_offset)
    return summary


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
