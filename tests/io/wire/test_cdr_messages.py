"""CDR messages byte by byte: as another library writes them, big-endian, XCDR2, and cut at every byte."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import ros_bags as ros
from mcap_ros2._dynamic import serialize_dynamic

from smoother.io.wire import cdr
from smoother.io.wire.cdr import CdrReader, Cursor
from smoother.io.wire.layout import BROKEN, Grouper, MessageLayout

SEC, NANOSEC = 1_700_000_123, 456_789_012


def write(kind: str, definition: str, message: dict[str, Any]) -> bytes:
    return bytes(serialize_dynamic(kind, definition)[kind](message))


def values(layout: MessageLayout, data: bytes, name: str) -> list[list[float]]:
    """Of each occurrence of a field in the message."""
    rows = np.frombuffer(data, np.uint8)[None]
    return [list(each) for each in layout.many(rows, name)[0].tolist()]


def imu(frame: str) -> bytes:
    message = ros.imu_message(
        SEC * 10**9 + NANOSEC, frame, np.array([1.0, -2, 3]), np.array([0.1, 0.2, -0.3])
    )
    message["orientation_covariance"] = [float(k) for k in range(20, 29)]
    message["angular_velocity_covariance"] = [float(k) for k in range(30, 39)]
    return write("sensor_msgs/msg/Imu", ros.IMU, message)


def field(frame: str) -> bytes:
    message = {
        "header": ros.header(SEC * 10**9 + NANOSEC, frame),
        "magnetic_field": ros.xyz(np.array([4.0, 5, 6])),
    }
    return write(
        "sensor_msgs/msg/MagneticField", ros.FIELD, message | {"magnetic_field_covariance": [0.0] * 9}
    )


def pose(frame: str) -> bytes:
    turn = {"x": 0.1, "y": -0.2, "z": 0.3, "w": 0.9}
    place = {"position": ros.xyz(np.array([7.0, 8, -9])), "orientation": turn}
    message = {"header": ros.header(SEC * 10**9 + NANOSEC, frame), "pose": place}
    return write("geometry_msgs/msg/PoseStamped", ros.POSE, message)


Walk = Callable[[bytes], MessageLayout]


@pytest.mark.parametrize("frame", ["", "x", "ab", "wrist_link", "K\u00e4mera", "12345678"])
@pytest.mark.parametrize(
    ("walk", "data", "expected"),
    [
        (cdr.imu, imu, {"gyro": [0.1, 0.2, -0.3], "acc": [1.0, -2.0, 3.0]}),
        (cdr.magnetic_field, field, {"mag": [4.0, 5.0, 6.0]}),
        (cdr.pose_stamped, pose, {"position": [7.0, 8.0, -9.0], "quaternion": [0.1, -0.2, 0.3, 0.9]}),
    ],
)
def test_a_message_of_another_library(
    walk: Walk, data: Callable[[str], bytes], expected: dict[str, list[float]], frame: str
) -> None:
    raw = data(frame)
    layout = walk(raw)
    assert values(layout, raw, "sec") == [[SEC]] and values(layout, raw, "nsec") == [[NANOSEC]]
    for name, numbers in expected.items():
        assert values(layout, raw, name) == [numbers]
    assert layout.texts == {"frame_id": frame}


@pytest.mark.parametrize(
    ("walk", "data"), [(cdr.imu, imu), (cdr.magnetic_field, field), (cdr.pose_stamped, pose)]
)
def test_a_message_that_was_cut(walk: Walk, data: Callable[[str], bytes]) -> None:
    """Up to the last field that is read it is broken; what lies behind is not looked at."""
    raw = data("wrist")
    layout = walk(raw)
    end = max(offsets[-1] + dtype.itemsize * count for offsets, dtype, count in layout.fields.values())
    for size in range(end):
        with pytest.raises(BROKEN):
            walk(raw[:size])
    assert walk(raw[:end]).fields == layout.fields


def test_what_decides_the_layout() -> None:
    """The encapsulation, and a name's length and letters: nothing else."""
    raw = imu("wrist")
    layout = cdr.imu(raw)
    decisive = {0, 1, *range(12, 16), *range(16, 22)}  # behind a head of 4 bytes and two of 4
    assert set(np.flatnonzero(layout.mask).tolist()) == decisive
    assert (layout.mask[list(decisive)] == 0xFF).all()
    grouper = Grouper(cdr.imu)
    found = {
        layout.texts["frame_id"]: index.tolist()
        for index, _, layout in grouper.groups(
            [imu("left"), imu("rght"), imu("left"), b"\0\1\0\0short", imu("elbow")]
        )
    }
    assert found == {"left": [0, 2], "rght": [1], "elbow": [4]} and grouper.broken == 1


