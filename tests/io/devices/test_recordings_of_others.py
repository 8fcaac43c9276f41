"""Recordings of other programs: ROS 1 bags, MCAP with XCDR2 messages, XDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skeleton_files as made
from importers import streams, turning
from library_files import ZERO, write_bag
from mcap.writer import Writer
from numpy.testing import assert_allclose, assert_array_equal

from smoother.errors import RecordingError
from smoother.io import open_recording
from smoother.io.tables.imu import find_sensors
from smoother.io.tables.joints import KINECT_V2
from smoother.recording import CameraFrame, JointState

FRAMES = 60


def test_ros1_bag(tmp_path: Path) -> None:
    path = tmp_path / "any"
    write_bag(path)
    (body,), (imu,) = streams(path, "rosbag1")
    t, acc, gyro = turning(200, 100.0)
    assert imu.topic == "wrist/imu"
    assert_allclose(imu.t_s - ZERO * 1e-9, t, atol=1e-6)  # seconds since 1970 in double precision
    assert_array_equal(imu.acc, acc)
    assert_array_equal(imu.gyro, gyro)
    assert imu.mag is not None
    assert_allclose(imu.mag[:, 1], np.arange(200), atol=1e-3)
    assert (body.body, body.frame, len(body.t_s)) == (3, CameraFrame.OPTICAL, FRAMES)
    there = np.delete(np.arange(FRAMES), np.arange(20, 25))
    wanted = made.expected("wrist_right", FRAMES, "optical")
    assert_array_equal(body.position["wrist_right"][there], wanted[there])
    assert np.isnan(body.position["wrist_right"][20:25]).all()
    assert any("/joint_states: sensor_msgs/JointState contains angles" in note for note in body.notes)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(RecordingError, match="recognised as ROS 1 bag, but is damaged"):
        streams(path, "rosbag1")


@pytest.mark.parametrize(
    ("schema", "encoding", "said"),
    [
        ("sensor_msgs/msg/Imu", "json", "/wrist: JSON messages are not read"),
        ("unocclude.Skeleton", "json", "/wrist: JSON messages are not read"),
        ("sensor_msgs/msg/JointState", "cdr", "has no IMU and no skeleton.*sensor_msgs/msg/JointState"),
    ],
)
def test_mcap_of_messages_that_are_not_read(tmp_path: Path, schema: str, encoding: str, said: str) -> None:
    path = tmp_path / "a.mcap"
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        kind = "jsonschema" if encoding == "json" else "ros2msg"
        number = writer.register_schema(name=schema, encoding=kind, data=b'{"type": "object"}')
        channel = writer.register_channel(topic="/wrist", message_encoding=encoding, schema_id=number)
        writer.add_message(channel, ZERO, b"{}" if encoding == "json" else b"\0\1\0\0", ZERO)
        writer.finish()
    with pytest.raises(RecordingError, match=rf"a\.mcap.*{said}"):
        streams(path, "mcap")
    if encoding == "json":
        with pytest.raises(RecordingError, match=rf"a\.mcap: {said}"):
            open_recording(path)
    else:
        assert any("JointState contains angles" in note for note in open_recording(path).notes)


def imu_stream(unit: tuple[str, str], labels: list[str], **more: Any) -> dict[str, Any]:
    t, acc, gyro = turning(1000, 100.0)
    acc = acc / 9.80665 if unit[0] == "g" else acc
    gyro = np.degrees(gyro) if unit[1] == "deg/s" else gyro
    channels = list(zip(labels, [unit[0]] * 3 + [unit[1]] * 3, strict=True))
    stream = {"name": "Wrist", "type": "IMU", "rate": 100, "channels": channels}
    return {**stream, "t_s": 50 + t, "values": np.hstack([acc, gyro]), **more}


def kinect_stream() -> dict[str, Any]:
    points = made.kinect_v2(FRAMES)
    values = np.concatenate([points, np.ones((FRAMES, 25, 1))], axis=2).reshape(FRAMES, -1)
    channels = [
        (f"{n}_{f}", "meters" if f != "Conf" else "") for n in KINECT_V2 for f in ("X", "Y", "Z", "Conf")
    ]
    t_s = 950.0 + np.arange(FRAMES) / 30
    return {
        "name": "K",
        "type": "MoCap",
        "rate": 30,
        "channels": channels,
        "t_s": t_s,
        "values": values,
        "offset": -900.0,
    }


@pytest.mark.parametrize(
    "labels",
    [
        ["acc_x", "acc_y", "acc_z", "gyr_x", "gyr_y", "gyr_z"],
        ["AccX", "AccY", "AccZ", "GyroX", "GyroY", "GyroZ"],
        ["ax", "ay", "az", "gx", "gy", "gz"],
        [f"{sensor} {axis}" for sensor in ("Accelerometer", "Gyroscope") for axis in "XYZ"],
    ],
)
@pytest.mark.parametrize("unit", [("m/s^2", "rad/s"), ("g", "deg/s")])
def test_xdf(tmp_path: Path, labels: list[str], unit: tuple[str, str]) -> None:
    path = tmp_path / "any"
    made.xdf(path, [kinect_stream(), imu_stream(unit, labels)])
    (body,), (imu,) = streams(path, "xdf")
    t, acc, gyro = turning(1000, 100.0)
    assert_allclose(imu.t_s, 50 + t, atol=1e-9)
    assert_allclose(imu.acc, acc, atol=1e-9)
    assert_allclose(imu.gyro, gyro, atol=1e-9)
    assert imu.units == ", ".join(unit)
    assert imu.rate_hz == 100
    assert_allclose(body.t_s, 50 + np.arange(FRAMES) / 30, atol=1e-6)  # the clock offset is in the file
    assert body.frame is CameraFrame.KINECT
    assert_allclose(body.position["wrist_left"], made.kinect_v2(FRAMES)[:, 6], atol=1e-12)
    assert (body.state["wrist_left"] == JointState.TRACKED).all()


@pytest.mark.parametrize("unit", [("m/s^2", "rad/s"), ("g", "deg/s")])
def test_xdf_without_units(tmp_path: Path, unit: tuple[str, str]) -> None:
    stream = imu_stream(unit, ["ax", "ay", "az", "gx", "gy", "gz"])
    stream["channels"] = [(label, "") for label, _ in stream["channels"]]
    path = tmp_path / "a.xdf"
    made.xdf(path, [stream])
    _, (imu,) = streams(path, "xdf")
    assert_allclose(imu.gyro, turning(1000, 100.0)[2], atol=1e-9)
    assert imu.units == ", ".join(unit)
    assert any("for gyro (it then rotates as gravity does" in note for note in imu.notes)
    stream["values"] = np.tile([0.0, 9.81, 0.0, 0.01, 0.0, 0.0], (1000, 1))  # nothing shows the unit
    made.xdf(path, [stream])
    with pytest.raises(RecordingError, match=r"a\.xdf.*unit of gyro is not stated.*and units"):
        streams(path, "xdf")


def test_xdf_without_motion(tmp_path: Path) -> None:
    eeg = {"name": "Cap", "type": "EEG", "rate": 250, "t_s": np.arange(50) / 250, "values": np.zeros((50, 4))}
    path = tmp_path / "a.xdf"
    made.xdf(path, [{**eeg, "channels": [(name, "uV") for name in ("Fz", "Cz", "Pz", "Oz")]}])
    with pytest.raises(RecordingError, match=r"a\.xdf has no stream.*Cap \(EEG, 4 channels\)"):
        streams(path, "xdf")
    path.write_bytes(b"XDF:" + bytes(range(200)))
    with pytest.raises(RecordingError, match=r"a\.xdf"):
        streams(path, "xdf")


def test_several_sensors_in_a_stream() -> None:
    labels = [
        f"{name}_{kind}_{axis}" for name in ("wrist", "trunk") for kind in ("acc", "gyro") for axis in "xyz"
    ]
    labels += ["wrist_quat_w", "wrist_quat_x", "wrist_quat_y", "wrist_quat_z"]
    assert find_sensors(labels, [""] * len(labels), "Movella IMU") == {
        "wrist": {"acc": (0, 1, 2), "gyro": (3, 4, 5)},
        "trunk": {"acc": (6, 7, 8), "gyro": (9, 10, 11)},
    }
