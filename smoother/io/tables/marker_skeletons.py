"""Skeletons of motion capture: C3D and TRC files whose markers are named as joints."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
from ...runtime.inputs import check_input
from .joints import JointName, joint_name
from .markers import Markers, read_c3d, read_trc, would_crash
from .skeletons import (
    SkeletonTable,
    axis_words,
    down_of,
    frame_of,
    half_arm,
    require_arm,
    unit_by_arm,
    up_axis,
)
from .table import FileHead, Format, shown
from .units import METRES

#: A position farther away is a damaged number.
_FARTHEST_M = 1e6
#: What is used as a joint if there are several, the best first.
_ORDER = ("centre", "joint", "skin")


def skeleton_of(markers: Markers, path: Path, y_up: bool) -> SkeletonTable:
    """The arms that a file of markers shows."""
    in_reach = (np.abs(markers.position) < _FARTHEST_M).all(axis=2, keepdims=True)
    markers = replace(markers, position=np.where(in_reach, markers.position, np.nan))
    named = [(joint_name(name), column) for column, name in enumerate(markers.names)]
    points = [(name, markers.position[:, column]) for name, column in named if name is not None]
    by_joint: dict[str, list[tuple[JointName, int]]] = {}
    for name, column in named:
        if name is not None and name.joint:
            by_joint.setdefault(name.joint, []).append((name, column))
    position, sentences, skin = {}, [], False
    for joint in sorted(by_joint):
        rows, words, is_skin = _taken(by_joint[joint], markers)
        if np.isfinite(rows).all(axis=1).any():
            position[joint] = rows
            sentences.append(f"{joint} is {words}")
            skin |= is_skin
    require_arm(position, path, "markers", list(markers.names))
    notes = [*markers.notes, "; ".join(sentences) + "."]
    if skin:
        notes.append(
            "Skin markers are 1 to 4 cm from the joint centre: expect lengths that differ from the bones'."
        )
    notes += _in_metres(position, markers.unit, path)
    is_camera = any("k4abt" in name.lower() for name in markers.names)
    frame, down, words = _axes(points, y_up, is_camera)
    notes.append(words)
    state = {
        joint: np.where(np.isfinite(rows).all(axis=1), JointState.TRACKED, JointState.NOT_TRACKED).astype(
            np.int8
        )
        for joint, rows in position.items()
    }
    rate = markers.rate_hz if np.isfinite(markers.rate_hz) else None
    return SkeletonTable(0, markers.t_s, position, state, frame, down, rate, units=markers.unit, notes=notes)


def _in_metres(position: dict[str, FloatArray], unit: str, path: Path) -> list[str]:
    """Correct positions whose unit is not the one that the header states; what is to be said of it."""
    length = half_arm(position)
    if not np.isfinite(length):
        return []
    fits = unit_by_arm(position)
    if fits is None:
        raise RecordingError(
            f"{path}: upper arms and forearms are {length:.3g} m long in the unit that the file states"
            f" ({unit}); export it again, with lengths in m or mm."
        )
    if fits[1] != 1.0:
        for joint in position:
            position[joint] = position[joint] * fits[1]
        return [
            f"The file states {unit}, and half an arm would be {length:.3g} m long: positions were multiplied"
            f" by {fits[1]:g}, which makes it {length * fits[1]:.2f} m."
        ]
    return []


def _taken(candidates: list[tuple[JointName, int]], markers: Markers) -> tuple[FloatArray, str, bool]:
    """Positions (F, 3) of a joint, words for what they are, whether they are on the skin."""
    for kind in _ORDER:
        of_kind = [(name, column) for name, column in candidates if name.kind == kind]
        first = {name.pair: column for name, column in reversed(of_kind)}
        if "a" in first and "b" in first:
            a, b = first["a"], first["b"]
            middle = 0.5 * (markers.position[:, a] + markers.position[:, b])
            return middle, f"the middle of {markers.names[a]} and {markers.names[b]}", True
        if first:
            column = next(iter(first.values()))
            what = {"centre": "the joint centre", "joint": "the marker", "skin": "the skin marker"}[kind]
            return markers.position[:, column], f"{what} {markers.names[column]}", kind == "skin"
    raise ValueError("no candidate")


def _axes(
    points: list[tuple[JointName, FloatArray]], y_up: bool, camera: bool
) -> tuple[CameraFrame | None, FloatArray | None, str]:
    """Convention of the axes, direction of down, and a sentence."""
    upright = up_axis(points)
    if upright is not None:
        return (
            frame_of(*upright, camera),
            down_of(*upright),
            f"Assumed axes: {axis_words(*upright)} (the body is then upright in most frames).",
        )
    if camera:
        return (
            CameraFrame.OPTICAL,
            None,
            "Assumed axes: the depth camera's (y down); the body does not show them.",
        )
    if y_up:
        return (
            None,
            down_of(1, 1),
            "Assumed axes: y up, as usual in this format; the body does not show them.",
        )
    return (
        None,
        None,
        "Which axis is up is not known: the file does not state it and the body does not show it.",
    )


#: What the origin of a segment is, by the segment's name without side.
_ORIGINS = {
    **dict.fromkeys(("uarm", "upperarm", "humerus"), "shoulder"),
    **dict.fromkeys(("larm", "forearm", "lowerarm", "radius"), "elbow"),
    "hand": "wrist",
    "pelvis": "pelvis",
    "head": "head",
    **dict.fromkeys(("thigh", "uleg"), "hip"),
    "foot": "ankle",
}
_SEGMENT = re.compile(r"(?:([lr])(?:eft|ight)?_)?([a-z]+?)(?:_([lr]))?(?:_4x4)?", re.IGNORECASE)
#: The group's name lies among the parameters, at the file's beginning.
_PARAMETER_BYTES = 262_144


def read_segment_origins(path: Path) -> Markers | None:
    """Origins of the arms' segments: the shoulder is the upper arm's, elbow the forearm's, wrist the
    hand's.
    """
    check_input(path, RecordingError)
    with open(path, "rb") as file:
        if b"ROTATION" not in file.read(_PARAMETER_BYTES):
            return None
    import ezc3d

    if would_crash(path):
        raise RecordingError(f"{path}: a damaged C3D file; export it again")
    try:
        file = ezc3d.c3d(str(path))
        group, point = file["parameters"]["ROTATION"], file["parameters"]["POINT"]
        labels = [str(label) for label in group["LABELS"]["value"]]
        poses = np.asarray(file["data"]["rotations"], dtype=float)
        rates = [*(group["RATE"]["value"] if "RATE" in group else ()), *point["RATE"]["value"]]
        units = point["UNITS"]["value"] if "UNITS" in point else ["mm"]
    except Exception as error:  # whatever the library throws at a damaged file
        raise RecordingError(
            f"{path}: a damaged C3D file ({shown(str(error), 80)}); export it again"
        ) from error
    named = {
        at: name
        for at, label in enumerate(labels[: poses.shape[2]])
        if (name := _joint_of(label)) is not None
    }
    if not any("elbow" in name for name in named.values()):
        return None
    rate = next((float(rate) for rate in rates if np.isfinite(rate) and rate > 0), float("nan"))
    if not rate > 0:
        raise RecordingError(f"{path}: neither ROTATION:RATE nor POINT:RATE gives the frames' times")
    unit = str(units[0]).strip().lower() if len(units) else "mm"
    position = np.moveaxis(poses[:3, 3][:, list(named)], (0, 1, 2), (2, 1, 0)) * METRES.get(unit, 0.001)
    used = ", ".join(labels[at] for at in named)
    note = f"{path.name}: joints are the origins of the segments {shown(used, 120)}."
    position = np.where((position == 0).all(axis=2, keepdims=True), np.nan, position)
    t_s = np.arange(len(position)) / rate
    return Markers(tuple(named.values()), t_s, position, rate, unit, source=str(path), notes=(note,))


def _joint_of(label: str) -> str | None:
    """The joint's centre at a segment's origin (`r_uarm_4X4` is `r_shoulder_center`); None for others."""
    match = _SEGMENT.fullmatch(label.strip())
    joint = _ORIGINS.get(match.group(2).lower()) if match else None
    if match is None or joint is None:
        return None
    side = (match.group(1) or match.group(3) or "").lower()
    if joint in ("pelvis", "head"):
        return joint
    return f"{side}_{joint}_center" if side and joint in ("shoulder", "elbow", "wrist") else f"{side}_{joint}"


#: Processor types of a C3D file's parameters: Intel, DEC, SGI.
_PROCESSORS = (84, 85, 86)


def _is_c3d(head: FileHead) -> bool:
    """Whether the file begins as a C3D file does."""
    if len(head.raw) < 512 or head.raw[1] != 0x50 or head.raw[0] < 2:
        return False
    parameters = head.raw[512 * (head.raw[0] - 1) :][:4]
    return len(parameters) < 4 or parameters[3] in _PROCESSORS


def read_c3d_skeleton(path: Path) -> list[SkeletonTable]:
    """C3D files whose points are named as joints."""
    markers = read_segment_origins(path) or read_c3d(path)
    return [skeleton_of(markers, path, y_up=False)]


C3D_SKELETON = Format(
    key="c3d",
    title="C3D model markers or Theia3D segments",
    kind="skeleton",
    recognised_by="the second byte 0x50, and a block of parameters where the first byte points",
    recognises=_is_c3d,
    read=read_c3d_skeleton,
)


def _is_trc(head: FileHead) -> bool:
    """Whether a line of markers' names is among the first ones."""
    first = [line.strip(' \t,;"').lower() for line in head.lines[:12]]
    return any(line.startswith("frame#") for line in first)


def read_trc_skeleton(path: Path) -> list[SkeletonTable]:
    """TRC files whose markers are named as joints; y is up as OpenSim has it, where the body agrees."""
    return [skeleton_of(read_trc(path), path, y_up=True)]


TRC_SKELETON = Format(
    key="trc",
    title="TRC (OpenCap, Pose2Sim, Theia)",
    kind="skeleton",
    recognised_by="a line that begins with Frame#, above the names of markers",
    recognises=_is_trc,
    read=read_trc_skeleton,
)
