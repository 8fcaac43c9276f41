"""The records of an MCAP file one after the other; behind a damage the next ones that make sense."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from .records import CHUNK, HEAD, MAGIC, MESSAGE, candidates

#: Least length of a record by its opcode.
_LEAST = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: MESSAGE.itemsize - HEAD.size,
    Opcode.CHUNK: CHUNK.size + 8,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
#: Records that have this length and no other.
_EXACT = (Opcode.FOOTER, Opcode.SUMMARY_OFFSET, Opcode.DATA_END)
#: Records of other kinds begin here; those from `_PRIVATE` on are a program's own, none is between.
_KINDS, _PRIVATE = 16, 128
#: So many records in a row that make sense are no accident.
_IN_A_ROW = 3
#: The file is searched by so many bytes at a time.
_AT_A_TIME = 1 << 22
#: After so many places that only look like a record, and so many damages, the rest is given up.
_MOST_TRIED, _MOST_DAMAGES = 100_000, 10_000
#: A name of a compression is no longer than this.
_LETTERS = 16


class TopRecord(NamedTuple):
    """A record, or a part of the file that holds none.

    Attributes
    ----------
    opcode : int
        `DAMAGED` for a part that makes no sense, `CUT` where the file ends in the middle of a record.
    start : int, bytes
        Where its content begins; of what is damaged, where that itself does.
    length : int, bytes
        Of its content; what the record states, where it is cut.
    why : str
        What was wrong with a record that could be read all the same.
    """

    opcode: int
    start: int
    length: int
    why: str = ""


DAMAGED, CUT = -1, -2


def top_records(file: IO[bytes], size: int) -> Iterator[TopRecord]:
    """Yield the records up to the end of the data section, and what is damaged between them.

    A record whose length turns out to be wrong is taken back: the damage that follows begins before it.

    Parameters
    ----------
    file : IO[bytes]
        Opened for reading in binary; may be read from between two records.
    size : int, bytes
        Of the file.

    Yields
    ------
    TopRecord
        In the file's order.
    """
    position, before, damages = len(MAGIC), -1, 0
    while True:
        opcode, length = _head(file, position)
        content = position + HEAD.size
        if _makes_sense(file, position, size):
            yield TopRecord(opcode, content, length)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            before = position if opcode not in (Opcode.CHUNK, Opcode.MESSAGE_INDEX) else -1
            position = content + length
            continue
        if position + HEAD.size > size:  # whole records up to the end, and no footer
            yield TopRecord(CUT, position, size - position)
            return
        record = _mended(file, position, size)
        if record is not None:
            yield record
            if record.opcode == Opcode.CHUNK and record.start + record.length > size:
                return
            before, position = -1, record.start + record.length
            continue
        begin, damages = (position if before < 0 else before), damages + 1
        resume = _next_record(file, begin + 1, size) if damages < _MOST_DAMAGES else None
        if resume is None:
            yield TopRecord(opcode if opcode == Opcode.CHUNK else CUT, content, length)
            return
        looks_like_a_head = 0 < opcode < _KINDS or length < 1 << 32
        if resume > position and looks_like_a_head:  # else the record before was too short
            begin = position
        yield TopRecord(DAMAGED, begin, resume - begin)
        before, position = -1, resume


def _mended(file: IO[bytes], position: int, size: int) -> TopRecord | None:
    """A record whose opcode or length is damaged while the rest of it tells what it is, else None."""
    opcode, length = _head(file, position)
    content = position + HEAD.size
    stop = content + length
    inner = _chunk_length(file, content)
    if inner is not None:
        if inner == length:  # the sizes inside agree with the record's
            is_cut = opcode == Opcode.CHUNK and stop > size
            return TopRecord(Opcode.CHUNK, content, length, "" if is_cut else "the opcode")
        for whole in (length, inner):
            if opcode == Opcode.CHUNK and content + whole <= size and _begins(file, content + whole, size):
                return TopRecord(Opcode.CHUNK, content, whole, "a length")
    if stop <= size and length > 0 and _begins(file, stop, size):
        return TopRecord(DAMAGED, position, HEAD.size + length)
    return None


def _begins(file: IO[bytes], position: int, size: int) -> bool:
    """Whether records that make sense begin here, up to the end of the file or several in a row."""
    for _ in range(_IN_A_ROW):
        if not _makes_sense(file, position, size):
            return False
        opcode, length = _head(file, position)
        position += HEAD.size + length
        if opcode in (Opcode.CHUNK, Opcode.FOOTER) or position == size:
            return True
    return True


def _makes_sense(file: IO[bytes], position: int, size: int) -> bool:
    """Whether a whole record lies here, as far as its opcode, its length and lengths inside tell."""
    opcode, length = _head(file, position)
    content = position + HEAD.size
    if not opcode or content + length > size:
        return False
    if opcode >= _KINDS:
        return opcode >= _PRIVATE and _chunk_length(file, content) != length
    if length < _LEAST[Opcode(opcode)] or (opcode in _EXACT and length != _LEAST[Opcode(opcode)]):
        return False
    if opcode == Opcode.CHUNK:
        return _chunk_length(file, content) == length
    if opcode == Opcode.MESSAGE_INDEX:
        file.seek(content + 2)
        return int.from_bytes(file.read(4), "little") == length - 6
    return True


def _head(file: IO[bytes], position: int) -> tuple[int, int]:
    """Opcode and length of a record; zeros beyond the end."""
    file.seek(position)
    head = file.read(HEAD.size)
    return HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)


def _chunk_length(file: IO[bytes], content: int) -> int | None:
    """The length that the sizes inside a chunk add up to; None for what is no chunk."""
    file.seek(content)
    head = file.read(CHUNK.size + _LETTERS + 8)
    if len(head) < CHUNK.size + 8:
        return None
    letters = CHUNK.unpack_from(head)[4]
    start = CHUNK.size + letters
    if letters > _LETTERS or len(head) < start + 8:
        return None
    if letters and not head[CHUNK.size : start].isalnum():
        return None
    return start + 8 + int.from_bytes(head[start : start + 8], "little")


def _next_record(file: IO[bytes], position: int, size: int) -> int | None:
    """Where the next records that make sense begin, else None."""
    tried = 0
    while position < size - HEAD.size and tried < _MOST_TRIED:
        file.seek(position)
        block = np.frombuffer(file.read(_AT_A_TIME), np.uint8)
        for place in candidates(block, _KINDS).tolist():
            tried += 1
            if _begins(file, position + place, size):
                return position + place
        position += max(len(block) - HEAD.size + 1, 1)
    return None
