"""ROS 2 recordings as others make them, by a writer that is not ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

HUMBLE = get_typestore(Stores.ROS2_HUMBLE)


def definition(kind: str, store: Typestore = HUMBLE) -> str:
    """A message's definition with those that it needs, as a recorder writes it."""
    return str(store.generate_msgdef(kind, ros_version=2)[0])


IMU, FIELD, IMAGE = (definition(f"sensor_msgs/msg/{name}") for name in ("Imu", "MagneticField", "Image"))
POSE = definition("geometry_msgs/msg/PoseStamped")


def marker_array(textured: bool = True) -> str:
    """Definition of MarkerArray: of Humble and later, or of Foxy."""
    store = HUMBLE if textured else get_typestore(Stores.ROS2_FOXY)
    return definition("visualization_msgs/msg/MarkerArray", store)


def stamp(ns: int) -> dict[str, int]:
    sec, nanosec = divmod(int(ns), 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


def header(ns: int, frame_id: str) -> dict[str, object]:
    return {"stamp": stamp(ns), "frame_id": frame_id}


def xyz(values: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


TURN = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def imu_message(ns: int, frame_id: str, acc: np.ndarray, gyro: np.ndarray) -> dict[str, object]:
    return {
        "header": header(ns, frame_id),
        "orientation": TURN,
        "orientation_covariance": [-1.0] + [0.0] * 8,
        "angular_velocity": xyz(gyro),
        "angular_velocity_covariance": [0.0] * 9,
        "linear_acceleration": xyz(acc),
        "linear_acceleration_covariance": [0.0] * 9,
    }


def marker(ns: int, number: int, position: np.ndarray, action: int = 0) -> dict[str, object]:
    return {
        "header": header(ns, "depth_camera_link"),
        "ns": "",
        "id": number,
        "type": 2,
        "action": action,
        "pose": {"position": xyz(position), "orientation": TURN},
        "scale": xyz(np.full(3, 0.05)),
        "color": {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0},
        "lifetime": {"sec": 0, "nanosec": 250_000_000},
        "frame_locked": False,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "texture": {"header": header(0, ""), "format": "", "data": []},
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": {"filename": "", "data": []},
        "mesh_use_embedded_materials": False,
    }


class Bag:
    """A ROS 2 recording being written."""

    def __init__(self, path: Path, compression: CompressionType = CompressionType.ZSTD, chunk: int = 1 << 16):
        self.file = open(path, "wb")  # noqa: SIM115
        self.writer = Writer(self.file, compression=compression, chunk_size=chunk)
        self.schemas: dict[str, object] = {}

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.finish()
        self.file.close()

    def write(self, topic: str, kind: str, text: str, message: object, log_ns: int) -> None:
        if kind not in self.schemas:
            self.schemas[kind] = self.writer.register_msgdef(kind, text)
        self.writer.write_message(topic, self.schemas[kind], message, log_time=log_ns, publish_time=log_ns)

    def imu(self, topic: str, ns: int, frame_id: str, acc: np.ndarray, gyro: np.ndarray, log: int) -> None:
        self.write(topic, "sensor_msgs/msg/Imu", IMU, imu_message(ns, frame_id, acc, gyro), log)
