"""Layouts of the ROS 2 messages that are read (CDR, either byte order).

Why not a library: a MarkerArray takes 38 us here and 1,600 us by the libraries, which is 173 s for an hour of
an Azure Kinect.
"""

from __future__ import annotations

import struct

from .layout import MessageLayout

#: Encapsulations of plain messages (DDS-XTypes 1.3, table 39): CDR, and XCDR2 of final types; widest
#: alignment and byte order.
_PLAIN = {b"\0\0": (8, ">"), b"\0\1": (8, "<"), b"\0\6": (4, ">"), b"\0\7": (4, "<")}


class CdrReader:
    """Reads a CDR or XCDR2 message value by value."""

    def __init__(self, data: bytes):
        if len(data) < 4 or bytes(data[:2]) not in _PLAIN:
            raise ValueError("not plain CDR")
        self.data = data
        self.position = 4
        self.widest, self.order = _PLAIN[bytes(data[:2])]

    def align(self, size: int) -> None:
        """Move to the next multiple of `size`, or of the widest alignment."""
        self.position += -(self.position - 4) % min(size, self.widest)

    def values(self, kind: str, count: int) -> tuple[float, ...]:
        """A count of numbers of a `struct` kind; nothing is aligned where there are none."""
        if not count:
            return ()
        size = struct.calcsize(kind)
        self.align(size)
        numbers = struct.unpack_from(f"{self.order}{count}{kind}", self.data, self.position)
        self.position += size * count
        return numbers

    def number(self, kind: str) -> int:
        """One integer of a `struct` kind."""
        return int(self.values(kind, 1)[0])

    def octets(self) -> bytes:
        """A sequence of bytes."""
        size = self.number("I")
        if self.position + size > len(self.data):
            raise IndexError("message is cut off")
        self.position += size
        return self.data[self.position - size : self.position]

    def text(self) -> str:
        """A string."""
        return self.octets().rstrip(b"\0").decode("utf-8", "replace")


class Cursor(CdrReader):
    """Walks over one CDR message and notes where its fields lie."""

    def __init__(self, data: bytes):
        super().__init__(data)
        self.layout = MessageLayout.of(data)
        self.layout.fix(0, 2)

    def skip(self, size: int, count: int = 1) -> None:
        """Pass over values; nothing is aligned where there are none."""
        if count:
            self.align(size)
            self.position += size * count
            self._check()

    def field(self, name: str, kind: str, count: int = 1) -> None:
        """Note `count` values of a numpy type (`i4`, `u4`, `f8`)."""
        size = int(kind[1:])
        self.align(size)
        self.layout.add(name, self.position, self.order + kind, count)
        self.position += size * count
        self._check()

    def length(self) -> int:
        """A sequence's or string's length, which decides the layout."""
        self.align(4)
        (value,) = struct.unpack_from(f"{self.order}I", self.data, self.position)
        self.layout.fix(self.position, self.position + 4)
        self.position += 4
        return int(value)

    def text(self, name: str = "") -> str:
        """A string; one that is named decides the layout, so that it is the same for all rows."""
        length = self.length()
        start, self.position = self.position, self.position + length
        self._check()
        if not name:
            return ""
        self.layout.fix(start, self.position)
        self.layout.texts[name] = self.data[start : self.position].rstrip(b"\0").decode("utf-8", "replace")
        return self.layout.texts[name]

    def header(self, frame: str = "frame_id") -> None:
        """A std_msgs/Header."""
        self.field("sec", "i4")
        self.field("nsec", "u4")
        self.text(frame)

    def structures(self) -> int:
        """Length of a sequence of structures."""
        if self.widest == 4:
            self.skip(4)  # its size in bytes
        return self.length()

    def sequence(self, size: int, values: int) -> None:
        """A sequence of elements of `values` numbers of `size` bytes (more than one: structures)."""
        self.skip(size, (self.structures() if values > 1 else self.length()) * values)

    def _check(self) -> None:
        if self.position > len(self.data):
            raise IndexError("message is cut off")


def imu(data: bytes) -> MessageLayout:
    """Layout of sensor_msgs/msg/Imu: `sec`, `nsec`, `gyro`, `acc`."""
    cursor = Cursor(data)
    cursor.header()
    cursor.skip(8, 4 + 9)
    cursor.field("gyro", "f8", 3)
    cursor.skip(8, 9)
    cursor.field("acc", "f8", 3)
    return cursor.layout


def magnetic_field(data: bytes) -> MessageLayout:
    """Layout of sensor_msgs/msg/MagneticField: `sec`, `nsec`, `mag`."""
    cursor = Cursor(data)
    cursor.header()
    cursor.field("mag", "f8", 3)
    return cursor.layout


def pose_stamped(data: bytes) -> MessageLayout:
    """Layout of geometry_msgs/msg/PoseStamped: `sec`, `nsec`, `position`, `quaternion` (x, y, z, w)."""
    cursor = Cursor(data)
    cursor.header()
    cursor.field("position", "f8", 3)
    cursor.field("quaternion", "f8", 4)
    return cursor.layout


def marker_array(data: bytes, textured: bool = True) -> MessageLayout:
    """Layout of visualization_msgs/msg/MarkerArray: `sec`, `nsec`, `id`, `action`, `position` by marker."""
    cursor = Cursor(data)
    count = cursor.structures()
    if count * 100 > len(data):
        raise ValueError("more markers than bytes for them")
    cursor.layout.counts["markers"] = count
    for _ in range(count):
        cursor.header()
        cursor.text()
        cursor.field("id", "i4")
        cursor.skip(4)
        cursor.field("action", "i4")
        cursor.field("position", "f8", 3)
        cursor.skip(8, 4 + 3)
        cursor.skip(4, 4 + 2)
        cursor.skip(1)
        cursor.sequence(8, 3)
        cursor.sequence(4, 4)
        if textured:
            cursor.text()
            cursor.skip(4, 2)
            cursor.text()
            cursor.text()
            cursor.sequence(1, 1)
            cursor.sequence(4, 2)
        cursor.text()
        cursor.text()
        if textured:
            cursor.text()
            cursor.sequence(1, 1)
        cursor.skip(1)
    if len(data) - cursor.position > 7:  # some writers pad the end
        raise ValueError("bytes left over")
    return cursor.layout
