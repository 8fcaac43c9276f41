"""Messages and records of an MCAP file: by topic, as the mcap package and protobuf read them; by place."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from smoother.array_types import IntArray
from smoother.io.mcap.container import HEAD, MAGIC, Container
from smoother.io.mcap.messages import McapMessage
from smoother.io.wire.layout import Block, Grouper, MessageLayout
from smoother.io.wire.schemas import message_class


def groups(grouper: Grouper, payloads: Sequence[bytes]) -> Iterator[tuple[IntArray, Block, MessageLayout]]:
    """Payloads by layout, one behind the other in a buffer."""
    ends = np.cumsum([len(each) for each in payloads], dtype=np.int64)
    yield from grouper.groups_in(b"".join(payloads), ends - [len(each) for each in payloads], ends)


def every(container: Container) -> Iterator[McapMessage]:
    """All messages."""
    return container.messages(lambda topic: True)


def decoded(path: Path) -> dict[str, list[Any]]:
    """Every message, decoded, in the order of time; a topic without any has an empty list."""
    messages: dict[str, list[Any]] = defaultdict(list)
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None and channel.message_encoding == "protobuf"
            one = message_class(schema.name)()
            one.ParseFromString(message.data)
            messages[channel.topic].append(one)
    return messages


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
