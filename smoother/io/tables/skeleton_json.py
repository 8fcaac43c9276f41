"""Skeletons in JSON: body tracking of a Kinect, landmarks of MediaPipe, keypoints in OpenPose's manner."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ...runtime.inputs import check_input
from .image_keypoints import keypoint_rows, keypoint_table
from .joints import AZURE, BLAZEPOSE, POINT_SETS, JointName, joint_name
from .skeleton_formats import (
    about_hips,
    azure_states,
    inferred_throughout,
    landmarks_in_metres,
    share_states,
)
from .skeletons import Conventions, RawSkeleton, SkeletonTable
from .table import FileHead, Format, decode


def read_json(path: Path, expected: str) -> Any:
    """The value that a JSON file contains; a line a value makes a list."""
    check_input(path, RecordingError)
    try:
        text = decode(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        rows = _lines(text)
        if rows is not None:
            return rows
        if isinstance(error, RecursionError):
            raise RecordingError(
                f"{path} should be {expected}, and its JSON is nested too deeply to be one; export it again."
            ) from None
        where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise RecordingError(
            f"{path} should be {expected}, and its JSON is cut off{where}; copy or export it again."
        ) from None


def _lines(text: str) -> list[Any] | None:
    """The values of JSON lines; None where the text is none. A last line that is cut off is left out."""
    lines = [line for line in text.splitlines() if line.strip()]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            rows.append(json.loads(line))
        except (ValueError, RecursionError):
            if number < len(lines) or not rows:
                return None
    return rows if len(rows) > 1 else None


def xyz_of(value: Any) -> tuple[float, float, float, float]:
    """x, y, z and confidence of a point as a list or a mapping; nan for what is missing."""
    if isinstance(value, Mapping):
        small = {str(key).lower(): entry for key, entry in value.items()}
        inner = next(
            (small[key] for key in ("position", "pos", "xyz", "location", "point") if key in small), None
        )
        if inner is not None:
            x, y, z, _ = xyz_of(inner)
        else:
            x, y, z = (number(small.get(axis)) for axis in "xyz")
        names = (
            "visibility",
            "confidence",
            "confidence_level",
            "state",
            "trackingstate",
            "tracking_state",
            "score",
        )
        share = next((number(small[name]) for name in names if name in small), float("nan"))
        return x, y, z, share
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) >= 3:
        x, y, z, *rest = value[:4]
        return number(x), number(y), number(z), number(rest[0]) if rest else float("nan")
    return (float("nan"),) * 4


def number(value: Any) -> float:
    """A number, or nan for anything else (words of confidence count 0 to 3)."""
    if isinstance(value, bool):
        return float("nan")
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e300 else float("nan")
    if isinstance(value, str):
        word = value.lower().rpartition("_")[2]
        levels = {
            "none": 0.0,
            "nottracked": 0.0,
            "low": 1.0,
            "inferred": 1.0,
            "medium": 2.0,
            "tracked": 2.0,
            "high": 3.0,
        }
        if word in levels:
            return levels[word]
        try:
            return float(value)
        except ValueError:
            return float("nan")
    return float("nan")


def points(values: Sequence[tuple[float, float, float, float]]) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) and confidences (N,)."""
    table = np.array(values, dtype=float).reshape(-1, 4)
    return table[:, :3].copy(), table[:, 3].copy()


_POSITIONS = ("joint_positions", "jointPositions", "joints", "positions", "skeleton")
_KINECT_TIMES = (
    ("timestamp_usec", 1e-6), ("timestamp_us", 1e-6), ("device_timestamp_usec", 1e-6),
    ("timestamp_ms", 1e-3), ("timestamp_s", 1.0), ("timestamp", None), ("time", None),
)  # fmt: skip
_BODY = ("body_id", "bodyId", "id", "body_idx", "tracking_id", "trackingId")
_CONFIDENCES = ("confidence_levels", "joint_confidences", "joint_confidence", "confidences", "confidence")
_KINECT_EXPECTED = "JSON of body tracking (frames with bodies and joint_positions)"


@dataclass
class _Rows:
    """What is gathered, one row per frame and body."""

    time: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    body: list[float] = field(default_factory=list)
    scale: float | None = None
    joints: dict[str, list[tuple[float, float, float, float]]] = field(default_factory=dict)


