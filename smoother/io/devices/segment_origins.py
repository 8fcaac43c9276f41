"""Joints from the segments' poses that Theia3D writes into C3D files (group ROTATION)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...errors import RecordingError
from ...runtime.inputs import check_input
from ..markers.c3d import would_crash
from ..markers.trajectories import METRES, Markers
from .head import shown

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
    """Origins of the arms' segments: the shoulder is the upper arm's, elbow the forearm's, wrist the hand's.

    Parameters
    ----------
    path : Path
        A C3D file.

    Returns
    -------
    Markers or None
        Named as joint centres; None where the file has no poses of arms.

    Raises
    ------
    RecordingError
        The file is damaged.
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
        raise RecordingError(f"{path}: neither ROTATION:RATE nor POINT:RATE tells the frames' times")
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
