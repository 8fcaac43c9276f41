"""A video as a camera: the persons' landmarks in space and in pixels, by MediaPipe's pose landmarker.

The package is an extra, and its model a file that the user supplies (a `.task` bundle of MediaPipe's pose
landmarker: lite, full or heavy). A video is read picture by picture, upright, with its container's times.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError, UnoccludeError
from ...recording import CameraFrame
from ...runtime.packages import extra_module
from ...runtime.pool import Progress
from .joints import BLAZEPOSE
from .skeleton_formats import RELATIVE_NOTE, share_states
from .skeletons import Conventions, RawSkeleton, SkeletonTable
from .table import Format

#: Bytes at the beginning of videos: where they stand, and what they are.
_MARKS = ((4, b"ftyp"), (0, b"\x1aE\xdf\xa3"), (8, b"AVI "))
#: Whoever is seen for less than this, s, is a mistake of the network's or passes by.
_PASSES_BY_S = 1.0
_SIDES = ("left", "right")
_NOT_MIRRORED = (
    "Assumed not mirrored. Front cameras of phones often store a mirror image, in which the right arm looks"
    " like a left one: if writing in the picture reads backwards, import it again with --mirrored."
)
#: A trunk that is this much longer across the picture than along it is horizontal.
_ACROSS = 1.5


def is_video(raw: bytes) -> bool:
    """Whether a file begins as MP4, MOV, MKV, WebM or AVI do."""
    return any(raw[at : at + len(mark)] == mark for at, mark in _MARKS)


def pose_video(
    model: Path | None,
    people: int = 2,  # As many are looked for at most
    mirrored: bool = False,  # The camera stored a mirror image
    turn_deg: int = 0,  # Rotate the pictures clockwise, in addition to the file's own rotation
    progress: Progress | None = None,
) -> Format:
    """The format of videos, read with the pose landmarker's model."""

    def read(path: Path) -> list[SkeletonTable]:
        mediapipe_module()  # what is missing is said before minutes of work
        checked = check_model(model)
        with open_video(path, turn_deg, mirrored) as video:
            poses = find_poses(video, checked, people, progress)
            t_s, said = video.times()
        numbers = persons(poses)
        seen = _seen(numbers, t_s)
        if not seen:
            raise RecordingError(
                f"{path}: no person was found in its pictures ({len(poses)}); record so that"
                " head, shoulders and hips are in the picture, from the front and in good light."
            )
        raw = _raw(path, t_s, poses, numbers, seen)
        raw.notes += [RELATIVE_NOTE, *([said] if said else []), *_about(video, poses, numbers, seen)]
        return raw.skeletons(Conventions("m", CameraFrame.OPTICAL, relative=True))

    title, by = "video, MediaPipe pose landmarker", "the beginning of MP4, MOV, MKV, WebM or AVI"
    return Format("video", title, "skeleton", by, lambda head: is_video(head.raw), read)


def _seen(numbers: list[list[int]], t_s: FloatArray) -> list[int]:
    """Who is in the video, most often seen first; who only passes by is not."""
    frames = np.bincount([number for frame in numbers for number in frame], minlength=1)
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    least = min(_PASSES_BY_S / usual if usual > 0 else 1.0, 0.5 * frames.max())
    order = np.argsort(-frames, kind="stable").tolist()
    return [person for person in order if frames[person] and frames[person] >= least]


def _raw(
    path: Path, t_s: FloatArray, poses: list[list[Pose]], numbers: list[list[int]], seen: list[int]
) -> RawSkeleton:
    """A row a picture and person, as a file of world landmarks has them; one too where no person is seen."""
    rows: list[tuple[float, float, FloatArray]] = []
    nothing = np.full((len(BLAZEPOSE), 4), np.nan)
    for t, frame, mine in zip(t_s, poses, numbers, strict=True):
        here = [
            (t, float(seen.index(who)), pose.world)
            for pose, who in zip(frame, mine, strict=True)
            if who in seen
        ]
        rows += sorted(here, key=lambda row: row[1]) or [(t, np.nan, nothing)]
    table = np.stack([world for _, _, world in rows])
    raw = RawSkeleton(path, time_unit="s")
    raw.time, raw.body = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    for at, name in enumerate(BLAZEPOSE):
        raw.add(name, table[:, at, :3], share_states(table[:, at, 3]))
    return raw


