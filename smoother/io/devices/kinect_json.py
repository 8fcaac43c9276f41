"""JSON of the Azure Kinect's offline processor, and of programs that write its fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RecordingError
from ...recording import CameraFrame
from .joint_names import AZURE, JointName, joint_name
from .json_file import number, points, read_json, xyz_of
from .protocol import FileHead, SkeletonTable
from .raw_skeleton import Conventions, RawSkeleton
from .wide_skeleton import azure_states, inferred_throughout

_POSITIONS = ("joint_positions", "jointPositions", "joints", "positions", "skeleton")
_TIMES = (
    ("timestamp_usec", 1e-6), ("timestamp_us", 1e-6), ("device_timestamp_usec", 1e-6),
    ("timestamp_ms", 1e-3), ("timestamp_s", 1.0), ("timestamp", None), ("time", None),
)  # fmt: skip
_BODY = ("body_id", "bodyId", "id", "body_idx", "tracking_id", "trackingId")
_CONFIDENCES = ("confidence_levels", "joint_confidences", "joint_confidence", "confidences", "confidence")
_EXPECTED = "JSON of body tracking (frames with bodies and joint_positions)"


@dataclass
class _Rows:
    """What is gathered, a row a frame and body."""

    time: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    body: list[float] = field(default_factory=list)
    scale: float | None = None
    joints: dict[str, list[tuple[float, float, float, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class KinectJson:
    """`frames`, each with `timestamp_usec` and `bodies`, each with `body_id` and `joint_positions` in mm.

    Attributes
    ----------
    key, title, kind, recognised_by : str
        See `DeviceFormat`.
    """

    key: str = "azure-kinect-json"
    title: str = "Azure Kinect or Orbbec body tracking, JSON"
    kind: str = "skeleton"
    recognised_by: str = "JSON with joint_positions, or with bodies and timestamp_usec"

    def recognises(self, head: FileHead) -> bool:
        """Whether the fields' names are in the first 64 kB."""
        text = head.text.lstrip()
        if not text.startswith(("{", "[")):
            return False
        return (
            '"joint_positions"' in text
            or ('"bodies"' in text and '"timestamp' in text)
            or "k4abt" in text.lower()
        )

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies.

        Raises
        ------
        RecordingError
            The file breaks off, has other fields, or no arm is in it.
        """
        value = read_json(path, _EXPECTED)
        frames = value.get("frames") if isinstance(value, Mapping) else value
        if not isinstance(frames, list) or not frames:
            raise RecordingError(f"{path} should be {_EXPECTED}, and has no list of frames; export it again.")
        names = value.get("joint_names") if isinstance(value, Mapping) else None
        order = [str(name) for name in names] if isinstance(names, list) and names else list(AZURE)
        rows = _Rows()
        for count, frame in enumerate(frames):
            if isinstance(frame, Mapping):
                _add_frame(rows, frame, count, order)
        return _raw(path, rows).skeletons(Conventions("mm", CameraFrame.OPTICAL))


def _add_frame(rows: _Rows, frame: Mapping[str, Any], count: int, order: list[str]) -> None:
    name, scale = next(((name, scale) for name, scale in _TIMES if name in frame), ("", None))
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


def _raw(path: Path, rows: _Rows) -> RawSkeleton:
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
