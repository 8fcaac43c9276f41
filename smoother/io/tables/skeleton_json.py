"""Skeletons in JSON: body tracking of a Kinect, landmarks in space, keypoints in images (OpenPose, COCO)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ...runtime.inputs import check_input
from ..recording.keypoints import states_of_scores
from .joints import (
    AZURE,
    BLAZEPOSE,
    POINT_SETS,
    TIME_WORDS,
    column_named,
    joint_name,
    time_unit_of,
)
from .skeleton_formats import (
    AZURE_AXES,
    STATE_WORDS,
    StateReader,
    about_hips,
    azure_states,
    inferred_throughout,
    landmarks_in_metres,
    share_states,
)
from .skeletons import (
    PIXELS,
    USUAL_RATE_HZ,
    Conventions,
    RawSkeleton,
    SkeletonTable,
    camera_time_scale,
    require_arm,
)
from .table import FileHead, Format, decode

#: x, y, z and the confidence of a point.
Point = tuple[float, float, float, float]
NAN = float("nan")
NOTHING: Point = (NAN,) * 4

# ---------------------------------------------------------------------------------------- values and points


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
        what = "nested too deeply to be one; export it again."
        if not isinstance(error, RecursionError):
            where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
            what = f"cut off{where}; copy or export it again."
        raise RecordingError(f"{path} should be {expected}, and its JSON is {what}") from None


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


def number(value: Any) -> float:
    """A number, or nan for anything else (words of confidence count 0 to 3)."""
    if isinstance(value, bool):
        return NAN
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e300 else NAN
    if not isinstance(value, str):
        return NAN
    word = value.lower().rpartition("_")[2]
    try:
        return STATE_WORDS[word] if word in STATE_WORDS else float(value)
    except ValueError:
        return NAN


def first_number(value: Mapping[str, Any], names: Iterable[str], default: float = NAN) -> float:
    """The number under the first of these names that is there."""
    return next((number(value[name]) for name in names if name in value), default)


_SHARES = (
    *("visibility", "confidence", "confidence_level", "state", "trackingstate", "tracking_state", "score"),
)


def point_of(value: Any) -> Point:
    """A point as a list or a mapping; nan for what is missing."""
    if isinstance(value, Mapping):
        small = {str(key).lower(): entry for key, entry in value.items()}
        names = ("position", "pos", "xyz", "location", "point")
        inner = next((small[key] for key in names if key in small), None)
        x, y, z = (number(small.get(axis)) for axis in "xyz") if inner is None else point_of(inner)[:3]
        return x, y, z, first_number(small, _SHARES)
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) >= 3:
        x, y, z, *rest = map(number, value[:4])
        return x, y, z, rest[0] if rest else NAN
    return NOTHING


def points_by_name(value: Any, order: Sequence[str] | None = None) -> dict[str, Point]:
    """Points by name; a list's by their own names, or in an order (of as many that are known)."""
    if isinstance(value, Mapping):
        return {str(name): point_of(point) for name, point in value.items()}
    if not isinstance(value, list) or not value:
        return {}
    if isinstance(value[0], int | float):  # x, y, z, c one after the other
        width = next((w for w in (4, 3) if len(value) % w == 0 and len(value) // w in POINT_SETS), 0)
        if not width:
            return {}
        value = [value[at : at + width] for at in range(0, len(value), width)]
    own = [str(p["name"]) for p in value if isinstance(p, Mapping) and isinstance(p.get("name"), str)]
    names = own if len(own) == len(value) else order or POINT_SETS.get(len(value), [])
    return {name: point_of(point) for name, point in zip(names, value, strict=False)}


@dataclass
class _Rows:
    """What is gathered, one row per frame and body."""

    time: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    body: list[float] = field(default_factory=list)
    points: list[dict[str, Point]] = field(default_factory=list)
    scale: float | None = None  # s in a unit of `time`
    world: bool = False  # They are called world landmarks

    def time_of(self, frame: Any) -> float:
        """The time of a frame, whose unit is kept."""
        names = [str(key) for key in frame] if isinstance(frame, Mapping) else []
        at = column_named(names, TIME_WORDS)
        if at is None:
            return NAN
        self.scale = self.scale or time_unit_of(names[at])
        return number(frame[names[at]])

    def raw(self, path: Path, states: StateReader) -> RawSkeleton:
        """The skeleton of all rows."""
        raw = RawSkeleton(path, time_scale=self.scale, frame=np.array(self.frame))
        order = {name: at for at, name in enumerate(BLAZEPOSE)}
        names = dict.fromkeys(name for row in self.points for name in row)
        for name in sorted(names, key=lambda name: order.get(name, 99)):
            if joint_name(name) is not None:
                table = np.array([row.get(name, NOTHING) for row in self.points], dtype=float)
                share = table[:, 3]
                raw.add(name, table[:, :3].copy(), states(share) if np.isfinite(share).any() else None)
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
        if not isinstance(frame, Mapping):
            continue
        bodies = frame.get("bodies", frame.get("skeletons", []))
        there = [body for body in bodies if isinstance(body, Mapping)] if isinstance(bodies, list) else []
        time = rows.time_of(frame)
        bodies_or_none: list[Mapping[str, Any] | None] = [*there] or [None]
        for body in bodies_or_none:
            rows.time.append(time)
            rows.frame.append(number(frame.get("frame_id", frame.get("frame_number", count))))
            of_body = NAN if body is None else first_number(body, _BODY, 0.0)
            rows.body.append(of_body if 0 <= of_body < 2**32 - 1 else NAN)
            rows.points.append({} if body is None else _joints_of(body, order))
    raw = rows.raw(path, azure_states)
    raw.time = np.array(rows.time) if np.isfinite(rows.time).any() else None
    raw.body = np.array(rows.body)
    inferred_throughout(raw)
    return raw.skeletons(AZURE_AXES)


KINECT_JSON = Format(
    key="azure-kinect-json",
    title="Azure Kinect or Orbbec body tracking, JSON",
    kind="skeleton",
    recognised_by="JSON with joint_positions, or with bodies and timestamp_usec",
    recognises=_is_kinect_json,
    read=_read_kinect_json,
)


def _joints_of(body: Mapping[str, Any], order: list[str]) -> dict[str, Point]:
    value: Any = next((body[name] for name in _POSITIONS if name in body), [])
    named = points_by_name(value, order)
    levels = next((body[name] for name in _CONFIDENCES if isinstance(body.get(name), list)), None)
    if levels is None:
        return named
    pairs = zip(named.items(), levels, strict=False)
    return {name: (x, y, z, number(level)) for (name, (x, y, z, _)), level in pairs}


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
    """Frames of landmarks: in a list or by number, landmarks in a list or by name."""
    value = read_json(path, _POSE_EXPECTED)
    rows, listed = _Rows(), _frames_of(value)
    for key, frame in listed:
        rows.time.append(rows.time_of(frame))
        count = first_number(frame, _NUMBERS) if isinstance(frame, Mapping) else NAN
        digits = re.search(r"\d+(\.\d+)?", key)
        rows.frame.append(
            float(digits.group()) if digits else count if np.isfinite(count) else len(rows.frame)
        )
        points, world = _points_in(frame)
        rows.world |= world
        rows.points.append(points_by_name(points))
    rate = first_number(value, _RATES) if isinstance(value, Mapping) else NAN
    rate_hz = rate if 1.0 <= rate <= 1000.0 else None
    keypoints = _coco(value) or _keypoints([frame for _, frame in listed], rows)
    if keypoints is not None:
        return [_keypoint_table(path, keypoints, rows.scale, rate_hz)]
    if not any(rows.points):
        raise RecordingError(f"{path} should be {_POSE_EXPECTED}, and no frame of it has points in space.")
    raw = rows.raw(path, share_states)
    time = np.array(rows.time)
    known = np.isfinite(time)
    raw.time = time if known.mean() > 0.5 and np.ptp(time[known]) > 0 else None
    raw.rate_hz = rate_hz
    names = {re.sub(r"[^a-z0-9]", "", name.lower()) for row in rows.points for name in row}
    if rows.world or {"rightpinky", "leftpinky"} & names or about_hips(raw):
        return landmarks_in_metres(raw, rows.world)
    return raw.skeletons(Conventions())


POSE_JSON = Format(
    key="pose-json",
    title="MediaPipe or OpenPose landmarks in space, JSON",
    kind="skeleton",
    recognised_by="JSON with pose_world_landmarks, pose_keypoints_3d, or a wrist by name",
    recognises=lambda head: head.text.lstrip()[:1] in ("{", "[") and bool(_MARK.search(head.text)),
    read=_read_pose_json,
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
        if world := next((frame[name] for name in _WORLD if frame.get(name)), None):
            return _points_in(world, depth + 1)[0], True
        people = frame.get("people", frame.get("persons", frame.get("instances")))
        if isinstance(people, list):
            one = people[0] if people and isinstance(people[0], Mapping) else None
            return _points_in(one, depth + 1)
        return _points_in(next((frame[name] for name in _POINTS if frame.get(name)), None), depth + 1)
    if not isinstance(frame, list):
        return None, False
    is_one = len(frame) == 1 and isinstance(frame[0], list | Mapping) and "x" not in frame[0]
    return _points_in(frame[0], depth + 1) if is_one else (frame, False)  # one pose of several


#: A row of a frame: its number, its time as written (or nan), and u, v, score one after the other.
Row = tuple[float, float, list[float]]
#: Scores of COCO's visibilities: not labelled, labelled and hidden, visible.
_VISIBILITY = (0.0, 0.3, 1.0)


def _keypoints(frames: list[Any], rows: _Rows) -> list[Row] | None:
    """The first person's keypoints of OpenPose by frame; None where the file contains none in images."""
    found: list[Row] = []
    for count, time, frame in zip(rows.frame, rows.time, frames, strict=True):
        people = frame.get("people") if isinstance(frame, Mapping) else None
        person = (people[0] if people else None) if isinstance(people, list) else frame
        flat = person.get("pose_keypoints_2d") if isinstance(person, Mapping) else None
        if isinstance(person, Mapping) and person.get("pose_keypoints_3d"):
            return None
        found.append((count, time, flat if isinstance(flat, list) else []))
    return found if any(flat for _, _, flat in found) else None


def _coco(value: Any) -> list[Row] | None:
    """Of COCO's annotations or results the surest person of each image, by the images' numbers."""
    listed = value.get("annotations") if isinstance(value, Mapping) else value
    if not isinstance(listed, list) or not listed:
        return None
    if not all(isinstance(one, Mapping) and "image_id" in one and "keypoints" in one for one in listed):
        return None
    best: dict[float, tuple[float, list[float]]] = {}
    if isinstance(value, Mapping):
        best = {number(image.get("id")): (-1.0, []) for image in value.get("images", [])}
    for one in listed:
        image, score = number(one["image_id"]), number(one.get("score", one.get("area", 0.0)))
        if image not in best or score > best[image][0]:
            best[image] = score, list(one["keypoints"])
    ordered = sorted((image, flat) for image, (_, flat) in best.items() if np.isfinite(image))
    thirds = {flat for _, each in ordered for flat in each[2::3]}
    if max(thirds, default=0.0) > 1.0 and thirds <= {0, 1, 2}:  # labelled by hand
        for _, flat in ordered:
            flat[2::3] = [_VISIBILITY[int(one)] for one in flat[2::3]]
    return [(image, NAN, flat) for image, flat in ordered]


def _keypoint_table(path: Path, rows: list[Row], scale: float | None, rate_hz: float | None) -> SkeletonTable:
    """A body whose positions are u, v and score."""
    count = next((len(flat) // 3 for _, _, flat in rows if flat), 0)
    names = POINT_SETS.get(count)
    if names is None:
        raise RecordingError(
            f"{path}: {count} keypoints per person are not a known set"
            f" ({', '.join(map(str, POINT_SETS))} are); export COCO's 17 or OpenPose's BODY_25."
        )
    table = np.full((len(rows), count, 3), np.nan)
    for at, (_, _, flat) in enumerate(rows):
        if len(flat) == 3 * count:
            table[at] = np.array([number(each) for each in flat]).reshape(count, 3)
    table[~(table[..., 2] > 0.0)] = np.nan  # what was not found is stored as 0, 0
    joints: dict[str, FloatArray] = {}
    for column, name in enumerate(names[:count]):
        meaning = joint_name(name)
        if meaning is not None and meaning.joint and meaning.kind != "skin":
            joints[meaning.joint] = table[:, column]
    require_arm(joints, path, "keypoints", list(names))
    frame, time = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    known = np.isfinite(time)
    notes = []
    if known.mean() > 0.5 and np.ptp(time[known]) > 0 and (unit := camera_time_scale(time, scale)):
        t_s = time * unit
    else:
        if rate_hz is None:
            notes.append(
                f"The file has no times: assumed {USUAL_RATE_HZ:g} frames per second; write fps into it."
            )
        t_s = (frame - frame[0]) / (rate_hz or USUAL_RATE_HZ)
    state = {name: states_of_scores(points[:, 2]) for name, points in joints.items()}
    return SkeletonTable(
        0, t_s, joints, state, CameraFrame.OPTICAL, rate_hz=rate_hz, units=PIXELS, notes=notes
    )
