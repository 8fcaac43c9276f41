"""Faults done to the bytes of files: containers, tables of text, C3D."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from smoother.io.mcap.records import CHUNK, HEAD, MAGIC

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]
#: How containers are written.
WAYS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 16_384},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 16_384},
    "plain": {"compression": CompressionType.NONE, "chunk_size": 16_384, "enable_crcs": False},
    "unchunked": {"use_chunking": False},
}


def wrapped(path: Path, way: dict[str, Any]) -> bytes:
    """A recording written by the mcap package in another way."""
    return rewritten(path.read_bytes(), np.random.default_rng(0), way=way)


def rewritten(
    data: bytes,
    rng: Rng,
    change: Callable[[list[Any], Rng], list[Any]] = lambda rows, rng: rows,
    way: dict[str, Any] | None = None,
) -> bytes:
    """A file with its messages (schema, channel, message) changed."""
    reader, file = make_reader(BytesIO(data)), BytesIO()
    writer = Writer(file, **(way or {}))
    writer.start()
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    rows = change(list(reader.iter_messages()), rng)
    channels: dict[tuple[str, str], int] = {}
    for schema, channel, message in rows:
        key = channel.topic, schema.name
        if key not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[key] = writer.register_channel(
                channel.topic, channel.message_encoding, number, channel.metadata
            )
        writer.add_message(
            channels[key], message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()
    return file.getvalue()


def other_metadata(data: bytes, rng: Rng, change: Callable[[dict[str, str], Rng], dict[str, str]]) -> bytes:
    """A file with the longest of its metadata records changed."""
    reader, file = make_reader(BytesIO(data)), BytesIO()
    writer = Writer(file)
    writer.start()
    records = list(reader.iter_metadata())
    longest = max(records, key=lambda record: len(str(record.metadata)))
    for record in records:
        values = change(dict(record.metadata), rng) if record is longest else record.metadata
        writer.add_metadata(record.name, values)
    channels: dict[str, int] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.topic not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(
            channels[channel.topic], message.log_time, message.data, message.publish_time, message.sequence
        )
    writer.finish()
    return file.getvalue()


def places(data: bytes, opcode: int) -> list[int]:
    """Where records of a kind begin at the top level."""
    positions, position = [], len(MAGIC)
    while position + HEAD.size <= len(data) - len(MAGIC):
        kind, length = HEAD.unpack_from(data, position)
        positions += [position] * (kind == opcode)
        position += HEAD.size + length
    return positions


def put(data: bytes, at: int, value: bytes) -> bytes:
    """A file with other bytes from a position on."""
    return data[:at] + value + data[at + len(value) :]


def _flip(data: bytes, at: int, rng: Rng) -> bytes:
    return put(data, at, bytes([data[at] ^ (1 << int(rng.integers(8)))]))


def _record(data: bytes, rng: Rng) -> int:
    """Where a chunk begins, or a message where there are no chunks."""
    return int(rng.choice(places(data, Opcode.CHUNK) or places(data, Opcode.MESSAGE)))


def cut(data: bytes, rng: Rng) -> bytes:
    """Cut off anywhere."""
    return data[: int(rng.integers(8, len(data)))]


def bit(data: bytes, rng: Rng) -> bytes:
    """A bit turned anywhere."""
    return _flip(data, int(rng.integers(len(data))), rng)


def first_bytes(data: bytes, rng: Rng) -> bytes:
    """A bit turned in the file's header or first record."""
    return _flip(data, int(rng.integers(120)), rng)


def zeros(data: bytes, rng: Rng) -> bytes:
    """An area of zeros."""
    at = int(rng.integers(len(data)))
    size = int(rng.choice([16, 512, 4096, 30_000]))
    return put(data, at, bytes(min(size, len(data) - at)))


def length(data: bytes, rng: Rng) -> bytes:
    """A record's length changed."""
    at = _record(data, rng)
    value = int(rng.choice([0, 1, 9, 1000, 2**31, 2**40, 2**62]))
    return put(data, at + 1, value.to_bytes(8, "little"))


def opcode(data: bytes, rng: Rng) -> bytes:
    """A record's kind changed."""
    return put(data, _record(data, rng), bytes([int(rng.choice([0, 2, 15, 4, 7, 0x46, 0x86]))]))


def chunk_head(data: bytes, rng: Rng) -> bytes:
    """A bit turned in a chunk's head: times, size, checksum, compression."""
    return _flip(data, _record(data, rng) + HEAD.size + int(rng.integers(CHUNK.size + 12)), rng)


