"""Device files that are written by a library beside the product's own: ROS 1 bags, HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import ros_bags as ros
import skeleton_files as made
from importers import turning
from imu_files import motion

from smoother.io.tables.joints import AZURE

ZERO = 1_700_000_000 * 10**9


def write_bag(path: Path, *, samples: int = 200, frames: int = 60, joint_state: bool = True) -> None:
    """A ROS 1 bag with an IMU, its magnetometer, an Azure Kinect's markers (body 3) and joint angles."""
    from rosbags.rosbag1 import Writer as BagWriter
    from rosbags.typesys import Stores, get_typestore

    store, connections = get_typestore(Stores.ROS1_NOETIC), {}

    def typed(kind: str, value: Any) -> Any:
        """A message of a dictionary; what it does not have is zero."""
        fields = {}
        for name, (node, of) in store.fielddefs[kind][1]:
            one = value.get(name)
            if node.name == "NAME":
                fields[name] = typed(of, one or {})
            elif node.name == "BASE":
                fields[name] = one if one is not None else "" if of[0] == "string" else 0
            elif of[0][0].name == "NAME":
                fields[name] = [typed(of[0][1], each) for each in one]
            else:
                fields[name] = one if of[0][1][0] == "string" else np.array(one or [0.0] * of[1], of[0][1][0])
        return store.types[kind](**fields)

    points = made.optical(made.parts(AZURE, frames))
    t, acc, gyro = turning(samples, 100.0)
    with BagWriter(path) as bag:

        def add(topic: str, kind: str, ns: int, message: dict[str, Any]) -> None:
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], ns, store.serialize_ros1(typed(kind, message), kind))

        for at in range(len(t)):
            ns = ZERO + round(t[at] * 1e9)
            message = ros.imu_message(ns, "wrist", acc[at], gyro[at])
            add("/wrist/imu", "sensor_msgs/msg/Imu", ns, message)
            field = {"header": ros.header(ns, "wrist"), "magnetic_field": ros.xyz(np.array([1.0, at, 3.0]))}
            add("/wrist/mag", "sensor_msgs/msg/MagneticField", ns, field)
        for at in range(frames):
            ns = ZERO + round(at / 30 * 1e9)
            seen = () if 20 <= at < 25 else range(32)
            markers = [ros.marker(ns, 300 + joint, points[at, joint]) for joint in seen]
            add("/body_tracking_data", "visualization_msgs/msg/MarkerArray", ns, {"markers": markers})
        if joint_state:
            state = {"header": ros.header(ZERO, ""), "name": ["elbow"], "position": [1.0]}
            add("/joint_states", "sensor_msgs/msg/JointState", ZERO, state)


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
