"""Messages of an MCAP file and the topics that they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from ..recording import IntArray


@dataclass
class Topic:
    """A channel of the file and what it carried.

    Attributes
    ----------
    name : the topic.
    schema : name of its schema; "" where there is none.
    schema_encoding, schema_data : as the file has them.
    encoding : of the messages (`cdr`, `protobuf`).
    count : number of messages.
    first_ns, last_ns : smallest and largest log time, ns.
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

    def note(self, log_ns: int) -> None:
        """Count a message."""
        self.first_ns = min(self.first_ns, log_ns) if self.count else log_ns
        self.last_ns = max(self.last_ns, log_ns)
        self.count += 1


class Message(NamedTuple):
    """A message as it lies in the file."""

    topic: Topic
    sequence: int
    log_ns: int
    publish_ns: int
    data: memoryview


class Run(NamedTuple):
    """Messages of one chunk as columns, (n,) each, in the file's order.

    `topic` numbers the list `topics`; `data` are copies.
    """

    topics: list[Topic]
    topic: IntArray
    sequence: IntArray
    log_ns: IntArray
    publish_ns: IntArray
    data: list[bytes]

    def part(self, rows: slice) -> Run:
        """Some of the messages."""
        return Run(
            self.topics,
            self.topic[rows],
            self.sequence[rows],
            self.log_ns[rows],
            self.publish_ns[rows],
            self.data[rows],
        )
