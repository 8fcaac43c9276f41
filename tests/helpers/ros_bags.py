"""ROS 2 recordings as others make them, by a writer that is not ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

_HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_GEOMETRY = """================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
_POSE = """================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
"""
IMU = (
    """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
"""
    + _HEADER
    + _GEOMETRY
)
FIELD = (
    """std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance
"""
    + _HEADER
    + _GEOMETRY
)
POSE = "std_msgs/Header header\ngeometry_msgs/Pose pose\n" + _HEADER + _GEOMETRY + _POSE
IMAGE = (
    """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
"""
    + _HEADER
)
_TEXTURE = """string texture_resource
sensor_msgs/CompressedImage texture
visualization_msgs/UVCoordinate[] uv_coordinates
"""


def marker_array(textured: bool = True) -> str:
    """Definition of MarkerArray: of Humble and later, or of Foxy."""
    return (
        """visualization_msgs/Marker[] markers
================================================================================
MSG: visualization_msgs/Marker
std_msgs/Header header
string ns
int32 id
int32 type
int32 action
geometry_msgs/Pose pose
geometry_msgs/Vector3 scale
std_msgs/ColorRGBA color
builtin_interfaces/Duration lifetime
bool frame_locked
geometry_msgs/Point[] points
std_msgs/ColorRGBA[] colors
"""
        + (_TEXTURE if textured else "")
        + "string text\nstring mesh_resource\n"
        + ("visualization_msgs/MeshFile mesh_file\n" if textured else "")
        + """bool mesh_use_embedded_materials
================================================================================
MSG: std_msgs/ColorRGBA
float32 r
float32 g
float32 b
float32 a
================================================================================
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""
        + (
            """================================================================================
MSG: sensor_msgs/CompressedImage
std_msgs/Header header
string format
uint8[] data
================================================================================
MSG: visualization_msgs/UVCoordinate
float32 u
float32 v
================================================================================
MSG: visualization_msgs/MeshFile
string filename
uint8[] data
"""
            if textured
            else ""
        )
        + _HEADER
        + _GEOMETRY
        + _POSE
    )


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
