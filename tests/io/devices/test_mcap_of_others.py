"""MCAP with JSON and XCDR2 messages."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ros_bags as ros
import skeleton_files as made
from made_recordings import swing
from mcap.writer import Writer
from numpy.testing import assert_array_equal
from other_recordings import read, turning

from smoother.errors import RecordingError
from smoother.io import open_recording
from smoother.io.recording.json_messages import stamp_ns
from smoother.io.tables.joint_columns import AZURE
from smoother.recording import JointState

FRAMES = 60
ZERO = 1_700_000_000 * 10**9


def json_mcap(path: Path, dates: bool) -> tuple[np.ndarray, np.ndarray]:
    """An MCAP file with JSON messages of an IMU and a skeleton; acc (n, 3) and wrist (F, 3)."""
    t = np.arange(0, 4, 0.01)
    gyro = swing(t)[2]
    frames = np.arange(0.005, 4, 1 / 30)
    elbow, wrist, _ = swing(frames)
    acc = np.tile([0.1, 9.8, 0.2], (len(t), 1))

    def stamp(ns: int) -> Any:
        day = np.datetime64(ns, "ns").astype(str)
        return f"{day}Z" if dates else {"sec": ns // 10**9, "nsec": ns % 10**9}

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {}
        for topic, name in (("/imu", "sensor_msgs/Imu"), ("/skeleton", "unocclude.Skeleton")):
            schema = writer.register_schema(name=name, encoding="jsonschema", data=b'{"type": "object"}')
            channels[topic] = writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
        events = [(int(ZERO + round(x * 1e9)), "/imu", at) for at, x in enumerate(t)]
        events += [(int(ZERO + round(x * 1e9)), "/skeleton", at) for at, x in enumerate(frames)]
        for ns, topic, at in sorted(events):
            xyz = dict(zip("xyz", map(float, acc[at]), strict=True))
            if topic == "/imu":
                turn = dict(zip("xyz", map(float, gyro[at]), strict=True))
                where = {"stamp": stamp(ns), "frame_id": "wrist"}
                message: dict[str, Any] = {
                    "header": where,
                    "linear_acceleration": xyz,
                    "angular_velocity": turn,
                }
            else:
                joints = [
                    {
                        "name": f"{name}_right",
                        "position": dict(zip("xyz", map(float, rows[at]), strict=True)),
                        "state": s,
                    }
                    for name, rows, s in (("elbow", elbow, 2), ("wrist", wrist, "TRACKED"))
                ]
                message = {"timestamp": stamp(ns), "body": 1, "joints": joints}
            data = json.dumps(message).encode() if at != 7 else b'{"header": 3'  # one message is damaged
            writer.add_message(channels[topic], log_time=ns + 10**6, data=data, publish_time=ns)
        writer.finish()
    return np.delete(acc, 7, axis=0), np.delete(wrist, 7, axis=0)


@pytest.mark.parametrize("dates", [True, False])
def test_mcap_with_json(tmp_path: Path, dates: bool) -> None:
    path = tmp_path / "a.mcap"
    acc, wrist = json_mcap(path, dates)
    file = open_recording(path)
    assert_array_equal(file.imus[0].acc, acc)
    assert file.imus[0].stamp_ns[1] - file.imus[0].stamp_ns[0] == 10_000_000
    assert file.imus[0].log_shift_ns == 10**6
    assert sum("1 messages are damaged" in note for note in file.notes) == 2
    (body,), (imu,) = read(path, "mcap")
    assert imu.name == "imu"
    assert_array_equal(body.position["wrist_right"], wrist)
    assert (body.state["elbow_right"] == JointState.TRACKED).all()


@pytest.mark.parametrize(
    ("message", "wanted"),
    [
        ({"header": {"stamp": {"sec": 2, "nanosec": 5}}}, 2_000_000_005),
        ({"header": {"stamp": {"secs": 2, "nsecs": 5}}}, 2_000_000_005),
        ({"timestamp": "1970-01-01T00:00:02.5Z"}, 2_500_000_000),
        ({"timestamp": 2.5}, 2_500_000_000),
        ({}, 0),
    ],
)
def test_stamps_in_json(message: dict[str, Any], wanted: int) -> None:
    assert stamp_ns(message) == wanted


class Xcdr2:
    """Packs a message by XCDR2's rules for final types (DDS-XTypes 1.3, 7.4.3.5): 4 bytes align at most."""

    def __init__(self, order: str):
        self.order, self.data = order, bytearray()

    def number(self, kind: str, *values: float) -> None:
        size = min(struct.calcsize(kind), 4)
        self.data += bytes(-len(self.data) % size)
        self.data += struct.pack(f"{self.order}{len(values)}{kind}", *values)

    def text(self, value: str) -> None:
        self.number("I", len(value) + 1)
        self.data += value.encode() + b"\0"

    def header(self, ns: int, frame: str) -> None:
        self.number("i", ns // 10**9)
        self.number("I", ns % 10**9)
        self.text(frame)

    def whole(self) -> bytes:
        return (b"\0\7\0\0" if self.order == "<" else b"\0\6\0\0") + bytes(self.data)


def xcdr2_imu(ns: int, acc: np.ndarray, gyro: np.ndarray, order: str) -> bytes:
    pack = Xcdr2(order)
    pack.header(ns, "wrist")
    pack.number("d", 0, 0, 0, 1, *[0] * 9)
    pack.number("d", *gyro, *[0] * 9)
    pack.number("d", *acc, *[0] * 9)
    return pack.whole()


def xcdr2_markers(ns: int, points: np.ndarray, order: str) -> bytes:
    pack = Xcdr2(order)
    inner = Xcdr2(order)
    inner.data += bytes(4)  # as if behind the size, so that alignment is the message's
    inner.number("I", len(points))
    for joint, xyz in enumerate(points):
        inner.header(ns, "depth")
        inner.text("")
        inner.number("i", 100 + joint, 2, 0)
        inner.number("d", *xyz, 0, 0, 0, 1, 1, 1, 1)
        inner.number("f", 1, 1, 1, 1)
        inner.number("i", 0)
        inner.number("I", 0)
        inner.number("B", 0)
        for _ in range(2):  # sequences of structures: their size, then how many
            inner.number("I", 4)
            inner.number("I", 0)
        inner.text("")
        inner.text("")
        inner.number("B", 0)
    pack.number("I", len(inner.data) - 4)
    pack.data += inner.data[4:]
    return pack.whole()


@pytest.mark.parametrize("order", ["<", ">"])
def test_mcap_with_xcdr2(tmp_path: Path, order: str) -> None:
    t, acc, gyro = turning(200, 100.0)
    points = np.stack([made.optical(made.part(name, FRAMES)) for name in AZURE], axis=1)
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        kinds = {
            "/imu": ("sensor_msgs/msg/Imu", ros.IMU),
            "/body": ("visualization_msgs/msg/MarkerArray", ros.marker_array(False)),
        }
        channels = {}
        for topic, (name, text) in kinds.items():
            schema = writer.register_schema(name=name, encoding="ros2msg", data=text.encode())
            channels[topic] = writer.register_channel(topic=topic, message_encoding="cdr", schema_id=schema)
        for at in range(len(t)):
            ns = ZERO + round(t[at] * 1e9)
            writer.add_message(channels["/imu"], ns, xcdr2_imu(ns, acc[at], gyro[at], order), ns)
        for at in range(FRAMES):
            ns = ZERO + round(at / 30 * 1e9)
            writer.add_message(channels["/body"], ns, xcdr2_markers(ns, points[at], order), ns)
        writer.finish()
    (body,), (imu,) = read(path, "mcap")
    assert_array_equal(imu.acc, acc)
    assert_array_equal(imu.gyro, gyro)
    assert_array_equal(body.position["wrist_left"], points[:, AZURE.index("WRIST_LEFT")])
    assert body.body == 1


def test_mcap_with_joint_states_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(name="sensor_msgs/msg/JointState", encoding="ros2msg", data=b"")
        channel = writer.register_channel(topic="/joint_states", message_encoding="cdr", schema_id=schema)
        writer.add_message(channel, ZERO, b"\0\1\0\0", ZERO)
        writer.finish()
    with pytest.raises(
        RecordingError, match=r"a\.mcap has no IMU and no skeleton.*sensor_msgs/msg/JointState"
    ):
        read(path, "mcap")
    assert any(
        "/joint_states: sensor_msgs/JointState contains angles" in note for note in open_recording(path).notes
    )
