"""A stand-in for MediaPipe 1.2, for tests: the names that are used; landmarks by time are the model's file.

No model of MediaPipe's can be had here; `pose_videos.py` writes one.
"""

import io
import sys
import zipfile
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

__version__ = "1.2.2"
#: The pictures that the latest landmarker was given.
SHOWN: list[np.ndarray] = []
ImageFormat = SimpleNamespace(SRGB=1)


class Image:
    """A picture."""

    def __init__(self, image_format: int, data: np.ndarray):
        if image_format != ImageFormat.SRGB or data.dtype != np.uint8 or data.shape[2:] != (3,):
            raise ValueError("Unsupported image format and data type.")
        self.pixels = data


class PoseLandmarker:
    """Finds in a picture whoever the bundle has at its time."""

    def __init__(self, options: Any):
        try:
            with zipfile.ZipFile(options.base_options.model_asset_path) as bundle:
                self._model = dict(np.load(io.BytesIO(bundle.read("pose_landmarks_detector.tflite"))))
        except (zipfile.BadZipFile, OSError) as error:
            raise RuntimeError("Unable to open zip archive.") from error
        except ValueError as error:
            raise RuntimeError("The model is not a valid Flatbuffer file.") from error
        self._options, self._latest_ms = options, -1
        SHOWN.clear()

    @classmethod
    def create_from_options(cls, options: Any) -> "PoseLandmarker":
        """As MediaPipe's."""
        return cls(options)

    def detect_for_video(self, image: Image, timestamp_ms: int) -> Any:
        """The people in a picture: x, y, z, visibility; x, y as parts of the picture's width and height."""
        if self._options.running_mode != "VIDEO":
            raise ValueError("Task is not initialized with the video mode.")
        if not isinstance(timestamp_ms, int) or timestamp_ms <= self._latest_ms:
            raise ValueError("Input timestamp must be monotonically increasing.")
        self._latest_ms = timestamp_ms
        SHOWN.append(image.pixels)
        people = self._model["people"][:, np.argmin(abs(self._model["t_ms"] - timestamp_ms))]
        people = people[np.isfinite(people).all(axis=(1, 2))][: self._options.num_poses]
        world, points = (
            [[SimpleNamespace(x=p[x], y=p[x + 1], z=p[2], visibility=p[3]) for p in one] for one in people]
            for x in (0, 4)
        )
        return SimpleNamespace(pose_world_landmarks=world, pose_landmarks=points)

    def close(self) -> None:
        """As MediaPipe's."""


for _name in ("tasks", "tasks.python", "tasks.python.vision"):
    _module = sys.modules[f"{__name__}.{_name}"] = ModuleType(f"{__name__}.{_name}")
    _module.__dict__.update(
        BaseOptions=SimpleNamespace,
        PoseLandmarkerOptions=SimpleNamespace,
        PoseLandmarker=PoseLandmarker,
        RunningMode=SimpleNamespace(VIDEO="VIDEO"),
    )
sys.modules[f"{__name__}.tasks.python"].__dict__["vision"] = _module
