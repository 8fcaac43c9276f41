"""An MCAP file as a run of messages, read front to back in flat memory.

The index at a file's end is not used, so that a file that was cut off gives all that it still has.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from ..errors import RecordingError
from .messages import Message, Run, Topic

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
#: Messages outside chunks are gathered to blocks of this size.
_GATHER = 1 << 20
#: Chunks said to be larger than this are not believed.
_CHUNK_LIMIT = 1 << 31


class Container:
    """A file to be read once, front to back.

    Attributes
    ----------
    path : the file.
    topics : channels met so far.
    metadata : metadata records met so far, by name; later ones win.
    notes : what was wrong with the file, one sentence each.
    """

    def __init__(self, path: str | os.PathLike[str]):
        self.path = Path(path)
        self.topics: list[Topic] = []
        self.metadata: dict[str, dict[str, str]] = {}
        self.notes: list[str] = []
        self._channels: dict[int, Topic] = {}
        self._schemas: dict[int, Schema] = {}
        self._cut = False

    def batches(self, wanted: Callable[[Topic], bool]) -> Iterator[dict[int, list[Message]]]:
        """Yield the messages of wanted topics a chunk at a time, by position of the topic in `topics`.

        All messages are counted in their topic; payloads of topics that are not wanted are passed over.
        """
        for block in self._blocks():
            found: dict[int, list[Message]] = {}
            take: dict[int, list[Message] | None] = {}
            for message in self._messages(block):
                key = id(message.topic)
                if key not in take:
                    is_wanted = wanted(message.topic)
                    take[key] = found.setdefault(self.topics.index(message.topic), []) if is_wanted else None
                message.topic.note(message.log_ns)
                into = take[key]
                if into is not None:
                    into.append(message)
            if found:
                yield found

    def messages(self) -> Iterator[Message]:
        """Yield all messages in the file's order."""
        for block in self._blocks():
            yield from self._messages(block)

    def runs(self, wanted: Callable[[Topic], bool]) -> Iterator[Run]:
        """Yield the messages of wanted topics a chunk at a time, in the file's order."""
        topics: list[Topic] = []
        numbers: dict[int, int] = {}  # by channel; -1: not wanted
        for block in self._blocks():
            rows: list[tuple[int, int, int, int]] = []
            data: list[bytes] = []
            for start, end in self._records_in(block):
                channel, *rest = _MESSAGE.unpack_from(block, start)
                number = numbers.get(channel)
                if number is None:
                    topic = self._channels.get(channel)
                    if topic is None:
                        continue
                    number = numbers[channel] = len(topics) if wanted(topic) else -1
                    if number >= 0:
                        topics.append(topic)
                if number >= 0:
                    rows.append((number, *rest))
                    data.append(block[start + _MESSAGE.size : end])
            if rows:
                topic_of, sequence, log_ns, publish_ns = np.array(rows, np.uint64).astype(np.int64).T
                yield Run(topics, topic_of, sequence, log_ns, publish_ns, data)

    def _messages(self, block: bytes) -> Iterator[Message]:
        view = memoryview(block)
        channels = self._channels
        for start, end in self._records_in(block):
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(block, start)
            topic = channels.get(channel)
            if topic is not None:
                yield Message(topic, sequence, log_ns, publish_ns, view[start + _MESSAGE.size : end])

    def _records_in(self, block: bytes) -> Iterator[tuple[int, int]]:
        """Yield where each message record's content starts and ends; schemas and channels are taken in."""
        position, size, head, message = 0, len(block), _HEAD.unpack_from, int(Opcode.MESSAGE)
        while position + 9 <= size:
            opcode, length = head(block, position)
            start = position + 9
            position = start + length
            if position > size:
                self._cut = True
                return
            if opcode == message and length >= _MESSAGE.size:
                yield start, position
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, block[start:position])

    def _define(self, opcode: int, content: bytes) -> None:
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
                return
            channel = Channel.read(stream)
        except (McapError, struct.error, UnicodeDecodeError):
            self._damaged("a schema or channel record is damaged")
            return
        if channel.id in self._channels:
            return
        its = self._schemas.get(channel.schema_id)
        name, encoding, data = (its.name, its.encoding, its.data) if its else ("", "", b"")
        topic = Topic(channel.topic, name, encoding, data, channel.message_encoding, dict(channel.metadata))
        # Recorders that split or restart make a second channel of the same topic.
        for known in self.topics:
            if (known.name, known.schema, known.encoding) == (topic.name, topic.schema, topic.encoding):
                topic = known
                break
        else:
            self.topics.append(topic)
        self._channels[channel.id] = topic

    def _blocks(self) -> Iterator[bytes]:
        """Yield runs of schema, channel and message records."""
        try:
            size = self.path.stat().st_size
            with open(self.path, "rb") as file:
                self._check_magic(file.read(len(_MAGIC)))
                yield from self._records(file, size)
        except OSError as error:
            raise RecordingError(_unreadable(self.path, error)) from error
        if self._cut:
            self._damaged("the file ends in the middle of the recording; everything before the cut was read")

    def _records(self, file: IO[bytes], size: int) -> Iterator[bytes]:
        gathered = bytearray()
        while True:
            head = file.read(9)
            if len(head) < 9:
                self._cut = True
                break
            opcode, length = _HEAD.unpack(head)
            left = size - file.tell()
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                break
            if opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
                content = file.read(min(length, left))
                if len(content) < length:
                    self._cut = True
                    break
                if opcode == Opcode.METADATA:
                    self._metadata(content)
                else:
                    gathered += head + content
                if len(gathered) > _GATHER:
                    yield bytes(gathered)
                    gathered.clear()
            elif opcode == Opcode.CHUNK and length < _CHUNK_LIMIT:
                if gathered:
                    yield bytes(gathered)
                    gathered.clear()
                content = file.read(min(length, left))
                self._cut |= len(content) < length
                yield self._unpack(content, file.tell() - len(content))
            elif length > left:
                self._cut = True
                break
            else:
                file.seek(length, os.SEEK_CUR)
            if self._cut:
                break
        if gathered:
            yield bytes(gathered)

    def _unpack(self, content: bytes, offset: int) -> bytes:
        """A chunk's records; of a chunk that is cut off or damaged, those before the place."""
        if len(content) < _CHUNK.size + 4:
            return b""
        _, _, size, crc = _CHUNK.unpack_from(content)
        (length,) = struct.unpack_from("<I", content, _CHUNK.size)
        start = _CHUNK.size + 4 + length
        compression = content[_CHUNK.size + 4 : start].decode("ascii", "replace")
        packed = content[start + 8 :]
        data = _decompress(compression, packed, self.path)
        if len(data) < size and not self._cut:
            self._damaged(f"the chunk at byte {offset} is damaged; {len(data)} of its {size} bytes were read")
        elif crc and len(data) == size and zlib.crc32(data) != crc:
            self._damaged(f"the chunk at byte {offset} fails its checksum and was left out")
            return b""
        return data

    def _metadata(self, content: bytes) -> None:
        try:
            record = Metadata.read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error, UnicodeDecodeError):
            self._damaged("a metadata record is damaged")
            return
        self.metadata[record.name] = dict(record.metadata)

    def _damaged(self, what: str) -> None:
        sentence = f"{self.path.name}: {what}."
        if sentence not in self.notes:
            self.notes.append(sentence)

    def _check_magic(self, magic: bytes) -> None:
        if not magic:
            raise RecordingError(f"{self.path} is empty (0 bytes); record or copy it again.")
        if magic != _MAGIC:
            raise RecordingError(
                f"{self.path} is not an MCAP file; convert a ROS bag with `mcap convert`, and plain files "
                "with `unocclude import csv`."
            )


