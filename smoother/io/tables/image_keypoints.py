"""Keypoints in images, JSON: OpenPose's `pose_keypoints_2d`, COCO's annotations and results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ..recording.keypoints import states_of_scores
from .joints import POINT_SETS, joint_name
from .skeletons import PIXELS, USUAL_RATE_HZ, ImagePoints, SkeletonTable, camera_time_scale, require_arm

#: Scores of COCO's visibilities: not labelled, labelled and hidden, visible.
VISIBILITY = (0.0, 0.3, 1.0)
#: A row of a frame: its number, its time as written (or nan), and u, v, score one after the other.
Row = tuple[float, float, list[float]]


def keypoint_rows(value: Any, frames: list[tuple[float, float, Any]]) -> list[Row] | None:
    """The first person's keypoints by frame; None where the file contains no keypoints in images."""
    coco = _coco(value)
    if coco is not None:
        return coco
    rows: list[Row] = []
    found = False
    for count, time, frame in frames:
        person = _person(frame)
        flat = person.get("pose_keypoints_2d") if isinstance(person, Mapping) else None
        if isinstance(person, Mapping) and person.get("pose_keypoints_3d"):
            return None
        found |= isinstance(flat, list)
        rows.append((count, time, flat if isinstance(flat, list) else []))
    return rows if found else None


def _person(frame: Any) -> Any:
    """The first person of a frame of OpenPose."""
    people = frame.get("people") if isinstance(frame, Mapping) else None
    if isinstance(people, list):
        return people[0] if people else None
    return frame


def _coco(value: Any) -> list[Row] | None:
    """Of COCO's annotations or results the surest person of each image, by the images' numbers."""
    listed = value.get("annotations") if isinstance(value, Mapping) else value
    if not isinstance(listed, list) or not listed:
        return None
    if not all(isinstance(one, Mapping) and "image_id" in one and "keypoints" in one for one in listed):
        return None
    best: dict[float, tuple[float, list[float]]] = {}
    if isinstance(value, Mapping):
        best = {_float(image.get("id")): (-1.0, []) for image in value.get("images", [])}
    for one in listed:
        number, score = _float(one["image_id"]), _float(one.get("score", one.get("area", 0.0)))
        if number not in best or score > best[number][0]:
            best[number] = score, list(one["keypoints"])
    ordered = sorted((number, flat) for number, (_, flat) in best.items() if np.isfinite(number))
    thirds = {flat for _, each in ordered for flat in each[2::3]}
    labelled = max(thirds, default=0.0) > 1.0 and thirds <= {0, 1, 2}
    rows = []
    for number, flat in ordered:
        if labelled:
            flat = [VISIBILITY[int(one)] if at % 3 == 2 else one for at, one in enumerate(flat)]
        rows.append((number, float("nan"), flat))
    return rows


def _float(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return float("nan")


def keypoint_table(path: Path, rows: list[Row], scale: float | None, rate_hz: float | None) -> SkeletonTable:
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
            table[at] = np.array([_float(each) for each in flat]).reshape(count, 3)
    table[~(table[..., 2] > 0.0)] = np.nan  # what was not found is stored as 0, 0
    joints: dict[str, FloatArray] = {}
    for column, name in enumerate(names[:count]):
        meaning = joint_name(name)
        if meaning is not None and meaning.joint and meaning.kind != "skin":
            joints[meaning.joint] = table[:, column]
    require_arm(joints, path, "keypoints", list(names))
    number, time = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    notes = []
    t_s = None
    known = np.isfinite(time)
    if known.mean() > 0.5 and np.ptp(time[known]) > 0 and (unit := camera_time_scale(time, scale)):
        t_s = time * unit
    else:
        if rate_hz is None:
            notes.append(
                f"The file has no times: assumed {USUAL_RATE_HZ:g} frames per second; write fps into it."
            )
        t_s = (number - number[0]) / (rate_hz or USUAL_RATE_HZ)
    state = {name: states_of_scores(points[:, 2]) for name, points in joints.items()}
    image = ImagePoints(0, 0, joints)
    return SkeletonTable(
        0, t_s, joints, state, CameraFrame.OPTICAL, rate_hz=rate_hz, units=PIXELS, notes=notes, image=image
    )
