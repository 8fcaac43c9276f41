"""The arms' joints out of named markers: which stands for which joint."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
from ..markers.trajectories import Markers
from .arm_lengths import axis_words, down_of, frame_of, half_arm, unit_by_arm, up_axis
from .head import shown
from .joint_names import JointName, joint_name
from .protocol import SkeletonTable

#: A position farther away is a damaged number.
_FARTHEST_M = 1e6
#: What stands for a joint if there are several, the best first.
_ORDER = ("centre", "joint", "skin")


def skeleton_of(markers: Markers, path: Path, y_up: bool) -> SkeletonTable:
    """The arms that a file of markers shows.

    Joint centres are taken before joints of a skeleton, those before the middle of two skin markers, and
    that before one skin marker.

    Parameters
    ----------
    markers : Markers
        As read, in metres.
    path : Path
        The file, for messages.
    y_up : bool
        The format is written with y up as a rule, which counts where the body does not show it.

    Returns
    -------
    SkeletonTable
        Joints, the direction of down, and notes of what was taken.

    Raises
    ------
    RecordingError
        No marker has the name of an arm's joint, or too few.
    """
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
            "Markers on the skin lie 1 to 4 cm beside the joint's centre: expect lengths that are not a"
            " bone's."
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
    """Mend positions whose unit is not the one that the header states; what is to be said of it."""
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


def require_arm(position: dict[str, FloatArray], path: Path, what: str, names: list[str]) -> None:
    """Refuse a skeleton of which no side has an elbow and a wrist (or a hand).

    Raises
    ------
    RecordingError
        It is so; the message says which joints are needed and what the file names.
    """
    for side in ("left", "right"):
        if f"elbow_{side}" in position and ({f"wrist_{side}", f"hand_{side}"} & position.keys()):
            return
    listed = shown(", ".join(names), 120)
    raise RecordingError(
        f"{path}: no arm with an elbow and a wrist is among its {what} ({listed}); export shoulder, elbow and"
        " wrist of the arm under such names as RShoulder, RElbow and RWrist."
    )


def _taken(candidates: list[tuple[JointName, int]], markers: Markers) -> tuple[FloatArray, str, bool]:
    """Positions (F, 3) of a joint, words for what they are, whether they lie on the skin."""
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
            f"Axes count as {axis_words(*upright)}: so the body stands or sits in most frames.",
        )
    if camera:
        return (
            CameraFrame.OPTICAL,
            None,
            "Axes count as the depth camera's (y down): the body does not show it.",
        )
    if y_up:
        return None, down_of(1, 1), "Axes count as y up, as the format has it; the body does not show it."
    return (
        None,
        None,
        "Which axis is up is not known: the file does not state it and the body does not show it.",
    )
