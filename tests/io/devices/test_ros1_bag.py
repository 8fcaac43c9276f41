"""ROS 1 bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skeleton_files as made
from numpy.testing import assert_allclose, assert_array_equal
from other_recordings import read, turning

from smoother.errors import RecordingError
from smoother.io.devices.joint_names import AZURE
from smoother.recording import CameraFrame

FRAMES = 60
ZERO = 1_700_000_000 * 10**9


def write_bag(path: Path, *, joint_state: bool = True) -> None:
    """A bag with an IMU, its magnetometer, an Azure Kinect's markers (body 3) and joint angles."""
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    turn = types["geometry_msgs/msg/Quaternion"]

    def head(ns: int, frame: str) -> Any:
        return header(seq=0, stamp=time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=frame)

    points = np.stack([made.optical(made.part(name, FRAMES)) for name in AZURE], axis=1)
    t, acc, gyro = turning(200, 100.0)
    with BagWriter(path) as bag:

        def add(topic: str, kind: str) -> Any:
            return bag.add_connection(topic, kind, typestore=store)

        imu, mag = (
            add("/wrist/imu", "sensor_msgs/msg/Imu"),
            add("/wrist/mag", "sensor_msgs/msg/MagneticField"),
        )
        body = add("/body_tracking_data", "visualization_msgs/msg/MarkerArray")
        for at in range(len(t)):
            ns = ZERO + round(t[at] * 1e9)
            message = types["sensor_msgs/msg/Imu"](
                header=head(ns, "wrist"),
                orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=np.zeros(9),
                angular_velocity=vector(*gyro[at]),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(*acc[at]),
                linear_acceleration_covariance=np.zeros(9),
            )
            bag.write(imu, ns, store.serialize_ros1(message, "sensor_msgs/msg/Imu"))
            field = types["sensor_msgs/msg/MagneticField"](
                header=head(ns, "wrist"),
                magnetic_field=vector(1.0, float(at), 3.0),
                magnetic_field_covariance=np.zeros(9),
            )
            bag.write(mag, ns, store.serialize_ros1(field, "sensor_msgs/msg/MagneticField"))
        for at in range(FRAMES):
            ns = ZERO + round(at / 30 * 1e9)
            markers = []
            for joint in range(32) if not 20 <= at < 25 else ():
                markers.append(
                    types["visualization_msgs/msg/Marker"](
                        header=head(ns, "depth_camera_link"),
                        ns="",
                        id=300 + joint,
                        type=2,
                        action=0,
                        pose=types["geometry_msgs/msg/Pose"](
                            position=point(*points[at, joint]), orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0)
                        ),
                        scale=vector(1.0, 1.0, 1.0),
                        color=types["std_msgs/msg/ColorRGBA"](r=1.0, g=1.0, b=1.0, a=1.0),
                        lifetime=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
                        frame_locked=False,
                        points=[],
                        colors=[],
                        text="",
                        mesh_resource="",
                        mesh_use_embedded_materials=False,
                    )
                )
            message = types["visualization_msgs/msg/MarkerArray"](markers=markers)
            bag.write(body, ns, store.serialize_ros1(message, "visualization_msgs/msg/MarkerArray"))
        if joint_state:
            state = add("/joint_states", "sensor_msgs/msg/JointState")
            message = types["sensor_msgs/msg/JointState"](
                header=head(ZERO, ""),
                name=["elbow"],
                position=np.ones(1),
                velocity=np.zeros(0),
                effort=np.zeros(0),
            )
            bag.write(state, ZERO, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))


def test_ros1_bag(tmp_path: Path) -> None:
    path = tmp_path / "any"
    write_bag(path)
    (body,), (imu,) = read(path, "rosbag1")
    t, acc, gyro = turning(200, 100.0)
    assert imu.name == "wrist/imu"
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
    assert any("/joint_states: sensor_msgs/JointState holds angles" in note for note in body.notes)


def test_ros1_bag_that_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    write_bag(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(RecordingError, match=r"a\.bag is damaged.*rosbag reindex"):
        read(path, "rosbag1")
