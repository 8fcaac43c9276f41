"""What a recording contains: one arm seen by a depth camera, and the IMU on its forearm.

All values are SI. Times are float seconds after `Recording.origin_ns`; the camera's stamps and the
IMU's stamps keep their own clocks (t_imu = t_camera + offset). Frames: `{K}` is the camera,
`{A}` the forearm IMU; `R_K_A` maps a vector from A to K.
"""

from __future__ import annotations

from .recording import ImportNote, Recording, TrunkSensors, arm_words
from .streams import (
    FIRST_CAMERA,
    FOCAL_CALIBRATED,
    FOCAL_DATA_SHEET,
    FOREARM_JOINTS,
    JOINTS,
    Camera,
    CameraFrame,
    CameraPose,
    ImuStream,
    JointState,
    JointTracks,
    Truth,
)

__all__ = [
    "FIRST_CAMERA",
    "FOCAL_CALIBRATED",
    "FOCAL_DATA_SHEET",
    "FOREARM_JOINTS",
    "JOINTS",
    "Camera",
    "CameraFrame",
    "CameraPose",
    "ImportNote",
    "ImuStream",
    "JointState",
    "JointTracks",
    "Recording",
    "TrunkSensors",
    "Truth",
    "arm_words",
]
