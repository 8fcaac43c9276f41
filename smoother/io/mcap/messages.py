"""Messages of an MCAP file and the topics that they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from .losses import plain_name


@dataclass
class Topic:
    """A channel of the file.

    Attributes
    ----------
    name : str
        The topic.
    schema : str
        Name of its schema; "" where there is none.
    schema_encoding : str
    schema_data : bytes
        As the file has them.
    encoding : str
        Of the messages (`cdr`, `protobuf`).
    metadata : dict of str to str
        Of the channel.
    count : int
        Number of messages.
    first_ns, last_ns : int, ns
        Smallest and largest log time.
    """

    name: str
    schema: str
    schema_encoding: str
    schema_data: bytes
    encoding: str
    metadata: dict[str, str] = field(default_factory=dict)
    count: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def label(self) -> str:
        """Its name, fit for a message: no control characters, at most 80 letters."""
        return plain_name(self.name)

    def note(self, log_ns: NDArray[np.uint64]) -> None:
        """Count messages (n,), at least one."""
        first, last = int(log_ns.min()), int(log_ns.max())
        self.first_ns = min(self.first_ns, first) if self.count else first
        self.last_ns = max(self.last_ns, last)
        self.count += len(log_ns)


class McapMessage(NamedTuple):
    """A message as it lies in the file.

    Attributes
    ----------
    topic : Topic
        Its topic.
    log_ns : int, ns
        Its log time.
    data : memoryview
        Its payload.
    """

    topic: Topic
    log_ns: int
    data: memoryview


class TopicMessages(NamedTuple):
    """Messages of one topic in a chunk, as columns (n,) in the file's order.

    Attributes
    ----------
    log_ns : ndarray of int, shape (n,), ns
        Log times.
    chunk : bytes
        Its bytes; payloads stay where they lie in them.
    start, stop : ndarray of int, shape (n,)
        Where each payload begins and ends.
    """

    log_ns: IntArray
    chunk: bytes
    start: IntArray
    stop: IntArray


class ChunkMessages(NamedTuple):
    """Messages of one chunk, of all topics, in the file's order.

    Attributes
    ----------
    topics : list of Topic
        All of them so far.
    topic : ndarray of int, shape (n,)
        Of each message, as a position in `topics`.
    sequence : ndarray of int, shape (n,)
        Their numbers within the channel.
    log_ns, publish_ns : ndarray of int, shape (n,), ns
        Their times.
    data : list of bytes
        Copies of the payloads.
    """

    topics: list[Topic]
    topic: IntArray
    sequence: IntArray
    log_ns: IntArray
    publish_ns: IntArray
    data: list[bytes]

    def select(self, rows: slice) -> ChunkMessages:
        """Some of the messages."""
        return ChunkMessages(
            self.topics,
            self.topic[rows],
            self.sequence[rows],
            self.log_ns[rows],
            self.publish_ns[rows],
            self.data[rows],
        )
