"""Chunks unpacked, to no more than a container may honestly hold."""

from __future__ import annotations

import os
from collections.abc import Callable

from ...errors import RecordingError, UnoccludeError

#: Compressions of chunks that are read.
COMPRESSIONS = ("", "zstd", "lz4")
#: What compressed data begin with.
_MAGIC = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
#: Largest size of a chunk, MB, and the variable that changes it. Recorders make chunks of 1 to 64 MB.
LIMIT_MB, LIMIT_NAME = 256, "UNOCCLUDE_CHUNK_LIMIT_MB"
#: All chunks together hold so many bytes at most, and so many times the file's size on top.
_WHOLE, _RATIO = 1 << 30, 256
#: A damaged chunk is fed so many bytes at a time.
_STEP = 512


def chunk_limit() -> int:
    """Largest size of a chunk that is unpacked, bytes.

    Raises
    ------
    UnoccludeError
        The variable that sets it is no number.
    """
    text = os.environ.get(LIMIT_NAME, "") or str(LIMIT_MB)
    if not (text.isascii() and text.isdigit() and len(text) < 7 and int(text)):
        raise UnoccludeError(f"the variable {LIMIT_NAME} is a number of megabytes above zero, not {text:.40}")
    return int(text) << 20


def whole_limit(file_bytes: int) -> int:
    """Most bytes that all chunks of a file may hold together."""
    return max(_WHOLE, 4 * chunk_limit()) + _RATIO * file_bytes


def unpack(compression: str, packed: memoryview, size: int, source: object) -> bytes:
    """A chunk's records; of a damaged chunk those before the damage, never more than `size` bytes.

    Parameters
    ----------
    compression : str
        "", "zstd" or "lz4".
    packed : memoryview
        As they lie in the file.
    size : int, bytes
        That the chunk states of its records.
    source : object
        The file, for messages.

    Raises
    ------
    RecordingError
        The compression is not known.
    """
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
    """What gives the next bytes of a chunk, at most so many, and what it raises on damaged data."""
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
