"""Messages as bytes: CDR against another library, protobuf against Google's, layouts and groups; schemas."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
import ros_bags as ros
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap_messages import groups
from mcap_ros2._dynamic import serialize_dynamic

from smoother.io.wire import cdr, protobuf
from smoother.io.wire.layout import BROKEN, Grouper, MessageLayout
from smoother.io.wire.schemas import message_class, schema_data

SEC, NANOSEC = 1_700_000_123, 456_789_012


def write(kind: str, definition: str, message: dict[str, Any]) -> bytes:
    return bytes(serialize_dynamic(kind, definition)[kind](message))


def values(layout: MessageLayout, data: bytes, name: str) -> list[list[float]]:
    """Of each occurrence of a field in the message."""
    rows = np.frombuffer(data, np.uint8)[None]
    return [list(each) for each in layout.many(rows, name)[0].tolist()]


def samples(frame: str) -> dict[str, tuple[str, dict[str, Any], dict[str, list[float]]]]:
    """By type its definition, a message, and what is read of it."""
    head, place = {"header": ros.header(SEC * 10**9 + NANOSEC, frame)}, {"x": 7.0, "y": 8.0, "z": -9.0}
    imu = ros.imu_message(SEC * 10**9 + NANOSEC, frame, np.array([1.0, -2, 3]), np.array([0.1, 0.2, -0.3]))
    imu["orientation_covariance"] = [float(k) for k in range(20, 29)]
    field = head | {"magnetic_field": place, "magnetic_field_covariance": [0.0] * 9}
    pose = head | {"pose": {"position": place, "orientation": {"x": 0.1, "y": -0.2, "z": 0.3, "w": 0.9}}}
    return {
        "sensor_msgs/Imu": (ros.IMU, imu, {"gyro": [0.1, 0.2, -0.3], "acc": [1.0, -2.0, 3.0]}),
        "sensor_msgs/MagneticField": (ros.FIELD, field, {"mag": [7.0, 8.0, -9.0]}),
        "geometry_msgs/PoseStamped": (
            ros.POSE,
            pose,
            {"position": [7.0, 8.0, -9.0], "quaternion": [0.1, -0.2, 0.3, 0.9]},
        ),
    }


@pytest.mark.parametrize("frame", ["", "x", "ab", "wrist_link", "K\u00e4mera", "12345678"])
@pytest.mark.parametrize("kind", samples(""))
def test_a_message_of_another_library(kind: str, frame: str) -> None:
    definition, message, expected = samples(frame)[kind]
    raw = write(kind.replace("/", "/msg/"), definition, message)
    layout = cdr.walk(raw, kind)
    for name, numbers in {"sec": [SEC], "nsec": [NANOSEC], **expected}.items():
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


def walk(data: bytes) -> MessageLayout:
    """The first byte decides; one that is zero cannot be walked."""
    if data[0] == 0:
        raise ValueError("no message")
    layout = MessageLayout.of(data)
    layout.fix(0, 1)
    layout.counts["kind"] = data[0]
    return layout


def test_groups_hold_every_message_once() -> None:
    rng = np.random.default_rng(0)
    payloads = [
        bytes([int(rng.integers(0, 4))]) + bytes(rng.integers(0, 256, int(rng.integers(0, 3))).tolist())
        for _ in range(300)
    ]
    grouper = Grouper(walk)
    assert grouper.broken == 0
    for _ in range(2):  # the second time all layouts are known
        grouper.broken = 0
        found = list(groups(grouper, payloads))
        keys = [(block.shape[1], layout.counts["kind"]) for _, block, layout in found]
        assert len(keys) == len(set(keys)) == 9
        indices = [i for index, _, _ in found for i in index.tolist()]
        broken = [i for i, each in enumerate(payloads) if each[0] == 0]
        assert sorted(indices + broken) == list(range(300)) and len(set(indices)) == len(indices)
        assert grouper.broken == len(broken)
        for index, block, layout in found:
            for i, row in zip(index.tolist(), block, strict=True):
                assert row.tobytes() == payloads[i] and payloads[i][0] == layout.counts["kind"]


Skeleton, Imu = message_class("unocclude.Skeleton"), message_class("unocclude.Imu")


def skeleton(joints: int = 2) -> bytes:
    message = Skeleton(frame_id="K\u00e4mera", body=300, occluded=True)
    message.timestamp.FromNanoseconds(1_700_000_000_123_456_789)
    for k in range(joints):
        joint = message.joints.add(name=f"j{k}", state=k + 1, confidence=0.25 * (k + 1))
        joint.position.x, joint.position.z = 1.5 + k, -2.0
        if k:
            joint.position_covariance.extend(range(9))
    return bytes(message.SerializeToString())


def one(layout: MessageLayout, data: bytes, name: str) -> list[float]:
    return list(layout.get(np.frombuffer(data, np.uint8)[None], name)[0].tolist())


def test_every_cut_is_noticed() -> None:
    raw = skeleton()
    # at the end of a field of the message itself a shorter message is whole
    whole = {0}
    message = Skeleton.FromString(raw)
    for name in ("occluded", "joints", "joints", "body", "frame_id"):
        if name == "joints":
            del message.joints[-1]
        else:
            message.ClearField(name)
        whole.add(len(message.SerializeToString()))
    for size in range(len(raw)):
        if size in whole:
            protobuf.walk(raw[:size], Skeleton)
        else:
            with pytest.raises(BROKEN):
                protobuf.walk(raw[:size], Skeleton)


@pytest.mark.parametrize(
    "raw",
    [
        b"\x18" + b"\x80" * 10 + b"\x01",  # a varint of eleven bytes
        b"\x1a\x08\x09" + bytes(8),  # a double whose last byte lies behind the end of its message
        *(bytes([15 << 3 | kind, 0]) for kind in (3, 4, 6, 7)),  # wire types that are no more
    ],
)
def test_what_is_no_protobuf(raw: bytes) -> None:
    with pytest.raises(BROKEN):
        protobuf.walk(raw, Imu)


@pytest.mark.parametrize(
    ("stamp", "expected"),
    [
        (b"\x0a\x00", 77),  # a stamp that was never set: the log time
        (b"\x0a\x02\x08\x00", 0),  # a zero that is spelled out
        (b"\x0a\x02\x10\x05", 5),
        (b"\x0a\x02\x08\x03", 3_000_000_000),
        (b"\x0a\x0d\x08" + b"\xff" * 9 + b"\x01\x10\x05", -999_999_995),
        (b"\x0a\x0b\x08" + b"\xff" * 8 + b"\x7f", 9_000_000_000 * 10**9),
    ],
)
def test_stamps(stamp: bytes, expected: int) -> None:
    stamp = bytes([stamp[0], len(stamp) - 2]) + stamp[2:]
    layout = protobuf.walk(stamp, Imu)
    assert layout.stamps(np.frombuffer(stamp, np.uint8)[None], np.array([77])).tolist() == [expected]


# -- written ------------------------------------------------------------------------------------------------


def test_a_skeleton_as_the_library_reads_it() -> None:
    """Zeros, which the library leaves out, and numbers of any size in one layout."""
    rng = np.random.default_rng(0)
    stamps = np.array([1_700_000_000_123_456_789, -1, 0, -1_500_000_001, 2**62])
    position, covariance = rng.normal(size=(5, 3)), rng.normal(size=(5, 9))
    position[2] = 0.0
    confidence, state, occluded = rng.uniform(size=5), np.array([0, 1, 2, 3, 127]), np.arange(5) % 2 == 0
    names = ("wrist", "", "hand")
    constants = {"frame_id": "K\u00e4mera" * 30, "body": 70_000, "joints": [{"name": name} for name in names]}
    constants["joints"][1]["position"] = {"x": 1.0, "y": -2.0}
    columns = {"timestamp": stamps, "occluded": occluded, "joints.0.position": position}
    columns |= {"joints.0.state": state, "joints.0.position_covariance": covariance}
    columns |= {"joints.2.confidence": confidence, "joints.2.position": position[:, [2, 0, 1]]}
    block = protobuf.Encoder("unocclude.Skeleton", constants)(columns)
    assert block.dtype == np.uint8 and len(block) == 5
    for k, raw in enumerate(row.tobytes() for row in block):
        message = Skeleton.FromString(raw)
        seconds, nanos = divmod(int(stamps[k]), 10**9)
        assert (message.timestamp.seconds, message.timestamp.nanos) == (seconds, nanos)
        assert message.frame_id == "K\u00e4mera" * 30 and message.body == 70_000
        wrist, bare, hand = message.joints
        assert [joint.name for joint in message.joints] == list(names)
        assert [wrist.position.x, wrist.position.y, wrist.position.z] == position[k].tolist()
        assert wrist.state == state[k] and list(wrist.position_covariance) == covariance[k].tolist()
        assert [hand.position.x, hand.position.y] == position[k, [2, 0]].tolist()
        assert hand.confidence == confidence[k] and message.occluded == occluded[k]
        assert [bare.position.x, bare.position.y, bare.position.z] == [1.0, -2.0, 0.0]
        # what we write we read
        layout = protobuf.walk(raw, Skeleton)
        assert layout.counts == {"joints": 3}
        assert one(layout, raw, "joints.0.position_covariance") == covariance[k].tolist()
        if abs(int(stamps[k])) < 2**61:
            stamp = layout.stamps(np.frombuffer(raw, np.uint8)[None], np.array([0]))
            assert stamp[0] == stamps[k]


def test_bytes_and_elements_of_a_list() -> None:
    data, at = np.arange(12, dtype=np.uint8).reshape(3, 4), np.array([0, 1, 2])
    for k, row in enumerate(protobuf.Encoder("foxglove.PointCloud", {"point_stride": 4})({"data": data})):
        assert message_class("foxglove.PointCloud").FromString(row.tobytes()).data == data[k].tobytes()
    constants = {"entities": [{"lines": [{"points": [{}, {}]}]}]}
    points = {"entities.0.timestamp": at, "entities.0.lines.0.points.1": np.arange(9.0).reshape(3, 3)}
    for k, row in enumerate(protobuf.Encoder("foxglove.SceneUpdate", constants)(points)):
        entity = message_class("foxglove.SceneUpdate").FromString(row.tobytes()).entities[0]
        first, last = entity.lines[0].points
        assert entity.timestamp.nanos == k and (first.x, last.x, last.z) == (0.0, 3.0 * k, 3.0 * k + 2.0)


# -- schemas ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["foxglove.SceneUpdate", "unocclude.Skeleton"])
def test_a_schema_names_each_file_once_and_its_needs_first(name: str) -> None:
    data = schema_data(name)
    files = FileDescriptorSet.FromString(data).file
    names = [file.name for file in files]
    assert len(names) == len(set(names)) and names[-1] == message_class(name).DESCRIPTOR.file.name
    for k, file in enumerate(files):
        assert set(file.dependency) <= set(names[:k])
