"""Messages of an MCAP file by topic, as the mcap package and protobuf read them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from smoother.io.mcap.container import Container
from smoother.io.mcap.messages import McapMessage
from smoother.io.wire.schemas import message_class


def every(container: Container) -> Iterator[McapMessage]:
    """All messages, chunk by chunk."""
    for batch in container.batches(lambda topic: True):
        for messages in batch.values():
            yield from messages


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
