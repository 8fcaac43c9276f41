"""A video as a camera: the persons' landmarks in space and in pixels, by MediaPipe's pose landmarker.

The package is an extra, and its model a file that the user supplies (a `.task` bundle of MediaPipe's pose
landmarker: lite, full or heavy). A video is read picture by picture, upright, with its container's times.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError, UnoccludeError
from ...runtime.packages import extra_module
from ...runtime.pool import Progress
from ..recording.streams import SkeletonTable
from .joints import BLAZEPOSE
from .skeletons import LANDMARKS, RELATIVE_NOTE, RawSkeleton
from .table import Format

#: Bytes at the beginning of videos: where they stand, and what they are.
_MARKS = ((4, b"ftyp"), (0, b"\x1aE\xdf\xa3"), (8, b"AVI "))
#: What a bundle of the pose landmarker contains: its networks.
_IN_BUNDLE = "pose_landmarks_detector.tflite"
MODEL_WORDS = (
    "MediaPipe's pose landmarker needs its model, a file that you download once: pose_landmarker_full.task"
    " (or _lite, _heavy) from https://ai.google.dev/edge/mediapipe/solutions/vision/pose_landmarker"
)
#: Turns that a picture can be given, degrees clockwise.
TURNS = (0, 90, 180, 270)
#: Frame rates of cameras, Hz.
_RATES_HZ = (1.0, 1000.0)
#: Times between pictures that differ by more than this from the usual one are of a variable rate.
_VARIES = 0.3
#: Whoever is seen for less than this, s, is a mistake of the network's or passes by.
_PASSES_BY_S = 1.0
#: A trunk that is this much longer across the picture than along it is horizontal.
_ACROSS = 1.5
_SHOULDERS, _HIPS = (
    [BLAZEPOSE.index(f"{side}_{part}") for side in ("left", "right")] for part in ("shoulder", "hip")
)
_NOT_MIRRORED = (
    "Assumed not mirrored. Front cameras of phones often store a mirror image, in which the right arm looks"
    " like a left one: if writing in the picture reads backwards, import it again with --mirrored."
)
#: Of a picture the persons: (persons, 33, 6) of x right, y down, z forward, m about the middle of the hips,
#: the visibility from 0 to 1, and u, v from the centre of the first pixel.
Persons = FloatArray


def is_video(raw: bytes) -> bool:
    """Whether a file begins as MP4, MOV, MKV, WebM or AVI do."""
    return any(raw[at : at + len(mark)] == mark for at, mark in _MARKS)


def is_model(path: Path) -> bool:
    """Whether a file is a bundle of the pose landmarker."""
    try:
        with zipfile.ZipFile(path) as bundle:
            return _IN_BUNDLE in bundle.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def pose_video(
    model: Path | None,
    people: int = 2,  # As many are looked for at most
    mirrored: bool = False,  # The camera stored a mirror image
    turn_deg: int = 0,  # Rotate the pictures clockwise, in addition to the file's own rotation
    progress: Progress | None = None,
) -> Format:
    """The format of videos, read with the pose landmarker's model."""

    def read(path: Path) -> list[SkeletonTable]:
        import cv2

        # what is missing is said before minutes of work
        mediapipe = extra_module("mediapipe", "MediaPipe", "video", submodules=("tasks.python.vision",))
        with _landmarker(model, people) as landmarker, _capture(path) as (capture, rate_hz):
            count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)  # 0 where it is not stated
            stored_deg = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
            stamps: list[float] = []
            poses: list[Persons] = []
            latest_ms = -1
            for t_s, pixels in _pictures(capture, turn_deg, mirrored):
                stamps.append(t_s)
                latest_ms = max(latest_ms + 1, round(1e3 * t_s))  # they have to rise
                image = mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=pixels)
                result = landmarker.detect_for_video(image, latest_ms)
                poses.append(_persons(result, pixels.shape[1], pixels.shape[0]))
                if progress is not None and count:
                    progress(min(len(poses) / count, 1.0), "finding the person in each picture")
        if not poses:
            raise RecordingError(f"{path} has no picture that can be read; export it again.")
        t_s_all, said = _times(np.array(stamps), rate_hz)
        numbers = _followed(poses)
        seen = _seen(numbers, t_s_all)
        if not seen:
            raise RecordingError(
                f"{path}: no person was found in its pictures ({len(poses)}); record so that"
                " head, shoulders and hips are in the picture, from the front and in good light."
            )
        raw = _raw(path, t_s_all, poses, numbers, seen)
        raw.notes += [RELATIVE_NOTE, *([said] if said else [])]
        if stored_deg:
            raw.notes.append(f"The file was filmed turned by {stored_deg} degrees; it was turned upright.")
        flipped = "The pictures were flipped left to right (--mirrored)."
        raw.notes += [flipped if mirrored else _NOT_MIRRORED, *_about_persons(poses, numbers, seen)]
        return raw.skeletons(LANDMARKS)

    title, by = "video, MediaPipe pose landmarker", "the beginning of MP4, MOV, MKV, WebM or AVI"
    return Format("video", title, "skeleton", by, lambda head: is_video(head.raw), read)