def _is_kinect_json(head: FileHead) -> bool:
    """Whether the fields' names are in the first 64 kB."""
    text = head.text.lstrip()
    if not text.startswith(("{", "[")):
        return False
    return (
        '"joint_positions"' in text
        or ('"bodies"' in text and '"timestamp' in text)
        or "k4abt" in text.lower()
    )


def read_kinect_json(path: Path) -> list[SkeletonTable]:
    """`frames`, each with `timestamp_usec` and `bodies`, each with `body_id` and `joint_positions` in mm."""
    value = read_json(path, _KINECT_EXPECTED)
    frames = value.get("frames") if isinstance(value, Mapping) else value
    if not isinstance(frames, list) or not frames:
        raise RecordingError(
            f"{path} should be {_KINECT_EXPECTED}, and has no list of frames; export it again."
        )
    names = value.get("joint_names") if isinstance(value, Mapping) else None
    order = [str(name) for name in names] if isinstance(names, list) and names else list(AZURE)
    rows = _Rows()
    for count, frame in enumerate(frames):
        if isinstance(frame, Mapping):
            _add_frame(rows, frame, count, order)
    return _raw_bodies(path, rows).skeletons(Conventions("mm", CameraFrame.OPTICAL))


KINECT_JSON = Format(
    key="azure-kinect-json",
    title="Azure Kinect or Orbbec body tracking, JSON",
    kind="skeleton",
    recognised_by="JSON with joint_positions, or with bodies and timestamp_usec",
    recognises=_is_kinect_json,
    read=read_kinect_json,
)


def _add_frame(rows: _Rows, frame: Mapping[str, Any], count: int, order: list[str]) -> None:
    name, scale = next(
        ((name, scale) for name, scale in (*_KINECT_TIMES, *_TIMES) if name in frame), ("", None)
    )
    rows.scale = rows.scale or scale
    bodies = frame.get("bodies", frame.get("skeletons", []))
    bodies = bodies if isinstance(bodies, list) else []
    numbered = [(_number_of(body), body) for body in bodies if isinstance(body, Mapping)]
    for body_number, body in numbered or [(float("nan"), {})]:
        rows.time.append(number(frame.get(name)))
        rows.frame.append(number(frame.get("frame_id", frame.get("frame_number", count))))
        rows.body.append(body_number)
        _add_body(rows, body, order)


def _number_of(body: Mapping[str, Any]) -> float:
    value = next((number(body[name]) for name in _BODY if name in body), 0.0)
    return value if 0 <= value < 2**32 - 1 else float("nan")


def _add_body(rows: _Rows, body: Mapping[str, Any], order: list[str]) -> None:
    """Joints of one body; those that it lacks get nan."""
    value: Any = next((body[name] for name in _POSITIONS if name in body), [])
    if isinstance(value, Mapping):
        named = {str(name): xyz_of(point) for name, point in value.items()}
    elif isinstance(value, list):
        own = [str(p["name"]) for p in value if isinstance(p, Mapping) and isinstance(p.get("name"), str)]
        names = own if len(own) == len(value) else order
        named = {name: xyz_of(point) for name, point in zip(names, value, strict=False)}
    else:
        named = {}
    levels = next((body[name] for name in _CONFIDENCES if isinstance(body.get(name), list)), None)
    if levels is not None:
        named = {
            name: (*point[:3], number(level))
            for (name, point), level in zip(named.items(), levels, strict=False)
        }
    before = len(rows.time) - 1
    nothing = (float("nan"),) * 4
    for name in named:
        rows.joints.setdefault(name, [nothing] * before)
    for name, values in rows.joints.items():
        values.append(named.get(name, nothing))


