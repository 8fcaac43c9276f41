"""Skeletons in JSON: body tracking of a Kinect, landmarks in space, keypoints in images (OpenPose, COCO)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...recording import CameraFrame
from .joints import AZURE, POINT_SETS, TIME_WORDS, column_named, joint_name, time_unit_of
from .skeletons import AZURE_AXES, PIXELS, STATE_WORDS, Conventions, RawSkeleton, SkeletonTable
from .table import FileHead, Format, decode, read_bytes
from .units import CAMERA_RATES, time_unit

#: x, y, z and the confidence of a point; of a keypoint u, v, and the score twice.
Point = tuple[float, float, float, float]
NAN = float("nan")
NOTHING: Point = (NAN,) * 4

# ---------------------------------------------------------------------------------------- values and points


def _read_json(path: Path, expected: str) -> Any:
    """The value that a JSON file contains, or a list of those of its lines."""
    text = decode(read_bytes(path))
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        lines = [line for line in text.splitlines() if line.strip()]
        rows: list[Any] = []
        with suppress(ValueError, RecursionError):
            rows += (json.loads(line) for line in lines)
        if len(rows) > 1 and len(rows) >= len(lines) - 1:
            return rows
        where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise RecordingError(
            f"{path} should be {expected}, and its JSON is cut off or damaged{where}; copy it again."
        ) from None


def _number(value: Any) -> float:
    """A number, or nan for anything else (words of confidence count 0 to 3)."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value) if abs(value) < 1e300 else NAN
    word = value.lower().rpartition("_")[2] if isinstance(value, str) else ""
    with suppress(ValueError):
        return STATE_WORDS[word] if word in STATE_WORDS else float(value if word else "")
    return NAN


def _first(value: Any, names: Iterable[str]) -> Any:
    """What is under the first of these names that is there and not empty."""
    return next((value[name] for name in names if value.get(name)), None)


def _first_number(value: Any, names: Iterable[str], default: float = NAN) -> float:
    """The number under the first of these names that is there."""
    there = value if isinstance(value, Mapping) else {}
    return next((_number(there[name]) for name in names if name in there), default)


_SHARES = "visibility confidence confidence_level state trackingstate tracking_state score".split()  # noqa: SIM905


def _point_of(value: Any) -> Point:
    """A point as a list or a mapping; nan for what is missing."""
    if isinstance(value, Mapping):
        small = {str(key).lower(): entry for key, entry in value.items()}
        inner = next((small[k] for k in ("position", "pos", "xyz", "location", "point") if k in small), None)
        x, y, z = (_number(small.get(axis)) for axis in "xyz") if inner is None else _point_of(inner)[:3]
        return x, y, z, _first_number(small, _SHARES)
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) >= 3:
        x, y, z, *rest = map(_number, value[:4])
        return x, y, z, rest[0] if rest else NAN
    return NOTHING


