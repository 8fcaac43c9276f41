"""MediaPipe's pose landmarker on the pictures of a video: 33 landmarks a person, in space and in pixels.

The package is an extra, and its model a file that the user supplies (a `.task` bundle of MediaPipe's pose
landmarker: lite, full or heavy).
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError, UnoccludeError
from ...runtime.packages import extra_module
from ...runtime.pool import Progress
from ..tables.joint_columns import BLAZEPOSE
from .video import Video

#: What a bundle of the pose landmarker contains: its networks.
_IN_BUNDLE = "pose_landmarks_detector.tflite"
MODEL_WORDS = (
    "MediaPipe's pose landmarker needs its model, a file that you download once: pose_landmarker_full.task"
    " (or _lite, _heavy) from https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker"
)


@dataclass(frozen=True)
class Pose:
    """One person in one picture.

    Attributes
    ----------
    world : ndarray, shape (33, 4)
        x right, y down, z forward, m about the middle of the hips, and the visibility, 0 to 1.
    pixels : ndarray, shape (33, 3)
        u, v from the centre of the first pixel, and the visibility.
    """

    world: FloatArray
    pixels: FloatArray

    @property
    def trunk(self) -> FloatArray:
        """Mean (2,) of shoulders and hips in the picture, pixels."""
        rows = [
            BLAZEPOSE.index(f"{side}_{part}") for side in ("left", "right") for part in ("shoulder", "hip")
        ]
        return np.asarray(self.pixels[rows, :2].mean(axis=0))


def check_model(path: Path | None) -> Path:
    """The model's file.

    Raises
    ------
    UnoccludeError
        There is none, or it is not a bundle of the pose landmarker.
    """
    if path is None:
        raise UnoccludeError(f"{MODEL_WORDS}; name it with --model FILE")
    if not path.is_file():
        raise UnoccludeError(f"{path} does not exist; {MODEL_WORDS}")
    if not is_model(path):
        raise UnoccludeError(f"{path} is not a model of the pose landmarker; {MODEL_WORDS}")
    return path


def is_model(path: Path) -> bool:
    """Whether a file is a bundle of the pose landmarker."""
    try:
        with zipfile.ZipFile(path) as bundle:
            return _IN_BUNDLE in bundle.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def mediapipe_module() -> ModuleType:
    """The package MediaPipe with its tasks of vision; raises `UnoccludeError` where it is not installed."""
    return extra_module("mediapipe", "MediaPipe", "video", submodules=("tasks.python.vision",))


@contextmanager
def open_landmarker(model: Path, people: int) -> Iterator[Any]:
    """MediaPipe's pose landmarker for a video.

    Parameters
    ----------
    model : Path
        Its bundle.
    people : int
        As many persons are looked for at most.

    Raises
    ------
    UnoccludeError
        MediaPipe is not installed, or does not take the model.
    """
    mediapipe_module()
    tasks = import_module("mediapipe.tasks.python")  # `mediapipe.tasks` is an alias of it, or holds it
    check_model(model)
    options = tasks.vision.PoseLandmarkerOptions(
        base_options=tasks.BaseOptions(model_asset_path=str(model)),
        running_mode=tasks.vision.RunningMode.VIDEO,
        num_poses=people,
    )
    try:
        landmarker = tasks.vision.PoseLandmarker.create_from_options(options)
    except (ValueError, RuntimeError, OSError) as error:
        raise UnoccludeError(f"MediaPipe cannot use {model} ({error}); {MODEL_WORDS}") from error
    try:
        yield landmarker
    finally:
        landmarker.close()


def find_poses(video: Video, model: Path, people: int, progress: Progress | None = None) -> list[list[Pose]]:
    """The persons in each picture of a video; [] where there are none.

    Parameters
    ----------
    video : Video
        Not read yet.
    model : Path
        Of the landmarker.
    people : int
        As many are looked for at most.
    progress : callable, optional
        Told the part done, 0 to 1, and what is being done.

    Raises
    ------
    UnoccludeError, RecordingError
        As `open_landmarker`; the video has no picture.
    """
    mediapipe = mediapipe_module()
    found: list[list[Pose]] = []
    with open_landmarker(model, people) as landmarker:
        latest_ms = -1
        for t_s, pixels in video.pictures():
            latest_ms = max(latest_ms + 1, round(1e3 * t_s))  # they have to rise
            image = mediapipe.Image(
                image_format=mediapipe.ImageFormat.SRGB, data=np.ascontiguousarray(pixels)
            )
            result = landmarker.detect_for_video(image, latest_ms)
            found.append(_poses(result, video.width, video.height))
            if progress is not None and video.count:
                progress(min(len(found) / video.count, 1.0), "finding the person in each picture")
    if not found:
        raise RecordingError(f"{video.path} has no picture that can be read; export it again.")
    return found


def _poses(result: Any, width: int, height: int) -> list[Pose]:
    poses = []
    for world, image in zip(result.pose_world_landmarks, result.pose_landmarks, strict=True):
        if len(world) != len(BLAZEPOSE) or len(image) != len(BLAZEPOSE):
            raise RecordingError(
                f"MediaPipe found {len(world)} landmarks and not {len(BLAZEPOSE)}; give the model of the pose"
                " landmarker."
            )
        scores = [np.nan if point.visibility is None else point.visibility for point in image]
        at = np.array([[point.x, point.y] for point in image], float) * (width, height) - 0.5
        space = np.array([[point.x, point.y, point.z] for point in world], float)
        poses.append(Pose(np.column_stack([space, scores]), np.column_stack([at, scores])))
    return poses


def persons(poses: list[list[Pose]]) -> list[list[int]]:
    """Which person each pose is: a pose goes to whoever was nearest in the picture before.

    Parameters
    ----------
    poses : list of list of Pose
        Of each picture.

    Returns
    -------
    numbers : list of list of int
        Of each pose, from 0 in the order in which they were first seen.
    """
    from scipy.optimize import linear_sum_assignment

    places: list[FloatArray] = []
    numbers: list[list[int]] = []
    for frame in poses:
        mine = [-1] * len(frame)
        if places and frame:
            trunk = np.stack([pose.trunk for pose in frame])
            distance = np.linalg.norm(trunk[:, None] - np.stack(places)[None], axis=2)
            for at, person in zip(*linear_sum_assignment(distance), strict=True):
                mine[at] = int(person)
        for at, pose in enumerate(frame):
            if mine[at] < 0:
                mine[at] = len(places)
                places.append(pose.trunk)
            places[mine[at]] = pose.trunk
        numbers.append(mine)
    return numbers