def _raw_bodies(path: Path, rows: _Rows) -> RawSkeleton:
    raw = RawSkeleton(path, {}, time_scale=rows.scale)
    time = np.array(rows.time)
    raw.time = time if np.isfinite(time).any() else None
    raw.frame = np.array(rows.frame)
    raw.body = np.array(rows.body)
    for name, values in rows.joints.items():
        meaning: JointName | None = joint_name(name)
        if meaning is None:
            continue
        position, confidence = points(values)
        if not meaning.joint:
            raw.rest.append((meaning, position))
            continue
        raw.position[meaning.joint] = position
        if np.isfinite(confidence).any():
            raw.state[meaning.joint] = azure_states(confidence)
    inferred_throughout(raw)
    return raw


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
    "frames",
    "positions",
    "poses",
    "results",
    "data",
    "motion",
    "pose_data",
    "instance_info",
    "records",
)
#: Further names of a frame's time, in a unit that its rate shows.
_TIMES = tuple(
    (name, None)
    for name in (
        *("time_in_ms", "unix_ms", "unix", "epoch", "kinect_time", "hostTime", "systemTime", "captured_at"),
        *("Tick", "ticks", "TimeSpan", "relative_time", "relativeTime", "timestamp_ns", "deviceTimestamp"),
    )
)
_POSE_TIMES = (
    ("timestamp_ms", 1e-3), ("timestampMs", 1e-3), ("time_ms", 1e-3), ("timestamp_us", 1e-6),
    ("timestamp_s", 1.0), ("time_s", 1.0), ("time_sec", 1.0), ("timestamp", None), ("time", None),
    ("t", None),
)  # fmt: skip
_NUMBERS = ("frame", "frame_number", "frameNumber", "frame_index", "frame_id", "frame_idx", "index")
_RATES = ("fps", "frame_rate", "frameRate", "framerate", "sampling_rate", "video_fps")
_MARK = re.compile(
    r'"(pose_?)?world_?landmarks"|"pose_keypoints_[23]d"|"keypoints_?3d"|"keypoints":\s*\[\s*[-\d]'
    r'|"[^"]{0,40}(right|left|r|l)[_ .]?wrist"|"[^"]{0,20}wrist[_ .]?(right|left|r|l)"|"(pose_?)?landmarks?"',
    re.IGNORECASE,
)


@dataclass
class _Frames:
    """What is gathered, one row per frame."""

    time: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    scale: float | None = None
    world: bool = False
    points: list[dict[str, tuple[float, float, float, float]]] = field(default_factory=list)


def _is_pose_json(head: FileHead) -> bool:
    """Whether the fields' names are in the first 64 kB."""
    return head.text.lstrip().startswith(("{", "[")) and bool(_MARK.search(head.text))


def read_pose_json(path: Path) -> list[SkeletonTable]:
    """Frames of landmarks: in a list or by number, landmarks in a list or by name."""
    value = read_json(path, _POSE_EXPECTED)
    frames, listed = _Frames(), _frames_of(value)
    for key, frame in listed:
        _add(frames, key, frame, path)
    contents = [frame for _, frame in listed]
    rows = keypoint_rows(value, list(zip(frames.frame, frames.time, contents, strict=True)))
    if rows is not None:
        return [keypoint_table(path, rows, frames.scale, _rate(value))]
    if not any(frames.points):
        raise RecordingError(f"{path} should be {_POSE_EXPECTED}, and no frame of it has points in space.")
    raw = _raw_landmarks(path, frames)
    raw.rate_hz = _rate(value)
    names = {_flat(name) for frame in frames.points for name in frame}
    if frames.world or {"rightpinky", "leftpinky"} & names or about_hips(raw):
        return landmarks_in_metres(raw, frames.world)
    return raw.skeletons(Conventions())


POSE_JSON = Format(
    key="pose-json",
    title="MediaPipe or OpenPose landmarks in space, JSON",
    kind="skeleton",
    recognised_by="JSON with pose_world_landmarks, pose_keypoints_3d, or a wrist by name",
    recognises=_is_pose_json,
    read=read_pose_json,
)


def _rate(value: Any) -> float | None:
    """Frames per second that a file states."""
    if not isinstance(value, Mapping):
        return None
    rate = next((number(value[name]) for name in _RATES if name in value), float("nan"))
    return rate if 1.0 <= rate <= 1000.0 else None


def _flat(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum())


def _frames_of(value: Any) -> list[tuple[str, Any]]:
    """The frames with what the file calls them ("" where it does not)."""
    if isinstance(value, Mapping):
        for name in _FRAMES:
            inner = value.get(name)
            if isinstance(inner, list | Mapping) and len(inner) and not _is_points(inner):
                return _frames_of(inner)
        lists = {str(key): rows for key, rows in value.items() if isinstance(rows, list) and rows}
        columns = {
            key: rows
            for key, rows in lists.items()
            if joint_name(key) is not None and isinstance(rows[0], list | Mapping)
        }
        if columns:  # a list of positions by joint
            count = max(map(len, columns.values()))
            return [
                ("", {key: rows[at] for key, rows in columns.items() if at < len(rows)})
                for at in range(count)
            ]
        if value and all(_is_number(str(key)) for key in value):
            return [(str(key), frame) for key, frame in value.items()]
        return [("", value)]
    return [("", frame) for frame in value] if isinstance(value, list) else []