def _about(video: Video, poses: list[list[Pose]], numbers: list[list[int]], seen: list[int]) -> list[str]:
    """What is to be said of a video and of who is in it."""
    notes = []
    if video.stored_turn_deg:
        notes.append(f"The file was filmed turned by {video.stored_turn_deg} degrees; it was turned upright.")
    notes.append("The pictures were flipped left to right (--mirrored)." if video.mirrored else _NOT_MIRRORED)
    mine = [frame[who.index(seen[0])] for frame, who in zip(poses, numbers, strict=True) if seen[0] in who]
    if absent := len(poses) - len(mine):
        notes.append(f"In {absent} of {len(poses)} pictures no person was found; the arm is occluded there.")
    if len(seen) > 1:
        notes.append(
            f"{len(seen)} people are in the video; the motion shows who wears the IMU, or choose --body 0 to"
            f" {len(seen) - 1} (0 was seen most often)."
        )
    shoulders, hips = (
        np.array([pose.pixels[[BLAZEPOSE.index(f"{side}_{part}") for side in _SIDES], :2] for pose in mine])
        for part in ("shoulder", "hip")
    )
    right, down = np.median(hips.mean(axis=1) - shoulders.mean(axis=1), axis=0)
    turn = 0  # what turns the trunk upright
    if abs(right) > _ACROSS * abs(down):
        turn = 90 if right > 0 else 270
    elif -down > _ACROSS * abs(right):
        turn = 180
    if turn:
        how = "upside down in" if turn == 180 else "across"
        notes.append(
            f"The person is {how} the picture. If a player shows the video so too, import it again with"
            f" --turn {turn}; as it is, down is wrong unless the person lies."
        )
    return notes


# ----------------------------------------------------------------------------------- the pose landmarker

#: What a bundle of the pose landmarker contains: its networks.
_IN_BUNDLE = "pose_landmarks_detector.tflite"
MODEL_WORDS = (
    "MediaPipe's pose landmarker needs its model, a file that you download once: pose_landmarker_full.task"
    " (or _lite, _heavy) from https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker"
)


@dataclass(frozen=True)
class Pose:
    """One person in one picture."""

    # (33, 4): x right, y down, z forward, m about the middle of the hips, and the visibility, 0 to 1
    world: FloatArray
    pixels: FloatArray  # (33, 3): u, v from the centre of the first pixel, and the visibility

    @property
    def trunk(self) -> FloatArray:
        """Mean (2,) of shoulders and hips in the picture, pixels."""
        rows = [BLAZEPOSE.index(f"{side}_{part}") for side in _SIDES for part in ("shoulder", "hip")]
        return np.asarray(self.pixels[rows, :2].mean(axis=0))


def check_model(path: Path | None) -> Path:
    """The model's file."""
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


def find_poses(video: Video, model: Path, people: int, progress: Progress | None = None) -> list[list[Pose]]:
    """The persons in each picture of a video; [] where there are none."""
    mediapipe = mediapipe_module()
    tasks = import_module("mediapipe.tasks.python")  # `mediapipe.tasks` is an alias of it, or holds it
    options = tasks.vision.PoseLandmarkerOptions(
        base_options=tasks.BaseOptions(model_asset_path=str(model)),
        running_mode=tasks.vision.RunningMode.VIDEO,
        num_poses=people,
    )
    try:
        landmarker = tasks.vision.PoseLandmarker.create_from_options(options)
    except (ValueError, RuntimeError, OSError) as error:
        raise UnoccludeError(f"MediaPipe cannot use {model} ({error}); {MODEL_WORDS}") from error
    found: list[list[Pose]] = []
    with closing(landmarker):
        latest_ms = -1
        for t_s, pixels in video.pictures():
            latest_ms = max(latest_ms + 1, round(1e3 * t_s))  # they have to rise
            image = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=pixels)
            result = landmarker.detect_for_video(image, latest_ms)
            found.append(_poses(result, pixels.shape[1], pixels.shape[0]))
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
                f"MediaPipe found {len(world)} landmarks, not {len(BLAZEPOSE)}; give its own model."
            )
        scores = [np.nan if point.visibility is None else point.visibility for point in image]
        at = np.array([[point.x, point.y] for point in image], float) * (width, height) - 0.5
        space = np.array([[point.x, point.y, point.z] for point in world], float)
        poses.append(Pose(np.column_stack([space, scores]), np.column_stack([at, scores])))
    return poses


