"""ROS 2 messages (CDR, either byte order): a row a type, and one walk over all of them.

Why not a library: a MarkerArray takes 38 us here and 1,600 us by the libraries, which is 173 s for an hour of
an Azure Kinect.
"""

from __future__ import annotations

import re
import struct
from functools import cache, partial
from typing import Any

import numpy as np

from .layout import MessageLayout

#: Encapsulations of plain messages (DDS-XTypes 1.3, table 39): CDR, and XCDR2 of final types; widest
#: alignment and byte order.
_PLAIN = {b"\0\0": (8, ">"), b"\0\1": (8, "<"), b"\0\6": (4, ">"), b"\0\7": (4, "<")}

#: Fields in their order, up to the last that is read: NAME:KIND*COUNT, or KIND*COUNT of what is passed over.
#: Kinds are those of `struct`, `s` a string, `o` octets; `3d[]` is a sequence of structures of three doubles.
_HEADER = "sec:i nsec:I frame_id:s "
_SAMPLES = {
    "sensor_msgs/Imu": _HEADER + "d*13 gyro:d*3 d*9 acc:d*3",
    "sensor_msgs/MagneticField": _HEADER + "mag:d*3",
    "geometry_msgs/PoseStamped": _HEADER + "position:d*3 quaternion:d*4",
    "sensor_msgs/Image": _HEADER + "height:I width:I encoding:s big:B step:I data:o",
    "sensor_msgs/CompressedImage": _HEADER + "s data:o",
    "sensor_msgs/CameraInfo": _HEADER + "height:I width:I distortion_model:s D:d[] K:d*9",
}
_MARKER = _HEADER + "s id:i i action:i position:d*3 d*7 f*6 B 3d[] 4f[] "
_PLAIN_MARKER, _TEXTURED_MARKER = _MARKER + "s s B", _MARKER + "s i*2 s s B[] 2f[] s s s B[] B"
#: No marker is shorter, bytes.
_LEAST_MARKER = 100
_FIELD = re.compile(r"(?:(\w+):)?(\d*)(\w)(\[\])?(?:\*(\d+))?")


@cache
def _fields(row: str) -> list[tuple[str, int, str, bool, int]]:
    """Name, values in a structure, kind, whether it is a sequence, and count."""
    found = (_FIELD.fullmatch(field) for field in row.split())
    return [(m[1] or "", int(m[2] or 1), m[3], bool(m[4]), int(m[5] or 1)) for m in found if m is not None]


class _Walk:
    """Passes over one message and notes where its fields lie."""

    def __init__(self, data: bytes):
        if len(data) < 4 or bytes(data[:2]) not in _PLAIN:
            raise ValueError("not plain CDR")
        self.data, self.position = data, 4
        self.widest, self.order = _PLAIN[bytes(data[:2])]
        self.layout = MessageLayout.of(data)
        self.layout.fix(0, 2)

    def fields(self, row: str) -> None:
        """The fields of a row."""
        for name, width, kind, is_sequence, count in _fields(row):
            if kind in "so":
                self._text(name, kind)
                continue
            if is_sequence:
                count = width * self.length(structures=width > 1)
            size = struct.calcsize(kind)
            start = self._step(size, count) if count else self.position  # nothing is aligned for nothing
            if name:
                self.layout.add(name, start, f"{self.order}{kind}", count)

    def length(self, structures: bool) -> int:
        """Of a sequence or string, which decides the layout; in XCDR2 structures' size is before it."""
        if structures and self.widest == 4:
            self._step(4, 1)
        start = self._step(4, 1)
        self.layout.fix(start, start + 4)
        return int(struct.unpack_from(f"{self.order}I", self.data, start)[0])

    def _text(self, name: str, kind: str) -> None:
        """A string that is named decides the layout, so that it is the same for all rows; octets do not."""
        length = self.length(structures=False)
        start = self._step(1, length)
        if name and kind == "s":
            self.layout.fix(start, start + length)
            text = self.data[start : start + length].rstrip(b"\0")
            self.layout.texts[name] = text.decode("utf-8", "replace")
        elif name:
            self.layout.add(name, start, "u1", length)

    def _step(self, size: int, count: int) -> int:
        """Where aligned values begin, which are passed over."""
        start = self.position + -(self.position - 4) % min(size, self.widest)
        self.position = start + size * count
        if self.position > len(self.data):
            raise IndexError("message is cut off")
        return start


def walk(data: bytes, kind: str) -> MessageLayout:
    """Layout of a message of a type, such as `sensor_msgs/Imu`."""
    found = _Walk(data)
    found.fields(_SAMPLES[kind])
    return found.layout


def marker_array(data: bytes, textured: bool = True) -> MessageLayout:
    """Layout of visualization_msgs/MarkerArray: `sec`, `nsec`, `id`, `action`, `position` by marker."""
    found = _Walk(data)
    count = found.length(structures=True)
    if count * _LEAST_MARKER > len(data):
        raise ValueError("more markers than bytes for them")
    found.layout.counts["markers"] = count
    for _ in range(count):
        found.fields(_TEXTURED_MARKER if textured else _PLAIN_MARKER)
    if len(data) - found.position > 7:  # some writers pad the end
        raise ValueError("bytes left over")
    return found.layout


def markers_of(schema_data: bytes) -> partial[MessageLayout]:
    """The walk over markers as a file's schema has them: those of newer ROS have textures."""
    return partial(marker_array, textured=b"texture_resource" in schema_data or not schema_data)


def values_of(data: bytes, kind: str) -> dict[str, Any]:
    """Fields of one message by name: numbers (count,), octets and texts."""
    layout, block = walk(data, kind), np.frombuffer(data, np.uint8)[None]
    values = {name: layout.get(block, name)[0] for name in layout.fields}
    return values | layout.texts