def _is_number(text: str) -> bool:
    return bool(re.fullmatch(r"(frame[_ ]?)?\d+(\.\d+)?", text, re.IGNORECASE))


def _is_points(value: Any) -> bool:
    """Whether a value is the points of one frame: by name, or a list of them."""
    if isinstance(value, Mapping):
        return any((meaning := joint_name(str(key))) is not None and meaning.joint for key in value)
    first = value[0] if value else None
    return isinstance(first, Mapping) and "x" in first


def _add(frames: _Frames, key: str, frame: Any, path: Path) -> None:
    time, scale, count = float("nan"), None, float("nan")
    if isinstance(frame, Mapping):
        name, scale = next(
            ((name, scale) for name, scale in (*_POSE_TIMES, *_TIMES) if name in frame), ("", None)
        )
        time = number(frame.get(name))
        count = next((number(frame[name]) for name in _NUMBERS if name in frame), float("nan"))
    digits = re.search(r"\d+(\.\d+)?", key)
    value, world = _points_in(frame, path)
    frames.time.append(time)
    frames.frame.append(
        float(digits.group()) if digits else count if np.isfinite(count) else len(frames.frame)
    )
    frames.scale = frames.scale or scale
    frames.world |= world
    frames.points.append(_by_name(value))


def _points_in(frame: Any, path: Path, depth: int = 0) -> tuple[Any, bool]:
    """The points of a frame, and whether they are called world landmarks."""
    if depth > 5:
        return None, False
    if isinstance(frame, Mapping):
        if _is_points(frame):
            return frame, False
        for name in _WORLD:
            if frame.get(name):
                return _points_in(frame[name], path, depth + 1)[0], True
        people = frame.get("people", frame.get("persons", frame.get("instances")))
        if isinstance(people, list):
            if people and isinstance(people[0], Mapping):
                return _points_in(people[0], path, depth + 1)
            return None, False
        for name in _POINTS:
            if frame.get(name):
                return _points_in(frame[name], path, depth + 1)
        return None, False
    if isinstance(frame, list) and frame and isinstance(frame[0], list):
        if len(frame) == 1:  # one pose of several
            return _points_in(frame[0], path, depth + 1)
        return frame, False
    if isinstance(frame, list) and len(frame) == 1 and isinstance(frame[0], Mapping) and "x" not in frame[0]:
        return _points_in(frame[0], path, depth + 1)
    return (frame, False) if isinstance(frame, list) else (None, False)


def _by_name(value: Any) -> dict[str, tuple[float, float, float, float]]:
    """Points by name; none where there are no points, or this many that their order is not known."""
    if isinstance(value, Mapping):
        return {str(name): xyz_of(point) for name, point in value.items()}
    if not isinstance(value, list) or not value:
        return {}
    if isinstance(value[0], int | float):  # x, y, z, c one after the other
        width = next((w for w in (4, 3) if len(value) % w == 0 and len(value) // w in POINT_SETS), 0)
        if not width:
            return {}
        value = [value[at : at + width] for at in range(0, len(value), width)]
    own = [
        str(point["name"])
        for point in value
        if isinstance(point, Mapping) and isinstance(point.get("name"), str)
    ]
    names = own if len(own) == len(value) else POINT_SETS.get(len(value), [])
    return {name: xyz_of(point) for name, point in zip(names, value, strict=False)}


def _raw_landmarks(path: Path, frames: _Frames) -> RawSkeleton:
    raw = RawSkeleton(path, {}, time_scale=frames.scale)
    time = np.array(frames.time)
    raw.time = time if np.isfinite(time).mean() > 0.5 and np.ptp(time[np.isfinite(time)]) > 0 else None
    raw.frame = np.array(frames.frame)
    nothing = (float("nan"),) * 4
    order = {name: at for at, name in enumerate(BLAZEPOSE)}
    for name in sorted(
        {name for frame in frames.points for name in frame}, key=lambda name: order.get(name, 99)
    ):
        meaning = joint_name(name)
        if meaning is None or (meaning.joint and meaning.kind == "skin"):
            continue
        position, confidence = points([frame.get(name, nothing) for frame in frames.points])
        if not meaning.joint:
            raw.rest.append((meaning, position))
            continue
        raw.position[meaning.joint] = position
        if np.isfinite(confidence).any():
            raw.state[meaning.joint] = share_states(confidence)
    return raw