def summary(data: bytes, rng: Rng) -> bytes:
    """A bit turned behind the data."""
    start = places(data, Opcode.DATA_END)[0]
    return _flip(data, int(rng.integers(start, len(data))), rng)


def twice(data: bytes, rng: Rng) -> bytes:
    """A record is there twice."""
    at = _record(data, rng)
    stop = at + HEAD.size + HEAD.unpack_from(data, at)[1]
    return data[:stop] + data[at:stop] + data[stop:]


def taken_out(data: bytes, rng: Rng) -> bytes:
    """Some thousand bytes are missing."""
    at = int(rng.integers(100, len(data) - 5000))
    return data[:at] + data[at + int(rng.integers(1, 5000)) :]


def noise(data: bytes, rng: Rng) -> bytes:
    """Random bytes over an area."""
    at, size = int(rng.integers(len(data))), int(rng.choice([8, 200, 4000]))
    return put(data, at, rng.bytes(min(size, len(data) - at)))


def bomb(data: bytes, rng: Rng) -> bytes:
    """A chunk that unpacks to a hundred thousand times its size."""
    import lz4.frame
    import zstandard

    size = int(rng.choice([1 << 28, 1 << 30]))
    name, packed = b"zstd", zstandard.ZstdCompressor().compress(bytes(size))
    if rng.random() < 0.3:
        name, packed = b"lz4", lz4.frame.compress(bytes(1 << 28))
    stated = int(rng.choice([size, 1000, 1 << 45]))
    content = CHUNK.pack(1, 2, stated, 0, len(name)) + name + len(packed).to_bytes(8, "little") + packed
    at = _record(data, rng)
    return data[:at] + HEAD.pack(Opcode.CHUNK, len(content)) + content + data[at:]


CONTAINER: dict[str, Change] = {
    "cut off": cut,
    "a bit anywhere": bit,
    "a bit in the first records": first_bytes,
    "an area of zeros": zeros,
    "a length": length,
    "an opcode": opcode,
    "a chunk's head": chunk_head,
    "a bit in the summary": summary,
    "a record twice": twice,
    "bytes taken out": taken_out,
    "random bytes": noise,
    "a chunk that unpacks to gigabytes": bomb,
}


def _by_line(change: Callable[[list[bytes], int, Rng], None]) -> Change:
    def changed(data: bytes, rng: Rng) -> bytes:
        lines = data.split(b"\n")
        change(lines, int(rng.integers(len(lines))), rng)
        return b"\n".join(lines)

    return changed


def _set(lines: list[bytes], row: int, text: bytes) -> None:
    lines[row] = text


def _cell(value: bytes) -> Change:
    """Another text in a cell of a row."""

    def changed(lines: list[bytes], row: int, rng: Rng) -> None:
        for mark in (b",", b"\t", b";", b" = "):
            if mark in lines[row]:
                cells = lines[row].split(mark)
                cells[int(rng.integers(len(cells)))] = value
                lines[row] = mark.join(cells)
                return

    return _by_line(changed)


TEXT: dict[str, Change] = {
    "cut off within a row": lambda data, rng: data[: int(rng.integers(1, len(data)))],
    "empty": lambda data, rng: b"",
    "binary rubbish": lambda data, rng: put(data, int(rng.integers(len(data))), rng.bytes(40)),
    "zeros": lambda data, rng: put(data, at := int(rng.integers(len(data))), bytes(min(300, len(data) - at))),
    "nan": _cell(b"nan"),
    "inf": _cell(b"-inf"),
    "1e300": _cell(b"1e300"),
    "denormal": _cell(b"4.9e-324"),
    "digits without end": _cell(b"1" * 5000),
    "a word": _cell(b"\x1b[31mword"),
    "an empty cell": _cell(b""),
    "a long line": _by_line(lambda lines, row, rng: _set(lines, row, b"7," * 100_000)),
    "as UTF-16": lambda data, rng: data.decode("utf-8", "replace").encode("utf-16"),
}

BINARY: dict[str, Change] = {
    "cut off": lambda data, rng: data[: int(rng.integers(1, len(data)))],
    "a bit anywhere": bit,
    "an area of zeros": zeros,
    "random bytes": noise,
}

C3D: dict[str, Change] = {
    **BINARY,
    "a bit in the header": lambda data, rng: _flip(data, int(rng.integers(30)), rng),
    "a byte in the parameters": lambda data, rng: put(data, int(rng.integers(512, 2048)), rng.bytes(1)),
    "more frames stated": lambda data, rng: put(data, 8, rng.bytes(2)),
    "more points stated": lambda data, rng: put(data, 2, rng.bytes(2)),
}
