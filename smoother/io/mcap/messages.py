"""Messages of an MCAP file, the topics that they belong to, and what a damaged file lost of them.

Stamps in nanoseconds, as files have them, and seconds after an origin.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...runtime.printable import printable
from ...runtime.store import Store, batches
from ..wire.layout import Block, Buffer, MessageLayout

SECOND_NS = 1_000_000_000


def seconds(
    stamp_ns: IntArray,  # (n,) ns
    origin_ns: int,
    store: Store | None = None,
) -> FloatArray:  # (n,) s
    """Stamps as seconds after an origin; `nanoseconds` gives the same stamps back."""
    if store is None:
        return (stamp_ns - origin_ns) / 1e9
    t_s = store.array((len(stamp_ns),), 0.0)
    for part in batches(len(stamp_ns)):
        t_s[part] = (stamp_ns[part] - origin_ns) / 1e9
    return t_s


def nanoseconds(t_s: FloatArray, origin_ns: int) -> IntArray:
    """Seconds (n,) after an origin as stamps in ns."""
    return np.rint(np.asarray(t_s) * 1e9).astype(np.int64) + origin_ns


def ros_stamps(block: Block, layout: MessageLayout) -> IntArray:
    """Stamps (rows,) of ROS messages with the fields `sec` and `nsec`, ns."""
    seconds_part = layout.get(block, "sec")[:, 0].astype(np.int64)
    return seconds_part * SECOND_NS + layout.get(block, "nsec")[:, 0].astype(np.int64)


#: This many losses have a sentence of their own.
_MOST = 6
#: Names in messages are cut to this length.
_LONGEST_NAME = 80


@dataclass
class Loss:
    """A part of the file that gave nothing, or gave what cannot be vouched for."""

    what: str  # What is there and what became of it
    start: int  # bytes: Where it is in the file
    stop: int  # bytes: Where it is in the file
    first_ns: int | None = None  # Log times before and after it; None if unknown
    last_ns: int | None = None  # Log times before and after it; None if unknown
    counts: dict[str, int] = field(default_factory=dict)  # Messages lost by topic, as far as indexes tell
    is_kept: bool = False  # They were read all the same, and cannot be vouched for

    def sentence(self, zero_ns: int | None) -> str:
        """One clause for a note; times count from `zero_ns`."""
        parts = []
        if self.counts:
            parts.append(listed(self.counts))
        if zero_ns is not None and self.first_ns is not None and self.last_ns is not None:
            first, last = (max((time - zero_ns) / 1e9, 0.0) for time in (self.first_ns, self.last_ns))
            if last < 1e8:  # a time that is damaged itself is of no use
                parts.append(f"{first:.3f} to {max(first, last):.3f} s after the first message")
        return f"{self.what} ({', '.join(parts)})" if parts else self.what


class DamageLog:
    """What was wrong with a file, as it is met."""

    def __init__(self, name: str):
        self.name = name
        self.notes: list[str] = []
        self.losses: list[Loss] = []
        self.is_cut = False
        self.first_ns: int | None = None
        self._last_ns: int | None = None
        self._open: list[Loss] = []

    def note(self, what: str) -> None:
        """Say what was wrong, once."""
        sentence = f"{self.name}: {what}."
        if sentence not in self.notes:
            self.notes.append(sentence)

    def lost(self, loss: Loss) -> None:
        """Take down a loss; if its time is unknown, it is between the messages around it."""
        if loss.first_ns is None and self._last_ns is not None:
            loss.first_ns = self._last_ns
            self._open.append(loss)
        self.losses.append(loss)

    def met(self, log_ns: NDArray[np.uint64]) -> None:
        """Messages (n,), at least one: what was lost before is between the ones before and these."""
        first, last = int(log_ns.min()), int(log_ns.max())
        for loss in self._open:
            loss.last_ns = max(first, loss.first_ns or 0)
        self._open.clear()
        self.first_ns = first if self.first_ns is None else self.first_ns
        self._last_ns = last if self._last_ns is None else max(self._last_ns, last)

    def finish(self) -> None:
        """Say what was lost."""
        for clause in sentences(self.losses, self.first_ns):
            self.note(clause)


def sentences(losses: Sequence[Loss], zero_ns: int | None) -> list[str]:
    """A clause for each of the first losses, and one for all others."""
    clauses = list(dict.fromkeys(loss.sentence(zero_ns) for loss in losses[:_MOST]))
    rest = losses[_MOST:]
    if rest:
        counts: Counter[str] = Counter()
        for loss in rest:
            counts.update(loss.counts)
        lost = f" ({listed(counts)})" if counts else ""
        clauses.append(f"{len(rest)} places more are damaged{lost}; `unocclude repair` lists them all")
    return clauses


def listed(counts: dict[str, int]) -> str:
    """Messages by topic, for a sentence."""
    names = sorted(counts)
    texts = [f"{counts[name]} of {plain_name(name)}" for name in names[:_MOST]]
    if len(names) > _MOST:
        texts.append(f"{len(names) - _MOST} topics more")
    return "messages: " + ", ".join(texts)


def plain_name(name: str) -> str:
    """A name that came from a file, fit for a message: no control characters, at most 80 letters."""
    if len(name) <= _LONGEST_NAME and name.isprintable():
        return name
    clean = printable(name[: 4 * _LONGEST_NAME])
    return clean if len(clean) <= _LONGEST_NAME else clean[: _LONGEST_NAME - 2] + ".."


@dataclass
class Topic:
    """A channel of the file."""

    name: str  # The topic
    schema: str  # Name of its schema; "" where there is none
    schema_encoding: str
    schema_data: bytes  # As the file has them
    encoding: str  # Of the messages (`cdr`, `protobuf`)
    metadata: dict[str, str] = field(default_factory=dict)  # Of the channel
    count: int = 0  # Number of messages
    first_ns: int = 0  # Smallest and largest log time
    last_ns: int = 0  # Smallest and largest log time

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
    """A message as it is in the file."""

    topic: Topic  # Its topic
    log_ns: int  # Its log time
    data: memoryview  # Its payload


class TopicMessages(NamedTuple):
    """Messages of one topic in a chunk, as columns (n,) in the file's order."""

    log_ns: IntArray  # int (n,) ns: log times
    chunk: bytes  # Its bytes; payloads stay where they are in them
    start: IntArray  # int (n,): Where each payload begins and ends
    stop: IntArray  # int (n,): Where each payload begins and ends


class ChunkMessages(NamedTuple):
    """Messages of one chunk, of all topics, in the file's order."""

    topics: list[Topic]  # All of them so far
    topic: IntArray  # int (n,): of each message, as a position in `topics`
    sequence: IntArray  # int (n,): their numbers within the channel
    log_ns: IntArray  # int (n,) ns: their times
    publish_ns: IntArray  # int (n,) ns: their times
    chunk: Buffer  # What contains the payloads
    start: IntArray  # int (n,): Where each payload begins and ends
    stop: IntArray  # int (n,): Where each payload begins and ends

    @property
    def data(self) -> list[bytes]:
        """Copies of the payloads."""
        view = memoryview(self.chunk)
        return [bytes(view[a:b]) for a, b in zip(self.start.tolist(), self.stop.tolist(), strict=True)]

    def select(self, rows: slice) -> ChunkMessages:
        """Some of the messages."""
        return ChunkMessages(
            self.topics,
            self.topic[rows],
            self.sequence[rows],
            self.log_ns[rows],
            self.publish_ns[rows],
            self.chunk,
            self.start[rows],
            self.stop[rows],
        )