def _decompress(compression: str, packed: bytes, path: Path) -> bytes:
    """All that can be had of a chunk, block by block, up to its end or to where it is broken."""
    make, failures = _decompressor(compression, path)
    if make is None:
        return packed
    try:
        return bytes(make().decompress(packed))
    except failures:
        pass
    # Damaged: feed it in small pieces, keep what comes out before the damage.
    out, again = bytearray(), make()
    try:
        for start in range(0, len(packed), 4096):
            out += again.decompress(packed[start : start + 4096])
    except failures:
        pass
    return bytes(out)


def _decompressor(compression: str, path: Path) -> tuple[Any, tuple[type[Exception], ...]]:
    """What makes a decompressor (None for plain chunks), and what it raises on damaged data."""
    if compression == "":
        return None, ()
    if compression == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompressobj, (zstandard.ZstdError,)
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        return LZ4FrameDecompressor, (RuntimeError, EOFError)
    raise RecordingError(f"{path} is compressed with {compression!r}; rewrite it with `mcap compress`.")


def _unreadable(path: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError):
        return f"{path} does not exist; check the name."
    if isinstance(error, IsADirectoryError) or path.is_dir():
        return f"{path} is a folder; name an MCAP file, or bring plain files in with `unocclude import csv`."
    return f"{path} cannot be read: {error.strerror or error}."
