"""A stand-in for MediaPipe 1.2, for tests: the same names, types and refusals, and discs in place of people.

No model of MediaPipe's can be had here. A person is drawn as discs, a colour each (`pose_videos.py`); the
landmarker finds them in the pixels that it is given, so turned, mirrored and late pictures show.
"""

import enum

import numpy as np

__version__ = "1.2.2"


class ImageFormat(enum.IntEnum):
    """Those of MediaPipe that are used."""

    SRGB = 1


class Image:
    """A picture."""

    def __init__(self, image_format: ImageFormat, data: np.ndarray):
        if image_format is not ImageFormat.SRGB or data.dtype != np.uint8 or data.shape[2:] != (3,):
            raise ValueError("Unsupported image format and data type.")
        self.width, self.height = data.shape[1], data.shape[0]
        self._data = np.ascontiguousarray(data)

    def numpy_view(self) -> np.ndarray:
        """Its pixels."""
        return self._data


import mediapipe.tasks.python as tasks  # noqa: E402, F401
