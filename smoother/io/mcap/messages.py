"""Messages of an MCAP file, the topics that they belong to, and what a damaged file lost of them.

Stamps in nanoseconds, as files have them, and seconds after an origin.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ...array_types import FloatArray, IntArray
from ...runtime.printable import printable
from ...runtime.store import by_rows
from ..wire.layout import Buffer

SECOND_NS = 1_000_000_000


def seconds(stamp_ns: IntArray, origin_ns: int) -> FloatArray:
    """Stamps (n,) as seconds after an origin; `nanoseconds` gives the same stamps back."""
    return by_rows(lambda stamp: (stamp - origin_ns) / 1e9, stamp_ns)


def nanoseconds(t_s: FloatArray, origin_ns: int) -> IntArray:
    """Seconds (n,) after an origin as stamps in ns."""
    return np.rint(np.asarray(t_s) * 1e9).astype(np.int64) + origin_ns


class DamageNote(str):
    """A note on a file that was cut off or is damaged, known as such where it is repeated."""


def damage_note(name: str, what: str) -> DamageNote:
    """A note on a file that was cut off or is damaged."""
    return DamageNote(f"damaged file {name}: {what}")


def damage(notes: Iterable[str]) -> list[str]:
    """Of some notes those on a file that was cut off or is damaged."""
    return [note for note in notes if isinstance(note, DamageNote)]


def told_behind(notes: Sequence[str]) -> str:
    """The first notes as sentences behind that of an error; "" for none."""
    text = " ".join(notes[:4])
    return f" {text[:1].upper()}{text[1:]}" if text else ""


#: This many damages have a sentence of their own; this many names are listed.
_MOST = 6
#: Names in messages are cut to this length.
_LONGEST_NAME = 80


@dataclass(frozen=True)
class Damage:
    """A part of the file that gave nothing."""

    what: str  # What is there and what became of it
    start_byte: int  # Where it is in the file
    stop_byte: int
    first_ns: int | None = None  # Log times that it is between; None if unknown
    last_ns: int | None = None

    def sentence(self, zero_ns: int | None) -> str:
        """One clause for a note; times count from `zero_ns`."""
        if zero_ns is None or self.first_ns is None:
            return self.what
        first, last = (max(((time or 0) - zero_ns) / 1e9, 0.0) for time in (self.first_ns, self.last_ns))
        if max(first, last) > 1e8:  # a time that is damaged itself is of no use
            return self.what
        until = "on" if self.last_ns is None else f"to {max(first, last):.3f} s"
        return f"{self.what} (from {first:.3f} s {until} after the first message)"


def sentences(damage: Sequence[Damage], zero_ns: int | None) -> list[str]:
    """A clause for each of the first damages, and one for all others."""
    clauses = list(dict.fromkeys(each.sentence(zero_ns) for each in damage[:_MOST]))
    if (more := len(damage) - _MOST) > 0:
        clauses.append(f"{more} places more are damaged; `unocclude repair` lists them all")
    return clauses


def listed(counts: Mapping[str, int], of: Mapping[str, int] | None = None) -> str:
    """Messages by topic, for a sentence; `of` is their total where it is known."""
    texts = [
        f"{counts[name]} of {f'{of[name]} of ' if of else ''}{plain_name(name)}"
        for name in sorted(counts)[:_MOST]
    ]
    return ", ".join(texts + ([f"{len(counts) - _MOST} topics more"] if len(counts) > _MOST else []))


def plain_name(name: str) -> str:
    """A name that came from a file, fit for a message: no control characters, at most 80 letters."""
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
    last_ns: int = 0

    @property
    def label(self) -> str:
        """Its name, fit for a message: no control characters, at most 80 letters."""
        return plain_name(self.name)

    @property
    def duration_s(self) -> float:
        """First to last message, s."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate_hz(self) -> float:
        """Mean rate; nan for fewer than two messages."""
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else float("nan")

    def note(self, log_ns: IntArray) -> None:
        """Count messages (n,), at least one."""
        first, last = int(log_ns.min()), int(log_ns.max())
        self.first_ns = min(self.first_ns, first) if self.count else first
        self.last_ns = max(self.last_ns, last)
        self.count += len(log_ns)


class McapMessage(NamedTuple):
    """A message as it is in the file."""

    topic: Topic
    log_ns: int
    data: bytes  # Its payload


class Messages(NamedTuple):
    """Messages of a chunk as columns (n,), in the file's order; payloads stay where they are in it."""

    topic: IntArray  # Positions in the file's topics
    sequence: IntArray  # Numbers within the channel
    log_ns: IntArray
    publish_ns: IntArray
    chunk: Buffer
    start: IntArray  # Where in the chunk each payload begins
    stop: IntArray  # and ends

    def select(self, rows: slice | IntArray) -> Messages:
        """Some of the messages."""
        return Messages(*(each if each is self.chunk else each[rows] for each in self))  # type: ignore[arg-type]

    def payloads(self) -> list[bytes]:
        """The bytes of each message."""
        return [bytes(self.chunk[a:b]) for a, b in zip(self.start.tolist(), self.stop.tolist(), strict=True)]