def persons(poses: list[list[Pose]]) -> list[list[int]]:
    """Which person each pose is: a pose goes to whoever was nearest in the picture before."""
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


#: Turns that a picture can be given, degrees clockwise.
TURNS = (0, 90, 180, 270)
#: Frame rates of cameras, Hz.
_RATES_HZ = (1.0, 1000.0)
#: Times between pictures that differ by more than this from the usual one are of a variable rate.
_VARIES = 0.3


@dataclass
class Video:
    """A video that is open."""

    path: Path  # The file
    rate_hz: float  # As the container states it
    count: int  # Pictures, as the container states it; 0 where it does not
    stored_turn_deg: int  # The rotation of its pictures as stated in the file; it is applied
    turn_deg: int  # By how much they are turned besides, clockwise
    mirrored: bool  # Pictures are exchanged left for right
    capture: Any  # OpenCV's
    t_s: list[float] = field(default_factory=list)  # Times of the pictures that were given so far

    def pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Time, s, and pixels (height, width, 3) in red, green, blue of each picture, once."""
        import cv2

        while True:
            there, pixels = self.capture.read()
            if not there:
                return
            self.t_s.append(self.capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
            pixels = np.rot90(pixels, -self.turn_deg // 90)[:, :: -1 if self.mirrored else 1]
            yield self.t_s[-1], np.ascontiguousarray(pixels[..., ::-1])

    def times(self) -> tuple[FloatArray, str]:
        """Times (F,) of all pictures that were given, and what is to be said of them."""
        t_s, rows = np.array(self.t_s), np.arange(len(self.t_s))
        good = np.append(True, t_s[1:] > np.maximum.accumulate(t_s)[:-1])[: len(t_s)]
        if good.mean() >= 0.99:  # single ones that do not rise are put between their neighbours
            t_s = np.interp(rows, rows[good], t_s[good])
        step = np.diff(t_s)
        if not (step > 0).all():
            said = f"The video has no times of its pictures; they count at {self.rate_hz:.3g} a second."
            return rows / self.rate_hz, said
        usual = float(np.median(step)) if len(step) else 0.0
        if usual == 0.0 or (np.abs(step - usual) > _VARIES * usual).mean() <= 0.01:
            return t_s, ""
        return t_s, (
            f"The video has a variable frame rate: {1e3 * step.min():.0f} to {1e3 * step.max():.0f} ms"
            " from picture to picture; the container's times count."
        )


@contextmanager
def open_video(path: Path, turn_deg: int = 0, mirrored: bool = False) -> Iterator[Video]:
    """Open a video file."""
    import cv2

    if not path.is_file():
        raise RecordingError(f"{path} does not exist; name the file of a video.")
    logging = cv2.utils.logging  # its lines about damaged files are less clear than our sentence
    previous = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        rate_hz = capture.get(cv2.CAP_PROP_FPS) if capture.isOpened() else 0.0
        if not rate_hz > 0:
            raise RecordingError(
                f"{path} is not a video that can be read; export it again, or convert it to MP4 (H.264)."
            )
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        stored = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
        count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        rate_hz = rate_hz if _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1] else 30.0
        yield Video(path, rate_hz, count, stored, turn_deg, mirrored, capture)
    finally:
        capture.release()
        logging.setLogLevel(previous)
