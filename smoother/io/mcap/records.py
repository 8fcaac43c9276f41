"""The records of an MCAP file, and where those of a chunk lie: by its index where that is right."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ...recording import IntArray
from ..wire.layout import cut_out

#: An MCAP file begins and ends with these bytes.
MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length that every record begins with.
HEAD = struct.Struct("<BQ")
#: What a chunk begins with, up to the name of its compression: first and last log time, size and checksum of
#: its records, letters of the name. Behind the name stand the compressed size (u64) and the records.
CHUNK = struct.Struct("<QQQII")
#: A chunk's index of a channel up to its entries: the channel, and the bytes of the entries.
INDEX = struct.Struct("<HI")
#: A message record up to its payload.
MESSAGE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<u8"),
        ("publish", "<u8"),
    ]
)
#: Length that a message without payload states.
_SHORTEST = MESSAGE.itemsize - HEAD.size
#: More gaps than this between the messages of an index are not looked into one by one.
_MOST_GAPS = 64


class Definition(NamedTuple):
    """A schema or channel record: its opcode, and where it begins and ends."""

    opcode: int
    start: int
    stop: int


class RecordPlaces(NamedTuple):
    """What a chunk holds.

    Attributes
    ----------
    place : ndarray of int, shape (n,)
        Where message records begin.
    heads : ndarray, shape (n,)
        What they begin with, `MESSAGE`.
    definitions : list of Definition
        Schemas and channels, in order.
    is_cut : bool
        The last record goes beyond the end.
    """

    place: IntArray
    heads: NDArray
    definitions: list[Definition]
    is_cut: bool


def find(chunk: bytes, index: Sequence[bytes]) -> RecordPlaces:
    """All messages, schemas and channels of a chunk.

    Parameters
    ----------
    chunk : bytes
        Its records.
    index : sequence of bytes
        Contents of the message index records behind it.
    """
    return _indexed(chunk, index) or _walked(chunk, 0, len(chunk))


def _indexed(chunk: bytes, index: Sequence[bytes]) -> RecordPlaces | None:
    """The same by the index; None unless each record begins where the one before ends."""
    try:
        entries = [np.frombuffer(content, "<u8", offset=INDEX.size) for content in index]
        place = np.sort(np.concatenate([each.reshape(-1, 2)[:, 1] for each in entries]))
    except ValueError:  # no index, or not of whole entries
        return None
    if not len(place) or place[-1] > len(chunk) - MESSAGE.itemsize:
        return None
    place = place.astype(np.int64)
    heads = _heads(chunk, place)
    length = heads["length"]
    if (heads["opcode"] != Opcode.MESSAGE).any() or (length < _SHORTEST).any() or (length > len(chunk)).any():
        return None
    starts = np.append(place, len(chunk))
    stops = np.concatenate([np.zeros(1, np.int64), place + HEAD.size + length.astype(np.int64)])
    gaps = np.flatnonzero(starts != stops)
    if len(gaps) > _MOST_GAPS or (stops > starts).any():
        return None
    definitions: list[Definition] = []
    for gap in gaps.tolist():
        between = _walked(chunk, int(stops[gap]), int(starts[gap]))
        if between.is_cut or len(between.place):
            return None
        definitions += between.definitions
    return RecordPlaces(place, heads, definitions, False)


def _walked(chunk: bytes, start: int, stop: int) -> RecordPlaces:
    places: list[int] = []
    definitions: list[Definition] = []
    is_cut, position = False, start
    head, message, last, add = HEAD.unpack_from, int(Opcode.MESSAGE), stop - HEAD.size, places.append
    while position <= last:
        opcode, length = head(chunk, position)
        end = position + HEAD.size + length
        if end > stop:
            is_cut = True
            break
        if opcode == message and length >= _SHORTEST:
            add(position)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(Definition(opcode, position + HEAD.size, end))
        position = end
    place = np.array(places, np.int64)
    return RecordPlaces(place, _heads(chunk, place), definitions, is_cut)


def _heads(chunk: bytes, place: IntArray) -> NDArray:
    return cut_out(chunk, place, MESSAGE.itemsize).reshape(-1).view(MESSAGE)