# ------------------------------------------------------------------------------- the video and the landmarker


@contextmanager
def _capture(path: Path) -> Iterator[tuple[Any, float]]:
    """An open video, and the rate that its container states."""
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
        yield capture, rate_hz if _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1] else 30.0
    finally:
        capture.release()
        logging.setLogLevel(previous)


def _pictures(capture: Any, turn_deg: int, mirrored: bool) -> Iterator[tuple[float, np.ndarray]]:
    """Time, s, and pixels (height, width, 3) in red, green, blue of each picture, once."""
    import cv2

    while True:
        there, pixels = capture.read()
        if not there:
            return
        t_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        pixels = np.rot90(pixels, -turn_deg // 90)[:, :: -1 if mirrored else 1]
        yield t_s, np.ascontiguousarray(pixels[..., ::-1])


def _times(t_s: FloatArray, rate_hz: float) -> tuple[FloatArray, str]:
    """Times (F,) of all pictures, and what is to be said of them."""
    rows = np.arange(len(t_s))
    good = np.append(True, t_s[1:] > np.maximum.accumulate(t_s)[:-1])[: len(t_s)]
    if good.mean() >= 0.99:  # single ones that do not rise are put between their neighbours
        t_s = np.interp(rows, rows[good], t_s[good])
    step = np.diff(t_s)
    if not (step > 0).all():
        return (
            rows / rate_hz,
            f"The video has no times of its pictures; they count at {rate_hz:.3g} a second.",
        )
    usual = float(np.median(step)) if len(step) else 0.0
    if usual == 0.0 or (np.abs(step - usual) > _VARIES * usual).mean() <= 0.01:
        return t_s, ""
    return t_s, (
        f"The video has a variable frame rate: {1e3 * step.min():.0f} to {1e3 * step.max():.0f} ms"
        " from picture to picture; the container's times count."
    )


@contextmanager
def _landmarker(model: Path | None, people: int) -> Iterator[Any]:
    """MediaPipe's network with the model's file."""
    if model is None:
        raise UnoccludeError(f"{MODEL_WORDS}; name it with --model FILE")
    if not model.is_file():
        raise UnoccludeError(f"{model} does not exist; {MODEL_WORDS}")
    if not is_model(model):
        raise UnoccludeError(f"{model} is not a model of the pose landmarker; {MODEL_WORDS}")
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
    with closing(landmarker):
        yield landmarker


def _persons(result: Any, width: int, height: int) -> Persons:
    """What the network found in a picture."""
    found = np.zeros((len(result.pose_landmarks), len(BLAZEPOSE), 6))
    for one, world, image in zip(found, result.pose_world_landmarks, result.pose_landmarks, strict=True):
        if len(world) != len(BLAZEPOSE) or len(image) != len(BLAZEPOSE):
            raise RecordingError(
                f"MediaPipe found {len(world)} landmarks, not {len(BLAZEPOSE)}; give its own model."
            )
        one[:, :3] = [(point.x, point.y, point.z) for point in world]
        one[:, 3] = [np.nan if point.visibility is None else point.visibility for point in image]
        one[:, 4:] = np.array([(point.x, point.y) for point in image]) * (width, height) - 0.5
    return found


# ---------------------------------------------------------------------------------------------- who is who


def _followed(poses: list[Persons]) -> list[list[int]]:
    """Which person each pose is: a pose goes to whose trunk was nearest in the picture before."""
    from scipy.optimize import linear_sum_assignment

    places: list[FloatArray] = []
    numbers: list[list[int]] = []
    for frame in poses:
        trunks = frame[:, [*_SHOULDERS, *_HIPS], 4:].mean(axis=1)
        mine = [-1] * len(frame)
        if places and len(frame):
            distance = np.linalg.norm(trunks[:, None] - np.stack(places)[None], axis=2)
            for at, person in zip(*linear_sum_assignment(distance), strict=True):
                mine[at] = int(person)
        for at, trunk in enumerate(trunks):
            if mine[at] < 0:
                mine[at] = len(places)
                places.append(trunk)
            places[mine[at]] = trunk
        numbers.append(mine)
    return numbers


def _seen(numbers: list[list[int]], t_s: FloatArray) -> list[int]:
    """Who is in the video, most often seen first; who only passes by is not."""
    frames = np.bincount([number for frame in numbers for number in frame], minlength=1)
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    least = min(_PASSES_BY_S / usual if usual > 0 else 1.0, 0.5 * frames.max())
    order = np.argsort(-frames, kind="stable").tolist()
    return [person for person in order if frames[person] and frames[person] >= least]


def _raw(
    path: Path, t_s: FloatArray, poses: list[Persons], numbers: list[list[int]], seen: list[int]
) -> RawSkeleton:
    """A row a picture and person, as a file of world landmarks has them; one too where no person is seen."""
    frame = np.repeat(np.arange(len(poses)), [len(mine) for mine in numbers])
    rank = dict(zip(seen, range(len(seen)), strict=True))
    body = np.array([rank.get(who, np.nan) for mine in (*numbers, [-1]) for who in mine])
    world = np.concatenate([*poses, np.full((1, len(BLAZEPOSE), 6), np.nan)])  # the last one is nobody's
    rows = np.flatnonzero(np.isfinite(body))
    nobody = np.setdiff1d(np.arange(len(poses)), frame[rows])
    frame, rows = np.append(frame[rows], nobody), np.append(rows, np.full(len(nobody), -1))
    order = np.lexsort((body[rows], frame))
    raw = RawSkeleton(path, time=t_s[frame[order]], time_unit="s", body=body[rows[order]])
    for at, name in enumerate(BLAZEPOSE):
        raw.add(name, world[rows[order], at, :4])
    return raw


def _about_persons(poses: list[Persons], numbers: list[list[int]], seen: list[int]) -> list[str]:
    """What is to be said of who is in a video."""
    notes = []
    mine = [frame[who.index(seen[0])] for frame, who in zip(poses, numbers, strict=True) if seen[0] in who]
    if absent := len(poses) - len(mine):
        notes.append(f"In {absent} of {len(poses)} pictures no person was found; the arm is occluded there.")
    if len(seen) > 1:
        notes.append(
            f"{len(seen)} people are in the video; the motion shows who wears the IMU, or choose --body 0 to"
            f" {len(seen) - 1} (0 was seen most often)."
        )
    pixels = np.stack(mine)[:, :, 4:]
    trunk = pixels[:, _HIPS].mean(axis=1) - pixels[:, _SHOULDERS].mean(axis=1)
    right, down = np.median(trunk, axis=0)
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