def _points_by_name(value: Any, order: Sequence[str] | None = None) -> dict[str, Point]:
    """Points by name; a list's by their own names, or in an order (of as many that are known)."""
    if isinstance(value, Mapping):
        return {str(name): _point_of(point) for name, point in value.items()}
    if not isinstance(value, list) or not value:
        return {}
    if isinstance(value[0], int | float):  # x, y, z, c one after the other
        width = next((w for w in (4, 3) if len(value) % w == 0 and len(value) // w in POINT_SETS), 0)
        value = [value[at : at + width] for at in range(0, len(value), width)] if width else []
    own = [str(p["name"]) for p in value if isinstance(p, Mapping) and isinstance(p.get("name"), str)]
    names = own if len(own) == len(value) else order or POINT_SETS.get(len(value), [])
    return {name: _point_of(point) for name, point in zip(names, value, strict=False)}


#: A row: what the frame states, its number, the body's, and points by name.
_Row = tuple[Any, float, float, dict[str, Point]]


def _raw(path: Path, rows: list[_Row]) -> RawSkeleton:
    """The skeleton of rows of frames and bodies, on the frames' times."""
    raw, times = RawSkeleton(path), []
    for frame, *_ in rows:
        names = [str(key) for key in frame] if isinstance(frame, Mapping) else []
        at = column_named(names, TIME_WORDS)
        times.append(NAN if at is None else _number(frame[names[at]]))
        raw.time_unit = raw.time_unit or ("" if at is None else time_unit_of(names[at]))
    raw.time = np.array(times)
    raw.frame, raw.body = np.array([row[1:3] for row in rows], dtype=float).reshape(-1, 2).T
    for name in dict.fromkeys(name for row in rows for name in row[3]):
        raw.add(name, np.array([row[3].get(name, NOTHING) for row in rows], dtype=float))
    return raw


# ------------------------------------------------------------------------------- body tracking of a Kinect

_POSITIONS = ("joint_positions", "jointPositions", "joints", "positions", "skeleton")
_BODY = ("body_id", "bodyId", "id", "body_idx", "tracking_id", "trackingId")
_CONFIDENCES = ("confidence_levels", "joint_confidences", "joint_confidence", "confidences", "confidence")
_KINECT_EXPECTED = "JSON of body tracking (frames with bodies and joint_positions)"


def _is_kinect_json(head: FileHead) -> bool:
    """Whether the fields' names are in the first 64 kB."""
    text = head.text.lstrip()
    own = '"joint_positions"' in text or ('"bodies"' in text and '"timestamp' in text)
    return text.startswith(("{", "[")) and (own or "k4abt" in text.lower())


def _read_kinect_json(path: Path) -> list[SkeletonTable]:
    """`frames`, each with `timestamp_usec` and `bodies`, each with `body_id` and `joint_positions` in mm."""
    value = _read_json(path, _KINECT_EXPECTED)
    about = value if isinstance(value, Mapping) else {"frames": value}
    frames, names = about.get("frames"), about.get("joint_names")
    if not isinstance(frames, list) or not frames:
        raise RecordingError(
            f"{path} should be {_KINECT_EXPECTED}, and has no list of frames; export it again."
        )
    order = [str(name) for name in names] if isinstance(names, list) and names else list(AZURE)
    rows: list[_Row] = []
    for count, frame in enumerate(frames):
        if not isinstance(frame, Mapping):
            continue
        bodies = frame.get("bodies", frame.get("skeletons", []))
        there = [body for body in bodies if isinstance(body, Mapping)] if isinstance(bodies, list) else []
        of_frame = _first_number(frame, ("frame_id", "frame_number"), count)
        for body in there:
            of_body = _first_number(body, _BODY, 0.0)
            points = _points_by_name(next((body[name] for name in _POSITIONS if name in body), []), order)
            levels = next((body[name] for name in _CONFIDENCES if isinstance(body.get(name), list)), None)
            if levels is not None:
                pairs = zip(points.items(), levels, strict=False)
                points = {name: (*point[:3], _number(level)) for (name, point), level in pairs}
            rows.append((frame, of_frame, of_body if 0 <= of_body < 2**32 - 1 else NAN, points))
        if not there:
            rows.append((frame, of_frame, NAN, {}))
    return _raw(path, rows).skeletons(AZURE_AXES)


KINECT_JSON = Format(
    "azure-kinect-json",
    "Azure Kinect or Orbbec body tracking, JSON",
    "skeleton",
    "JSON with joint_positions, or with bodies and timestamp_usec",
    _is_kinect_json,
    _read_kinect_json,
)


# ----------------------------------------------------------------------------------- landmarks and keypoints

_POSE_EXPECTED = "JSON of landmarks by frame (pose_world_landmarks, or joints by name)"
_WORLD = (
    "pose_world_landmarks", "poseWorldLandmarks", "world_landmarks", "worldLandmarks", "landmarks_world",
    "world", "pose_world",
)  # fmt: skip
_POINTS = (
    "pose_keypoints_3d", "keypoints3D", "keypoints_3d", "keypoints3d", "landmarks_3d", "joints_3d",
    "pose_landmarks", "poseLandmarks", "landmarks", "landmark", "keypoints", "joints", "points", "pose",
    "body", "positions", "data",
)  # fmt: skip
_FRAMES = (
    "frames", "positions", "poses", "results", "data", "motion", "pose_data", "instance_info", "records",
)  # fmt: skip
_NUMBERS = ("frame", "frame_number", "frameNumber", "frame_index", "frame_id", "frame_idx", "index")
_RATES = ("fps", "frame_rate", "frameRate", "framerate", "sampling_rate", "video_fps")
_MARK = re.compile(
    r'"(pose_?)?world_?landmarks"|"pose_keypoints_[23]d"|"keypoints_?3d"|"keypoints":\s*\[\s*[-\d]'
    r'|"[^"]{0,40}(right|left|r|l)[_ .]?wrist"|"[^"]{0,20}wrist[_ .]?(right|left|r|l)"|"(pose_?)?landmarks?"',
    re.IGNORECASE,
)


def _read_pose_json(path: Path) -> list[SkeletonTable]:
    """Frames of landmarks: in a list or by number, landmarks in a list or by name; or keypoints in images."""
    value = _read_json(path, _POSE_EXPECTED)
    rate = _first_number(value, _RATES)
    frames = _frames_of(value)
    flat = _coco(value) or _openpose(frames)
    rows: list[_Row] = []
    is_world = False
    for at, (key, frame) in enumerate(frames if flat is None else flat):
        number = _first_number(frame, _NUMBERS)
        digits = re.search(r"\d+(\.\d+)?", key)
        points, world = (frame.get("points"), False) if flat is not None else _points_in(frame)
        is_world |= world
        number = float(digits.group()) if digits else number if np.isfinite(number) else at
        named = _points_by_name(points) if flat is None else _keypoints(path, points)
        rows.append((frame, number, 0.0, named))
    if not any(row[3] for row in rows):
        raise RecordingError(f"{path} should be {_POSE_EXPECTED}, and no frame of it has points in space.")
    raw = _raw(path, rows)
    raw.rate_hz = rate if 1.0 <= rate <= 1000.0 else None
    assert raw.time is not None and raw.frame is not None
    known = np.isfinite(raw.time)
    in_use = known.mean() > 0.5 and np.ptp(raw.time[known]) > 0  # most rows have one, and they go on
    if flat is not None:
        raw.frame = raw.frame - raw.frame[0]
        in_use = in_use and bool(raw.time_unit or time_unit("", raw.time, CAMERA_RATES))
    raw.time = raw.time if in_use else None
    if flat is not None:
        return raw.skeletons(Conventions(PIXELS, CameraFrame.OPTICAL))
    names = {re.sub(r"[^a-z0-9]", "", name.lower()) for row in rows for name in row[3]}
    if is_world or {"rightpinky", "leftpinky"} & names or raw.is_about_hips():
        return raw.landmarks(is_world)
    return raw.skeletons(Conventions(states="share"))


POSE_JSON = Format(
    "pose-json",
    "MediaPipe or OpenPose landmarks in space, JSON",
    "skeleton",
    "JSON with pose_world_landmarks, pose_keypoints_3d, or a wrist by name",
    lambda head: head.text.lstrip()[:1] in ("{", "[") and bool(_MARK.search(head.text)),
    _read_pose_json,
)


def _frames_of(value: Any) -> list[tuple[str, Any]]:
    """The frames with what the file calls them ("" where it does not)."""
    if not isinstance(value, Mapping):
        return [("", frame) for frame in value] if isinstance(value, list) else []
    for name in _FRAMES:
        inner = value.get(name)
        if isinstance(inner, list | Mapping) and len(inner) and not _is_points(inner):
            return _frames_of(inner)
    columns = {
        str(key): rows
        for key, rows in value.items()
        if isinstance(rows, list) and rows and isinstance(rows[0], list | Mapping) and joint_name(str(key))
    }
    if columns:  # a list of positions by joint
        count = max(map(len, columns.values()))
        return [
            ("", {key: rows[at] for key, rows in columns.items() if at < len(rows)}) for at in range(count)
        ]
    if value and all(re.fullmatch(r"(?i)(frame[_ ]?)?\d+(\.\d+)?", str(key)) for key in value):
        return [(str(key), frame) for key, frame in value.items()]
    return [("", value)]


def _is_points(value: Any) -> bool:
    """Whether a value is the points of one frame: by name, or a list of them."""
    if isinstance(value, Mapping):
        return any((meaning := joint_name(str(key))) is not None and meaning.joint for key in value)
    first = value[0] if value else None
    return isinstance(first, Mapping) and "x" in first


def _points_in(frame: Any, depth: int = 0) -> tuple[Any, bool]:
    """The points of a frame, and whether they are called world landmarks."""
    if depth > 5:
        return None, False
    if isinstance(frame, Mapping):
        if _is_points(frame):
            return frame, False
        if world := _first(frame, _WORLD):
            return _points_in(world, depth + 1)[0], True
        people = frame.get("people", frame.get("persons", frame.get("instances")))
        if isinstance(people, list):
            return _points_in(people[0] if people and isinstance(people[0], Mapping) else None, depth + 1)
        return _points_in(_first(frame, _POINTS), depth + 1)
    if not isinstance(frame, list):
        return None, False
    is_one = len(frame) == 1 and isinstance(frame[0], list | Mapping) and "x" not in frame[0]
    return _points_in(frame[0], depth + 1) if is_one else (frame, False)  # one pose of several


#: Scores of COCO's visibilities: not labelled, labelled and hidden, visible.
_VISIBILITY = (0.0, 0.3, 1.0)
#: Frames of keypoints: name, and what it states with `points` beside it, u, v and score by turns.
_Flat = list[tuple[str, dict[str, Any]]]


def _openpose(frames: list[tuple[str, Any]]) -> _Flat | None:
    """The first person's keypoints of OpenPose by frame; None where the file contains none in images."""
    found: _Flat = []
    for key, frame in frames:
        people = frame.get("people") if isinstance(frame, Mapping) else None
        person = (people[0] if people else None) if isinstance(people, list) else frame
        flat = person.get("pose_keypoints_2d") if isinstance(person, Mapping) else None
        if isinstance(person, Mapping) and person.get("pose_keypoints_3d"):
            return None
        stated = frame if isinstance(frame, Mapping) else {}
        found.append((key, {**stated, "points": flat if isinstance(flat, list) else []}))
    return found if any(frame["points"] for _, frame in found) else None


def _coco(value: Any) -> _Flat | None:
    """Of COCO's annotations or results the surest person of each image, by the images' numbers."""
    listed = value.get("annotations") if isinstance(value, Mapping) else value
    if not isinstance(listed, list) or not listed:
        return None
    if not all(isinstance(one, Mapping) and "image_id" in one and "keypoints" in one for one in listed):
        return None
    best: dict[float, tuple[float, list[float]]] = {}
    if isinstance(value, Mapping):
        best = {_number(image.get("id")): (-1.0, []) for image in value.get("images", [])}
    for one in listed:
        image, score = _number(one["image_id"]), _number(one.get("score", one.get("area", 0.0)))
        if image not in best or score > best[image][0]:
            best[image] = score, list(one["keypoints"])
    ordered = sorted((image, flat) for image, (_, flat) in best.items() if np.isfinite(image))
    thirds = {flat for _, each in ordered for flat in each[2::3]}
    if max(thirds, default=0.0) > 1.0 and thirds <= {0, 1, 2}:  # labelled by hand
        for _, flat in ordered:
            flat[2::3] = [_VISIBILITY[int(one)] for one in flat[2::3]]
    return [(f"{image:f}", {"points": flat}) for image, flat in ordered]


def _keypoints(path: Path, flat: list[Any]) -> dict[str, Point]:
    """Keypoints by name; what was not found is stored as 0, 0 with a score of 0, and left out."""
    count = len(flat) // 3
    if flat and count not in POINT_SETS:
        raise RecordingError(
            f"{path}: {count} keypoints per person are not a known set"
            f" ({', '.join(map(str, POINT_SETS))} are); export COCO's 17 or OpenPose's BODY_25."
        )
    rows = [tuple(map(_number, flat[at : at + 3])) for at in range(0, 3 * count, 3)]
    points = {name: (u, v, s, s) for name, (u, v, s) in zip(POINT_SETS.get(count, []), rows, strict=False)}
    return {name: point if point[3] > 0.0 else NOTHING for name, point in points.items()}
