"""Protobuf messages of one layout, encoded for many samples at once.

A template is the wire form of one message with slots for what changes from sample to sample.
Every slot has a fixed width (varints are padded, which every decoder accepts), so that numpy can
fill all samples of a stream together: 0.4 s for the result of 6 minutes, against 4.3 s by the library.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray

_VARINT, _FIXED64, _BYTES = 0, 1, 2
#: Widths of padded varints: any 64-bit number, any 32-bit number, a flag or small enum.
_WIDE, _MEDIUM, _BYTE = 10, 5, 1


@dataclass(frozen=True)
class Slot:
    """Where a column's values go: `count` doubles from component `first`, or one varint."""

    column: str
    offset: int  # bytes: Where it is in the message
    width: int  # bytes: of a varint; 0 for doubles
    first: int = 0  # Components of the column
    count: int = 1  # Components of the column


@dataclass(frozen=True)
class Template:
    """Fields of a message."""

    data: bytes  # Their wire form
    slots: tuple[Slot, ...] = ()  # What changes from message to message

    def encode(self, rows: int, columns: Mapping[str, NDArray]) -> NDArray[np.uint8]:  # -> (rows, size)
        """Wire form of `rows` messages."""
        block = np.empty((rows, len(self.data)), np.uint8)
        block[:] = np.frombuffer(self.data, np.uint8)
        for slot in self.slots:
            values = columns[slot.column].reshape(rows, -1)[:, slot.first : slot.first + slot.count]
            room = block[:, slot.offset : slot.offset + (slot.width or 8 * slot.count)]
            if slot.width:
                room[:] = _padded_varints(values[:, 0], slot.width)
            else:
                room.view("<f8")[:] = values
        return block


#: From some rows to their values, a column each.
Columns = Callable[[IntArray], dict[str, NDArray]]
#: Rows that are written alike: which, the message that contains each, and its columns.
AlikeRows = tuple[IntArray, Template, Columns]


def alike(codes: NDArray[np.integer]) -> list[tuple[tuple[int, ...], NDArray[np.int64]]]:
    """Rows (n, k) of codes from -1 to 254 that are the same: what they are, and their numbers (m,)."""
    if not len(codes):
        return []
    weights = 256 ** np.arange(codes.shape[1], dtype=np.int64)
    keys = (codes.astype(np.int64) + 1) @ weights
    order = np.argsort(keys, kind="stable")
    firsts = np.flatnonzero(np.diff(keys[order], prepend=keys[order[0]] - 1))
    rows = np.split(order, firsts[1:])
    return [(tuple(codes[mine[0]].tolist()), mine) for mine in rows]


def _padded_varints(values: NDArray, width: int) -> NDArray[np.uint8]:
    """Numbers (rows,) as varints of one width, (rows, width): seven bits a byte, all but the last marked."""
    sevens = np.arange(0, 7 * width, 7).astype(np.uint64)[:, None]
    raw = (values.astype(np.int64).view(np.uint64) >> sevens).astype(np.uint8) | np.uint8(0x80)
    raw[-1] &= 0x7F
    return raw.T


def varint(value: int) -> bytes:
    """Shortest varint of a non-negative number."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def tag(number: int, kind: int) -> bytes:
    """Key of a field: its number and wire type."""
    return varint(number << 3 | kind)


def join(*parts: Template) -> Template:
    """Fields one after the other."""
    data, slots = bytearray(), []
    for part in parts:
        for slot in part.slots:
            slots.append(Slot(slot.column, slot.offset + len(data), slot.width, slot.first, slot.count))
        data += part.data
    return Template(bytes(data), tuple(slots))


def message(number: int, *parts: Template) -> Template:
    """A field that is itself a message."""
    body = join(*parts)
    return join(Template(tag(number, _BYTES) + varint(len(body.data))), body)


def text(number: int, value: str) -> Template:
    """A constant string."""
    raw = value.encode()
    return Template(tag(number, _BYTES) + varint(len(raw)) + raw if raw else b"")


def number(number: int, value: int) -> Template:
    """A constant non-negative integer, enum or bool."""
    return Template(tag(number, _VARINT) + varint(value) if value else b"")


def constants(*values: float) -> Template:
    """Constant doubles in the fields 1, 2, ... (a vector, a colour)."""
    return Template(
        b"".join(tag(i + 1, _FIXED64) + struct.pack("<d", value) for i, value in enumerate(values))
    )


def constant(number: int, value: float) -> Template:
    """A constant double."""
    return Template(tag(number, _FIXED64) + struct.pack("<d", value))


def double(number: int, column: str, component: int = 0) -> Template:
    """A double taken from a component of a column."""
    return _slot(tag(number, _FIXED64), Slot(column, 0, 0, component, 1), 8)


def vector(number: int, column: str, components: tuple[int, ...] = (0, 1, 2)) -> Template:
    """A message of doubles in the fields 1, 2, ... taken from a column's components."""
    return message(number, *(double(i + 1, column, component) for i, component in enumerate(components)))


def packed(number: int, column: str, count: int) -> Template:
    """`repeated double`, all components of a column in order."""
    return _slot(tag(number, _BYTES) + varint(8 * count), Slot(column, 0, 0, 0, count), 8 * count)


def flag(number: int, column: str, component: int = 0) -> Template:
    """A bool or an enum below 128 from a column."""
    return _slot(tag(number, _VARINT), Slot(column, 0, _BYTE, component), _BYTE)


def timestamp(number: int, column: str) -> Template:
    """A google.protobuf.Timestamp from the columns `column` + "_sec" and "_nsec" (see `stamps`)."""
    return message(
        number,
        _slot(tag(1, _VARINT), Slot(f"{column}_sec", 0, _WIDE), _WIDE),
        _slot(tag(2, _VARINT), Slot(f"{column}_nsec", 0, _MEDIUM), _MEDIUM),
    )


def stamps(column: str, stamp_ns: NDArray[np.int64]) -> dict[str, NDArray]:
    """The columns that `timestamp` reads; seconds may be negative, nanoseconds are not."""
    seconds, nanoseconds = np.divmod(stamp_ns, 1_000_000_000)
    return {f"{column}_sec": seconds, f"{column}_nsec": nanoseconds}


def _slot(head: bytes, slot: Slot, size: int) -> Template:
    moved = Slot(slot.column, len(head), slot.width, slot.first, slot.count)
    return Template(head + bytes(size), (moved,))
