"""CDR messages byte by byte: as another library writes them, big-endian, XCDR2, and cut at every byte."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import ros_bags as ros
from mcap_ros2._dynamic import serialize_dynamic

from smoother.io.wire import cdr
from smoother.io.wire.layout import BROKEN, MessageLayout

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
IMU, FIELD, POSE = (
    partial(cdr.walk, kind=kind)
    for kind in ("sensor_msgs/Imu", "sensor_msgs/MagneticField", "geometry_msgs/PoseStamped")
)


@pytest.mark.parametrize("frame", ["", "x", "ab", "wrist_link", "K\u00e4mera", "12345678"])
@pytest.mark.parametrize(
    ("walk", "data", "expected"),
    [
        (IMU, imu, {"gyro": [0.1, 0.2, -0.3], "acc": [1.0, -2.0, 3.0]}),
        (FIELD, field, {"mag": [4.0, 5.0, 6.0]}),
        (POSE, pose, {"position": [7.0, 8.0, -9.0], "quaternion": [0.1, -0.2, 0.3, 0.9]}),
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
    body = struct.pack(order + "iII", -7, 5, 2) + b"f\0\0\0"
    body += bytes(-len(body) % widest) + struct.pack(order + "3d", 1.5, -2.0, 4e9)
    found = cdr.values_of(head + b"\0\0" + body, "sensor_msgs/MagneticField")
    assert (found["sec"], found["nsec"], found["frame_id"]) == (-7, 5, "f")
    assert found["mag"].tolist() == [1.5, -2.0, 4e9]
    odd = struct.pack(order + "iII", 1, 2, 3) + b"fr\0" + bytes(1) + struct.pack(order + "I", 4) + b"png\0"
    odd += struct.pack(order + "I", 2) + b"z\xff"
    image = cdr.values_of(head + b"\0\0" + odd, "sensor_msgs/CompressedImage")
    assert image["frame_id"] == "fr" and image["data"].tobytes() == b"z\xff"
    with pytest.raises(IndexError):
        cdr.values_of(head + b"\0\0" + odd[:-1], "sensor_msgs/CompressedImage")


@pytest.mark.parametrize("data", [b"", b"\0\1\0", b"\0\2\0\0rest", b"\1\1\0\0rest", b"\0\x0b\0\0rest"])
def test_other_encapsulations_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError):
        cdr.walk(data, "sensor_msgs/Imu")


def test_a_sequence_of_structures_in_xcdr2() -> None:
    """Its size in bytes stands before it; one of numbers has none; doubles begin at any fourth byte."""
    body = struct.pack("<i", 3) + struct.pack("<I", 1)  # sizes, then the count of the markers
    body += struct.pack("<iI", 1, 2) + struct.pack("<I", 2) + b"f\0" + bytes(2) + struct.pack("<I", 0)
    body += struct.pack("<3i", 41, 2, 0) + struct.pack("<10d", *range(10)) + struct.pack("<6f", *range(6))
    body += b"\1" + bytes(3) + struct.pack("<2I", 52, 2) + struct.pack("<6d", *range(6))
    body += struct.pack("<2I", 4, 0) + struct.pack("<2I", 0, 0) + b"\1"
    data = b"\0\7\0\0" + body
    layout = cdr.marker_array(data, textured=False)
    assert values(layout, data, "id") == [[41]] and values(layout, data, "position") == [[0.0, 1.0, 2.0]]
