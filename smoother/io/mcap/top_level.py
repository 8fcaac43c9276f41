"""Records of an MCAP file one after the other, behind a damage the next that make sense; chunks unpacked."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from typing import IO, NamedTuple

import numpy as np
from mcap.opcode import Opcode

from ...errors import RecordingError, UnoccludeError
from .records import CHUNK, HEAD, MAGIC, MESSAGE, candidates

#: Compressions of chunks that are read.
COMPRESSIONS = ("", "zstd", "lz4")
#: What compressed data begin with.
_MAGIC = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
#: Largest size of a chunk, MB, and the variable that changes it. Recorders make chunks of 1 to 64 MB.
LIMIT_MB, LIMIT_NAME = 256, "UNOCCLUDE_CHUNK_LIMIT_MB"
#: All chunks together hold this many bytes at most, and this many times the file's size on top.
_WHOLE, _RATIO = 1 << 30, 256
#: A damaged chunk is fed this many bytes at a time.
_STEP = 512


def chunk_limit() -> int:
    """Largest size of a chunk that is unpacked, bytes."""
    text = os.environ.get(LIMIT_NAME, "") or str(LIMIT_MB)
    if not (text.isascii() and text.isdigit() and len(text) < 7 and int(text)):
        raise UnoccludeError(f"the variable {LIMIT_NAME} is a number of megabytes above zero, not {text:.40}")
    return int(text) << 20


def whole_limit(file_bytes: int) -> int:
    """Most bytes that all chunks of a file may contain together."""
    return max(_WHOLE, 4 * chunk_limit()) + _RATIO * file_bytes


def unpack(compression: str, packed: memoryview, size: int, source: object) -> bytes:
    """A chunk's records; of a damaged chunk those before the damage, never more than `size` bytes."""
    if compression == "":
        return bytes(packed[:size])
    if is_unknown(compression, packed):
        name = "".join(letter for letter in compression[:80] if letter.isprintable())
        raise RecordingError(f"{source} is compressed with {name!r}; rewrite it with `mcap compress`.")
    if compression not in COMPRESSIONS:  # the name itself is damaged
        compression = _MAGIC[bytes(packed[:4])]
    return _at_once(compression, packed, size) or _bit_by_bit(compression, packed, size)


def is_unknown(compression: str, packed: memoryview) -> bool:
    """Whether neither a chunk's name of its compression nor its first bytes are of one that is read."""
    return compression not in COMPRESSIONS and bytes(packed[:4]) not in _MAGIC


def _at_once(compression: str, packed: memoryview, size: int) -> bytes | None:
    """A zstd chunk that states its own size, as the chunk does: twice as fast; None for others."""
    if compression != "zstd" or not size:
        return None
    import zstandard

    try:
        if zstandard.get_frame_parameters(packed).content_size != size:
            return None
        return zstandard.ZstdDecompressor().decompress(packed)
    except (zstandard.ZstdError, MemoryError):
        return None


def _bit_by_bit(compression: str, packed: memoryview, size: int) -> bytes:
    """A little at a time, so that what comes out before a damage is kept."""
    out = bytearray()
    read, failures = _reader(compression, packed)
    try:
        while len(out) < size and (more := read(size - len(out))):
            out += more
    except failures:
        pass
    return bytes(out[:size])


def _reader(
    compression: str, packed: memoryview
) -> tuple[Callable[[int], bytes], tuple[type[BaseException], ...]]:
    """What gives the next bytes of a chunk, at most this many, and what it raises on damaged data."""
    place = 0
    if compression == "zstd":
        import zstandard

        zstd = zstandard.ZstdDecompressor().decompressobj()

        def read_zstd(most: int) -> bytes:
            nonlocal place
            more = b""
            while not more and place < len(packed) and not zstd.eof:
                part = packed[place : place + _STEP]  # a step unpacks to 16 MB at most, whatever is in it
                place += len(part)
                more = zstd.decompress(part)
            return more

        return read_zstd, (zstandard.ZstdError, MemoryError)
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

    lz4 = LZ4FrameDecompressor()

    def read_lz4(most: int) -> bytes:
        nonlocal place
        while not lz4.eof:
            part = b""
            if lz4.needs_input:
                part = bytes(packed[place : place + 4096])
                place += len(part)
                if not part:
                    break
            if more := lz4.decompress(part, max_length=most):
                return bytes(more)
        return b""

    return read_lz4, (RuntimeError, EOFError, MemoryError)


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
#: This many records in a row that make sense are not a coincidence.
_IN_A_ROW = 3
#: The file is searched by this many bytes at a time.
_AT_A_TIME = 1 << 22
#: After this many places that only look like a record, and this many damages, the rest is given up.
_MOST_TRIED, _MOST_DAMAGES = 100_000, 10_000
#: A name of a compression is no longer than this.
_LETTERS = 16


class TopRecord(NamedTuple):
    """A record, or a part of the file that contains none."""

    # `DAMAGED` for a part that makes no sense, `CUT` where the file ends in the middle of a record
    opcode: int
    start: int  # bytes: Where its content begins; of what is damaged, where that itself does
    length: int  # bytes: of its content; what the record states, where it is cut
    why: str = ""  # What was wrong with a record that could be read all the same


DAMAGED, CUT = -1, -2


def top_records(file: IO[bytes], size: int) -> Iterator[TopRecord]:
    """Yield the records up to the end of the data section, and what is damaged between them."""
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
    """A record whose opcode or length is damaged while the rest of it shows what it is, else None."""
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
    """The length that the sizes inside a chunk add up to; None for what is not a chunk."""
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
