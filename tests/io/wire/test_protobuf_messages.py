"""Protobuf messages read and written without the library, against the library; their schemas."""

from __future__ import annotations

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from smoother.io.wire import protobuf
from smoother.io.wire.layout import BROKEN, MessageLayout
from smoother.io.wire.schemas import message_class, schema_data

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
