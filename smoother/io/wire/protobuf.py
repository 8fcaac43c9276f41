"""Protobuf messages of one layout: found from its descriptor, and encoded where their numbers alone differ.

One message is built by the library, its layout is walked, and the columns of all rows are put where its
numbers are: 0.2 s for 360,000 poses with their covariances, against 10 s by the library.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from .layout import MessageLayout
from .schemas import message_class


def walk(data: bytes, message: Any) -> MessageLayout:
    """Layout of one message."""
    layout = MessageLayout.of(data)
    _walk(data, 0, len(data), message.DESCRIPTOR, "", layout)
    return layout


def _walk(data: bytes, position: int, stop: int, descriptor: Any, path: str, layout: MessageLayout) -> None:
    fields = descriptor.fields_by_number
    while position < stop:
        start = position
        key, position = _varint(data, position)
        layout.fix(start, position)
        field, kind = fields.get(key >> 3), key & 7
        name = path + field.name if field is not None else ""
        if kind == 0:
            _, end = _varint(data, position)
            layout.fix(position, end, 0x80)
            if name:
                layout.varints[name] = (position, end - position)
            position = end
        elif kind == 1:
            if name:
                layout.add(name, position, "<f8", 1)
            position += 8
        elif kind == 5:
            position += 4
        elif kind == 2:
            start = position
            length, position = _varint(data, position)
            layout.fix(start, position)
            end = position + length
            if end > stop:
                raise IndexError("message is cut off")
            if name:
                _bytes(data, position, end, field, name, layout)
            position = end
        else:
            raise ValueError("not a protobuf message")
    if position > stop:
        raise IndexError("message is cut off")


def _bytes(data: bytes, start: int, end: int, field: Any, name: str, layout: MessageLayout) -> None:
    if field.message_type is not None:
        if field.is_repeated:
            index = layout.counts.get(name, 0)
            layout.counts[name] = index + 1
            name = f"{name}.{index}"
        _walk(data, start, end, field.message_type, name + ".", layout)
    elif field.type == field.TYPE_STRING:
        layout.fix(start, end)
        layout.texts[name] = data[start:end].decode("utf-8", "replace")
    elif field.type == field.TYPE_BYTES:
        layout.add(name, start, "u1", end - start)
    elif field.type == field.TYPE_DOUBLE and (end - start) % 8 == 0 and end > start:
        layout.add(name, start, "<f8", (end - start) // 8)


def _varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        value |= (byte & 0x7F) << shift
        position += 1
        if byte < 0x80:
            return value, position
        shift += 7
        if shift > 63:
            raise struct.error("varint is too long")


#: A stamp whose varints are as wide as they get: any 64-bit number, any 32-bit number.
_WIDE = {"seconds": -1, "nanos": 1 << 30}


class Encoder:
    """Encodes messages of one schema with the same constant fields and the same columns."""

    def __init__(self, schema: str, constants: Mapping[str, Any]) -> None:
        self._message = message_class(schema)(**constants)
        self._numbers: dict[str, list[str]] = {}  # by a column's path, those of its numbers
        self._layout: MessageLayout | None = None

    def __call__(self, columns: Mapping[str, NDArray]) -> NDArray[np.uint8]:
        """Wire form (rows, size) of a message a row; enums and whole numbers are below 128.

        Columns by path (`joints.0.position`): stamps (rows,) ns, numbers (rows,), bytes or doubles (rows, n),
        and vectors and quaternions (rows, n) in the order of their fields.
        """
        if self._layout is None:
            self._numbers = {path: self._place(path, values) for path, values in columns.items()}
            data = self._message.SerializeToString(deterministic=True)
            self._layout = walk(data, type(self._message))
        layout, rows = self._layout, len(next(iter(columns.values())))
        block = np.empty((rows, len(layout.want)), np.uint8)
        block[:] = layout.want
        for path, values in columns.items():
            names = self._numbers[path]
            if names == [path]:
                parts = [values]
            else:
                is_stamp = names[0].endswith(".seconds")
                parts = list(np.divmod(values, 1_000_000_000) if is_stamp else values.T)
            for name, part in zip(names, parts, strict=True):
                if name in layout.varints:
                    offset, width = layout.varints[name]
                    block[:, offset : offset + width] = _padded_varints(part, width)
                else:
                    (offset,), dtype, count = layout.fields[name]
                    raw = np.ascontiguousarray(part.reshape(rows, count), dtype).view(np.uint8)
                    block[:, offset : offset + raw.shape[1]] = raw
        return block

    def _place(self, path: str, values: NDArray) -> list[str]:
        """Give the fields a value, as zeros are left out; the paths of the numbers."""
        *way, last = path.split(".")
        message = self._message
        for step in way:
            message = message[int(step)] if step.isdigit() else getattr(message, step)
        own = message[int(last)] if last.isdigit() else getattr(message, last)
        if hasattr(own, "DESCRIPTOR"):
            names = [part.name for part in own.DESCRIPTOR.fields]
            wide = (
                _WIDE if own.DESCRIPTOR.name == "Timestamp" else dict.fromkeys(names[: values.shape[-1]], 1.0)
            )
            for name, value in wide.items():
                setattr(own, name, value)
            return [f"{path}.{name}" for name in wide]
        if values.ndim == 1:
            setattr(message, last, 1)
        elif isinstance(own, bytes):
            setattr(message, last, b"\1" * values.shape[1])
        else:
            own[:] = [1.0] * values.shape[1]
        return [path]


def _padded_varints(values: NDArray, width: int) -> NDArray[np.uint8]:
    """Numbers (rows,) as varints of one width, (rows, width): seven bits a byte, all but the last marked."""
    sevens = np.arange(0, 7 * width, 7).astype(np.uint64)[:, None]
    raw = (values.astype(np.int64).view(np.uint64) >> sevens).astype(np.uint8) | np.uint8(0x80)
    raw[-1] &= 0x7F
    return raw.T


def alike(codes: NDArray) -> Iterator[tuple[tuple[int, ...], IntArray]]:
    """Rows (n, k) of small whole numbers that are the same: what they are, and which rows (m,)."""
    codes = np.asarray(codes, np.int64)
    if not len(codes):
        return
    lowest, base = codes.min(), np.ptp(codes) + 1
    key = (codes - lowest) @ base ** np.arange(codes.shape[1])[::-1]
    _, first, kind = np.unique(key, return_index=True, return_inverse=True)
    order = np.argsort(kind, kind="stable")
    for number, rows in enumerate(np.split(order, np.cumsum(np.bincount(kind))[:-1])):
        yield tuple(codes[first[number]].tolist()), rows