def big_marker(number: int, textured: bool) -> dict[str, Any]:
    """With a value in every field, odd lengths of strings, and sequences of all kinds."""
    made = ros.marker(SEC * 10**9 + number, 300 + number, np.array([1.0, 2, 3]) * number, action=number % 4)
    made["ns"] = "n" * number
    made["frame_locked"] = True
    made["points"] = [ros.xyz(np.arange(3.0) + k) for k in range(number)]
    made["colors"] = [{"r": 0.1, "g": 0.2, "b": 0.3, "a": 0.4}] * (3 - number % 4)
    made["text"], made["mesh_resource"] = "label" * number, "file:///mesh"
    made["mesh_use_embedded_materials"] = True
    made["texture_resource"] = "t" * number
    texture = {"header": ros.header(7, "camera"), "format": "png", "data": list(range(number))}
    made["texture"], made["uv_coordinates"] = texture, [{"u": 0.1, "v": 0.2}] * number
    made["mesh_file"] = {"filename": "m", "data": [1] * (2 * number + 1)}
    return made


@pytest.mark.parametrize("textured", [True, False])
@pytest.mark.parametrize("count", [0, 1, 3])
def test_markers_with_everything(textured: bool, count: int) -> None:
    message = {"markers": [big_marker(k + 1, textured) for k in range(count)]}
    raw = write("visualization_msgs/msg/MarkerArray", ros.marker_array(textured), message)
    layout = cdr.marker_array(raw, textured)
    assert layout.counts == {"markers": count}
    if count:
        numbers = range(1, count + 1)
        assert values(layout, raw, "id") == [[300 + k] for k in numbers]
        assert values(layout, raw, "action") == [[k % 4] for k in numbers]
        assert values(layout, raw, "position") == [[k, 2 * k, 3 * k] for k in numbers]
        assert values(layout, raw, "sec") == [[SEC]] * count
        assert values(layout, raw, "nsec") == [[k] for k in numbers]
        with pytest.raises(BROKEN):
            cdr.marker_array(raw, not textured)
        # the markers' own lengths decide the layout: another number of points is another one
        other = {"markers": [big_marker(k + 1, textured) | {"points": []} for k in range(count)]}
        changed = write("visualization_msgs/msg/MarkerArray", ros.marker_array(textured), other)
        padded = changed + bytes(max(0, len(raw) - len(changed)))
        layout.finish()
        assert not layout.matches(np.frombuffer(padded[: len(raw)], np.uint8)[None])[0]
    for size in range(4, len(raw)):
        with pytest.raises(BROKEN):
            cdr.marker_array(raw[:size], textured)


@pytest.mark.parametrize(
    ("head", "widest", "order"),
    [(b"\0\0", 8, ">"), (b"\0\1", 8, "<"), (b"\0\6", 4, ">"), (b"\0\7", 4, "<")],
)
def test_encapsulations(head: bytes, widest: int, order: str) -> None:
    """Alignment counts from behind the head; XCDR2 aligns doubles to four bytes."""
    reader = CdrReader(head + b"\0\0" + struct.pack(order + "b3xi", 5, -7) + b"x" * 4 + b"y" * 8)
    assert reader.number("b") == 5 and reader.position == 5
    assert reader.number("i") == -7 and reader.position == 12
    assert reader.values("d", 0) == () and reader.position == 12
    reader.number("b")
    reader.align(8)
    assert reader.position == (20 if widest == 8 else 16)
    reader.align(2)
    assert reader.position == (20 if widest == 8 else 16)
    numbers = CdrReader(head + b"\0\0" + struct.pack(order + "3d", 1.5, -2.0, 4e9))
    assert numbers.values("d", 3) == (1.5, -2.0, 4e9) and numbers.position == 28
    texts = CdrReader(
        head + b"\0\0" + struct.pack(order + "I", 4) + b"abc\0" + struct.pack(order + "I", 2) + b"z\xff"
    )
    assert texts.text() == "abc" and texts.position == 12
    assert texts.octets() == b"z\xff" and texts.position == 18
    with pytest.raises(IndexError):
        CdrReader(head + b"\0\0" + struct.pack(order + "I", 3) + b"ab").octets()


@pytest.mark.parametrize("data", [b"", b"\0\1\0", b"\0\2\0\0rest", b"\1\1\0\0rest", b"\0\x0b\0\0rest"])
def test_other_encapsulations_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        CdrReader(data)
    assert CdrReader(b"\0\1\0\0").position == 4


def test_a_sequence_of_structures_in_xcdr2() -> None:
    """Its size in bytes stands before it; one of numbers has none; doubles begin at any fourth byte."""
    body = struct.pack("<i", 1)  # sec
    body += struct.pack("<I", 2) + struct.pack("<I", 2) + b"f\0" + b"\0\0"
    body += struct.pack("<I", 52) + struct.pack("<I", 2) + struct.pack("<6d", *range(6))
    body += struct.pack("<I", 3) + b"abc\0" + struct.pack("<d", 2.5)
    cursor = Cursor(b"\0\7\0\0" + body)
    cursor.header()
    cursor.align(4)
    cursor.sequence(8, 3)
    cursor.sequence(1, 1)
    cursor.field("end", "f8")
    assert values(cursor.layout, b"\0\7\0\0" + body, "end") == [[2.5]]
    assert cursor.position == len(body) + 4
    assert cursor.layout.fields["sec"][0] == [4] and cursor.layout.texts == {"frame_id": "f"}
