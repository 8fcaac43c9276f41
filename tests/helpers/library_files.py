"""Device files that are written by a library beside the product's own: ROS 1 bags, HDF5."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import ros_bags as ros
import skeleton_files as made
from importers import turning
from imu_files import motion
from mcap.reader import make_reader

from smoother.io.tables.joints import AZURE

ZERO = 1_700_000_000 * 10**9


def write_bag(path: Path) -> None:
    """A ROS 1 bag with an IMU, its magnetometer, an Azure Kinect's markers (body 3) and joint angles."""
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.typesys import Stores, get_typestore

    noetic, foxy = (get_typestore(each) for each in (Stores.ROS1_NOETIC, Stores.ROS2_FOXY))
    points, connections = made.optical(made.parts(AZURE, 60)), {}
    ros2, (t, acc, gyro) = path.with_suffix(".ros2"), turning(200, 100.0)
    arrays, states = ros.marker_array(textured=False), ros.definition("sensor_msgs/msg/JointState")
    with ros.Bag(ros2) as bag:
        for at, ns in enumerate((ZERO + np.rint(t * 1e9)).astype(int).tolist()):
            bag.imu("/wrist/imu", ns, "wrist", acc[at], gyro[at], ns)
            field = {"header": ros.header(ns, "wrist"), "magnetic_field": ros.xyz(np.array([1.0, at, 3.0]))}
            field["magnetic_field_covariance"] = [0.0] * 9
            bag.write("/wrist/mag", "sensor_msgs/msg/MagneticField", ros.FIELD, field, ns)
        for at in range(60):
            ns = ZERO + round(at / 30 * 1e9)
            seen = () if 20 <= at < 25 else range(32)
            message = {"markers": [ros.marker(ns, 300 + joint, points[at, joint]) for joint in seen]}
            bag.write("/body_tracking_data", "visualization_msgs/msg/MarkerArray", arrays, message, ns)
        state = {"header": ros.header(ZERO, ""), "name": ["elbow"], "position": [1.0]}
        state |= {"velocity": [], "effort": []}
        bag.write("/joint_states", "sensor_msgs/msg/JointState", states, state, ZERO)
    with BagWriter(path) as bag1, ros2.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic not in connections:
                connections[channel.topic] = bag1.add_connection(channel.topic, schema.name, typestore=noetic)
            data = foxy.cdr_to_ros1(message.data, schema.name)
            bag1.write(connections[channel.topic], message.log_time, data)


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
