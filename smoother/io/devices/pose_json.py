"""JSON of landmarks and keypoints: MediaPipe's, and those in OpenPose's manner."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from .joint_names import BLAZEPOSE, POINT_SETS, joint_name
from .json_file import number, points, read_json, xyz_of
from .mediapipe import about_hips, landmarks_in_metres
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions, RawSkeleton
from .wide_skeleton import share_states

_EXPECTED = "JSON of landmarks by frame (pose_world_landmarks, or joints by name)"
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
_TIMES = (
    ("timestamp_ms", 1e-3), ("timestampMs", 1e-3), ("time_ms", 1e-3), ("timestamp_us", 1e-6),
    ("timestamp_s", 1.0), ("time_s", 1.0), ("time_sec", 1.0), ("timestamp", None), ("time", None),
    ("t", None),
)  # fmt: skip
_NUMBERS = ("frame", "frame_number", "frameNumber", "frame_index", "frame_id", "frame_idx", "index")
_RATES = ("fps", "frame_rate", "frameRate", "framerate", "sampling_rate", "video_fps")
_MARK = re.compile(
    r'"(pose_?)?world_?landmarks"|"pose_keypoints_[23]d"|"keypoints_?3d"'
    r'|"[^"]{0,40}(right|left|r|l)[_ .]?wrist"|"[^"]{0,20}wrist[_ .]?(right|left|r|l)"|"(pose_?)?landmarks?"',
    re.IGNORECASE,
)


@dataclass
class _Frames:
    """What is gathered, a row a frame."""

    time: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    scale: float | None = None
    world: bool = False
    points: list[dict[str, tuple[float, float, float, float]]] = field(default_factory=list)


@dataclass(frozen=True)
class PoseJson:
    """Frames of landmarks: in a list or by number, landmarks in a list or by name.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "pose-json"
    title: str = "MediaPipe or OpenPose landmarks in space, JSON"
    kind: str = "skeleton"
    recognised_by: str = "JSON with pose_world_landmarks, pose_keypoints_3d, or a wrist by name"

    def recognises(self, head: FileHead) -> bool:
        """Whether the fields' names are in the first 64 kB."""
        return head.text.lstrip().startswith(("{", "[")) and bool(_MARK.search(head.text))

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read the skeleton.

        Raises
        ------
        RecordingError
            The file breaks off, the landmarks are parts of the image, or no arm is in it.
        """
        value = read_json(path, _EXPECTED)
        frames = _Frames()
        for key, frame in _frames_of(value):
            _add(frames, key, frame, path)
        if not any(frames.points):
            raise RecordingError(f"{path} should be {_EXPECTED}, and no frame of it has points in space.")
        raw = _raw(path, frames)
        if isinstance(value, Mapping):
            rate = next((number(value[name]) for name in _RATES if name in value), float("nan"))
            raw.rate_hz = rate if 1.0 <= rate <= 1000.0 else None
        names = {_flat(name) for frame in frames.points for name in frame}
        if frames.world or {"rightpinky", "leftpinky"} & names or about_hips(raw):
            return landmarks_in_metres(raw, frames.world)
        return raw.skeletons(Conventions())


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
        name, scale = next(((name, scale) for name, scale in _TIMES if name in frame), ("", None))
        time = number(frame.get(name))
        count = next((number(frame[name]) for name in _NUMBERS if name in frame), float("nan"))
        if "pose_keypoints_2d" in frame and "pose_keypoints_3d" not in frame:
            raise RecordingError(
                f"{path} holds keypoints in the image (pose_keypoints_2d), which are no place in space;"
                " triangulate them (Pose2Sim, OpenPose with --3d) and give the file that makes."
            )
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
                if "pose_keypoints_2d" in people[0] and not people[0].get("pose_keypoints_3d"):
                    _add(_Frames(), "", people[0], path)  # refuses
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
    """Points by name; none where there are no points, or so many that their order is not known."""
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


def _raw(path: Path, frames: _Frames) -> RawSkeleton:
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
