"""Messages of one layout, decoded together.

Recorders write a stream's messages with the same fields, strings and lengths over and over. One
message of each kind is walked in Python; where the bytes that decide the layout agree, all others
are cut from it by numpy.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray

Block = NDArray[np.uint8]
#: Bytes as a file has them, or put together here.
Buffer = bytes | memoryview
#: Times in nanoseconds end in the year 2262; what lies beyond does not fit.
_LATEST_S = 9_000_000_000
#: What a walk over a message that is cut off or not of its schema may raise.
BROKEN = (struct.error, IndexError, ValueError, OverflowError)


@dataclass
class MessageLayout:
    """Where the fields of a message are."""

    mask: Block  # (size,): bits of each byte that must agree for the layout to hold
    want: Block  # (size,): their values
    # By name, the offsets of its occurrences, its dtype and the count of values in each
    fields: dict[str, tuple[list[int], np.dtype, int]] = field(default_factory=dict)
    varints: dict[str, tuple[int, int]] = field(default_factory=dict)  # By name, offset and width
    texts: dict[str, str] = field(default_factory=dict)  # Constant strings, by name
    counts: dict[str, int] = field(default_factory=dict)  # Lengths of sequences, by name

    @classmethod
    def of(cls, data: bytes) -> MessageLayout:
        """A layout for messages as long as `data`, with nothing fixed yet."""
        want = np.frombuffer(data, np.uint8)
        return cls(np.zeros(len(want), np.uint8), want)

    def fix(self, start: int, stop: int, bits: int = 0xFF) -> None:
        """Bytes that decide the layout."""
        self.mask[start:stop] |= np.uint8(bits)

    def add(self, name: str, offset: int, dtype: str, count: int) -> None:
        """One more occurrence of a field."""
        self.fields.setdefault(name, ([], np.dtype(dtype), count))[0].append(offset)

    def finish(self) -> None:
        """Keep only the bytes to be compared."""
        self._where = np.flatnonzero(self.mask)
        self._bits = self.mask[self._where]
        self._want = self.want[self._where] & self._bits

    def matches(self, block: Block) -> NDArray[np.bool_]:
        """Which rows of a block have this layout."""
        return ((block[:, self._where] & self._bits) == self._want).all(axis=1)

    def get(self, block: Block, name: str) -> NDArray:
        """Values (rows, count) of a field's first occurrence."""
        offsets, dtype, count = self.fields[name]
        return _cut(block, offsets[0], dtype, count)

    def many(self, block: Block, name: str) -> NDArray:
        """Values (rows, occurrences, count) of a field."""
        offsets, dtype, count = self.fields[name]
        return np.stack([_cut(block, offset, dtype, count) for offset in offsets], axis=1)

    def integer(self, block: Block, name: str) -> IntArray:
        """Values (rows,) of a varint; zero where the field is absent."""
        value = np.zeros(len(block), np.uint64)
        offset, width = self.varints.get(name, (0, 0))
        for place in range(width):
            value |= (block[:, offset + place] & np.uint8(0x7F)).astype(np.uint64) << np.uint64(7 * place)
        return value.view(np.int64)

    def stamps(self, block: Block, log_ns: IntArray) -> IntArray:
        """Stamps (rows,) of a ROS header or a protobuf `timestamp`, ns; log times where it is not set."""
        if "sec" in self.fields:
            whole, nanos = (self.get(block, name)[:, 0].astype(np.int64) for name in ("sec", "nsec"))
            stamp = whole * 1_000_000_000 + nanos
            return np.where(stamp == 0, log_ns, stamp)
        if not {"timestamp.seconds", "timestamp.nanos"} & self.varints.keys():
            return log_ns
        whole = np.clip(self.integer(block, "timestamp.seconds"), -_LATEST_S, _LATEST_S)
        return whole * 1_000_000_000 + self.integer(block, "timestamp.nanos")

    def vector(self, block: Block, names: Sequence[str]) -> NDArray[np.float64]:
        """Doubles (rows, names), zero where a field is absent (protobuf leaves zeros out)."""
        out = np.zeros((len(block), len(names)))
        for i, name in enumerate(names):
            if name in self.fields:
                out[:, i] = self.get(block, name)[:, 0]
        return out


@dataclass
class Grouper:
    """Sorts payloads by layout."""

    walk: Callable[[bytes], MessageLayout]  # Finds the layout of one message
    broken: int = 0  # Messages that could not be walked
    _known: dict[int, list[MessageLayout]] = field(default_factory=dict)

    def groups_in(
        self, data: Buffer, start: IntArray, stop: IntArray
    ) -> Iterator[tuple[IntArray, Block, MessageLayout]]:
        """Yield the indices of payloads of one layout, their bytes (rows, size), the layout.

        The payloads are in `data` from `start` to `stop`, (n,) each.
        """
        sizes = stop - start
        for size in np.unique(sizes).tolist():
            index = np.flatnonzero(sizes == size)
            yield from self._split(index, cut_out(data, start[index], size))

    def _split(self, index: IntArray, block: Block) -> Iterator[tuple[IntArray, Block, MessageLayout]]:
        known = self._known.setdefault(block.shape[1], [])
        for layout in tuple(known):
            if not len(index):
                return
            same = layout.matches(block)
            if same.all():
                yield index, block, layout
                return
            if same.any():
                yield index[same], block[same], layout
                index, block = index[~same], block[~same]
        while len(index):
            try:
                layout = self.walk(block[0].tobytes())
            except BROKEN:
                self.broken += 1
                index, block = index[1:], block[1:]
                continue
            layout.finish()
            if len(known) < 64:  # a stream without regularity must not be compared with itself for ever
                known.append(layout)
            same = layout.matches(block)
            yield index[same], block[same], layout
            index, block = index[~same], block[~same]


def axes(name: str, letters: str = "xyz") -> list[str]:
    """Names of the components of a vector or quaternion."""
    return [f"{name}.{letter}" for letter in letters]


def cut_out(data: Buffer, start: IntArray, size: int) -> Block:
    """Bytes (n, size) from where they start (n,)."""
    if not size or not len(start):
        return np.empty((len(start), size), np.uint8)
    # all runs of that many bytes, by their start: NumPy copies each as one item
    runs = np.ndarray((len(data) - size + 1,), f"V{size}", data, strides=(1,))
    return runs[start].view(np.uint8).reshape(len(start), size)


def _cut(block: Block, offset: int, dtype: np.dtype, count: int) -> NDArray:
    """Values (rows, count) that are in each row from a byte on, wherever that is."""
    shape, strides = (len(block), count), (block.strides[0], dtype.itemsize)
    return np.ndarray(shape, dtype, block, offset, strides).copy()
