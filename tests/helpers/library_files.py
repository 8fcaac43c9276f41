"""Device files that are written by a library beside the product's own: ROS 1 bags, HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import skeleton_files as made
from importers import turning
from imu_files import motion

from smoother.io.tables.joints import AZURE

ZERO = 1_700_000_000 * 10**9


def write_bag(path: Path, *, samples: int = 200, frames: int = 60, joint_state: bool = True) -> None:
    """A ROS 1 bag with an IMU, its magnetometer, an Azure Kinect's markers (body 3) and joint angles."""
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
    turn = types["geometry_msgs/msg/Quaternion"]

    def head(ns: int, frame: str) -> Any:
        return header(seq=0, stamp=time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=frame)

    points = np.stack([made.optical(made.part(name, frames)) for name in AZURE], axis=1)
    t, acc, gyro = turning(samples, 100.0)
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
        for at in range(frames):
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


def write_opal(path: Path, version: int = 5, count: int = 200) -> None:
    """APDM's HDF5 with two sensors; versions below 5 have another layout."""
    import h5py

    acc, gyro = motion(count)
    micros = 1_600_000_000_000_000 + 7_812 * np.arange(count, dtype=np.uint64)
    with h5py.File(path, "w") as file:
        if version < 5:
            # Not in the order of the groups.
            file.attrs["CaseIdList"] = np.array([b"SI-001300", b"SI-001234"], dtype="S16")
            file.attrs["MonitorLabelList"] = np.array([b"Lumbar", b"Right Wrist"], dtype="S16")
        for at, (number, label) in enumerate((("1234", "Right Wrist"), ("1300", "Lumbar"))):
            group = file.create_group(f"Sensors/{number}" if version == 5 else f"SI-00{number}")
            values = group if version == 5 else group.create_group("Calibrated")
            plural = "" if version == 5 else "s"
            values[f"Accelerometer{plural}"] = np.roll(acc, at, axis=1)
            values[f"Gyroscope{plural}"] = np.roll(gyro, at, axis=1)
            values[f"Magnetometer{plural}"] = acc
            group["Time"] = micros
            group.attrs["SampleRate"] = 128
            if version == 5:
                group.create_group("Configuration").attrs["Label 0"] = label.encode()
