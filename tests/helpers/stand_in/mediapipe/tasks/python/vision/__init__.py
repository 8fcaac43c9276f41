"""The pose landmarker of `mediapipe.tasks.python.vision`, by the colours of discs."""

import enum
import io
import zipfile
from dataclasses import dataclass, field
from typing import Any

import numpy as np

#: Discs of a person, and which of the 33 landmarks they are where the first of each pair is the left one.
PARTS = {"shoulder": (11, 12), "elbow": (13, 14), "wrist": (15, 16), "hip": (23, 24)}
PEOPLE = 2
#: A disc of fewer pixels than this part of its size is not seen.
SEEN_PART = 0.35


def colour(person: int, part: int, of_pair: int) -> np.ndarray:
    """Red, green, blue of a disc: a hue each, the second person darker."""
    hue = (2 * part + of_pair) / (2 * len(PARTS)) * 6.0
    rgb = np.clip([abs(hue - 3) - 1, 2 - abs(hue - 2), 2 - abs(hue - 4)], 0, 1)
    return np.round(255 * rgb * (1.0 if person == 0 else 0.5))


COLOURS = np.array([colour(who, k, of) for who in range(PEOPLE) for k in range(len(PARTS)) for of in (0, 1)])


class RunningMode(enum.Enum):
    """How pictures come."""

    IMAGE = "IMAGE"
    VIDEO = "VIDEO"
    LIVE_STREAM = "LIVE_STREAM"


@dataclass
class Landmark:
    """A point; of an image as parts of its width and height."""

    x: float | None = None
    y: float | None = None
    z: float | None = None
    visibility: float | None = None
    presence: float | None = None
    name: str | None = None


@dataclass
class PoseLandmarkerResult:
    """Of one picture."""

    pose_landmarks: list[list[Landmark]] = field(default_factory=list)
    pose_world_landmarks: list[list[Landmark]] = field(default_factory=list)
    segmentation_masks: Any = None


@dataclass
class PoseLandmarkerOptions:
    """As MediaPipe's."""

    base_options: Any
    running_mode: RunningMode = RunningMode.IMAGE
    num_poses: int = 1
    min_pose_detection_confidence: float = 0.5
    min_pose_presence_confidence: float = 0.5
    min_tracking_confidence: float = 0.5
    output_segmentation_masks: bool = False
    result_callback: Any = None


class PoseLandmarker:
    """Finds the discs; their depths by time are the bundle's."""

    def __init__(self, options: PoseLandmarkerOptions):
        try:
            with zipfile.ZipFile(options.base_options.model_asset_path) as bundle:
                self._model = np.load(io.BytesIO(bundle.read("pose_landmarks_detector.tflite")))
        except (zipfile.BadZipFile, OSError) as error:
            raise RuntimeError("Unable to open zip archive.") from error
        except ValueError as error:
            raise RuntimeError("The model is not a valid Flatbuffer file.") from error
        self._options, self._latest_ms, self._open = options, -1, True

    @classmethod
    def create_from_options(cls, options: PoseLandmarkerOptions) -> "PoseLandmarker":
        """As MediaPipe's."""
        return cls(options)

    def detect_for_video(self, image: Any, timestamp_ms: int) -> PoseLandmarkerResult:
        """The people in a picture."""
        assert self._open
        if self._options.running_mode is not RunningMode.VIDEO:
            raise ValueError("Task is not initialized with the video mode.")
        if not isinstance(timestamp_ms, int) or timestamp_ms <= self._latest_ms:
            raise ValueError("Input timestamp must be monotonically increasing.")
        self._latest_ms = timestamp_ms
        pixels = image.numpy_view()
        at = np.argwhere(pixels.max(axis=2) > 90)
        nearest = np.argmin(
            ((pixels[at[:, 0], at[:, 1]].astype(float)[:, None] - COLOURS[None]) ** 2).sum(axis=2), axis=1
        )
        result = PoseLandmarkerResult()
        for person in range(min(PEOPLE, self._options.num_poses)):
            discs = [at[nearest == 2 * len(PARTS) * person + k] for k in range(2 * len(PARTS))]
            self._add(result, person, discs, image.width, image.height)
        return result

    def _add(self, result: Any, person: int, discs: list[np.ndarray], width: int, height: int) -> None:
        share = np.array([len(disc) for disc in discs]) / float(self._model["disc_pixels"])
        trunk = [0, 1, 6, 7]
        if (share[trunk] < SEEN_PART).any():
            return
        at = np.array([disc.mean(axis=0)[::-1] if len(disc) else (np.nan, np.nan) for disc in discs])
        at = np.where(np.isfinite(at), at, at[:2].mean(axis=0))  # a guess where nothing is seen
        depth = self._model["depth_m"][person]
        z = np.array([np.interp(self._latest_ms, self._model["t_ms"], column) for column in depth.T])
        left = 0 if at[0, 0] > at[1, 0] else 1  # whoever faces the camera has the left arm on the right
        world = [Landmark(0.0, 0.0, 0.0, 0.9) for _ in range(33)]
        points = [Landmark(0.5, 0.5, 0.0, 0.9) for _ in range(33)]
        hips = at[6:].mean(axis=0)
        for part, numbers in enumerate(PARTS.values()):
            for side, number in enumerate(numbers):
                k = 2 * part + (left if side == 0 else 1 - left)
                seen = 0.95 if share[k] >= SEEN_PART else 0.05
                x, y = (at[k] - hips) / float(self._model["pixels_per_m"])
                world[number] = Landmark(x, y, float(z[k]), seen, seen)
                u, v = (at[k] + 0.5) / (width, height)
                points[number] = Landmark(u, v, float(z[k]), seen, seen)
        result.pose_world_landmarks.append(world)
        result.pose_landmarks.append(points)

    def close(self) -> None:
        """As MediaPipe's."""
        self._open = False
