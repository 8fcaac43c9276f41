"""Layout of a protobuf message, found from its descriptor."""

from __future__ import annotations

import struct
from typing import Any

from .layout import MessageLayout


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
