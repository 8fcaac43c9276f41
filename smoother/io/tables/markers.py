"""Marker trajectories of a motion capture: TRC, C3D (by the library ezc3d) and tables, by a file's ending.

TRC is read with the habits of the programs that write it; of a still object one mean position a marker. Files
whose markers are named as joints are skeletons.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ...runtime.inputs import check_input, crashes_in_subprocess
from ..recording.streams import SkeletonTable
from .columns import read_exact
from .joints import JointName, joint_name
from .skeletons import Conventions, RawSkeleton, require_arm, without_origin
from .table import DeviceTable, FileHead, Format, file_text, shown, split_line
from .units import METRES

#: Files of marker trajectories that can be read.
MARKER_FORMATS = (".c3d", ".trc")


@dataclass(frozen=True)
class Markers:
    """Trajectories of markers in the mocap's frame {E} and on its own clock."""

    names: tuple[str, ...]  # As the file has them, without spaces around
    t_s: FloatArray  # (N,) s: frame times
    position: FloatArray  # (N, M, 3) m: nan where a marker was not seen
    rate_hz: float  # As the file states it; nan where it does not
    unit: str  # Of the file
    source: str = "the motion capture"  # What to call the file in messages
    notes: tuple[str, ...] = ()  # What was dropped or decided on reading, one sentence each

    def __len__(self) -> int:
        return len(self.t_s)


def read_markers(path: str | os.PathLike[str]) -> Markers:
    """Read a `.c3d` or `.trc` file."""
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in MARKER_FORMATS:
        raise RecordingError(f"{path}: markers are read from {' or '.join(MARKER_FORMATS)}")
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    return read_trc(path) if kind == ".trc" else read_c3d(path)


def _metres_in(unit: str, path: Path) -> float:
    """Metres in a unit of length as a file names it."""
    if (metres := METRES.get(unit.strip().strip('"').lower())) is None:
        raise RecordingError(
            f"{path}: the unit of length is '{shown(unit, 40)}', which is not known; export it in mm or m"
        )
    return metres


def _told_apart(written: list[str], path: Path) -> tuple[tuple[str, ...], list[str]]:
    """Names without spaces around and none twice (`name_2` ..), and what is to be said of them."""
    given = [name.strip() or f"unnamed_{number}" for number, name in enumerate(written, 1)]
    names: dict[str, None] = {}
    twice: dict[str, None] = {}
    for name in given:
        own, count = name, 2
        while own in names or (own != name and own in given):
            twice[name] = None
            own, count = f"{name}_{count}", count + 1
        names[own] = None
    said = f"{path.name}: several points are called {', '.join(twice)}; numbered."
    return tuple(names), [said] if twice else []


# ------------------------------------------------------------------------------------------------------ TRC

#: Times that differ from the frame rate's by no more than this were rounded on writing, s.
ROUNDED_S = 0.00051


def read_trc(path: Path) -> Markers:
    """Read a TRC file."""
    lines = file_text(path).split("\n")
    place = next((at for at, line in enumerate(lines) if _begins(line, "frame#", "frame", "#frame")), None)
    if place is None:
        raise RecordingError(
            f"{path}: not a TRC file: no line begins with Frame#, above the markers' names; export it again"
        )
    header: dict[str, str] = {}
    for above, below in pairwise(lines[:place]):  # values stand under their names
        if _begins(above, "datarate"):
            names_and_values = (split_line(line, _mark(above)) for line in (above.lower(), below))
            header = dict(zip(*names_and_values, strict=False))
    mark = _mark(lines[place])
    names, twice = _told_apart([cell for cell in split_line(lines[place], mark)[2:] if cell], path)
    if not names:
        raise RecordingError(f"{path}: the line with Frame# names no marker; export the file again")
    rows = (
        at for at, line in enumerate(lines) if at > place and line.strip(" \t,;") and not _begins(line, "x1")
    )
    first = next(rows, None)  # the line of X1 Y1 Z1 .. may be missing
    if first is None:
        raise RecordingError(f"{path}: the file names {len(names)} markers and has no frame")
    width = 2 + 3 * len(names)
    cells = DeviceTable(path, mark, (), (), ("",) * width, (), -1, first, width, lines, strict=True)
    table = cells.vectors(range(width))
    unit = header.get("units", "")
    if not unit:
        raise RecordingError(f"{path}: the header states no Units; add mm or m on its third line")
    position = without_origin(table[:, 2:].reshape(len(table), -1, 3)) * _metres_in(unit, path)
    position[~np.isfinite(position).all(axis=2)] = np.nan
    try:
        rate = float(header.get("datarate", "").replace(",", "."))
    except ValueError:
        rate = float("nan")
    t_s, notes = _times(path, table, rate)
    notes += [*(f"{path.name}: {note}" for note in cells.notes), *twice]
    stated = header.get("nummarkers", "")
    if stated.isdigit() and int(stated) != len(names):
        notes.append(f"{path.name}: the header states {stated} markers and names {len(names)}.")
    counted = header.get("numframes", "")
    if counted.isdigit() and int(counted) > len(table):
        notes.append(
            f"{path.name}: the header counts {counted} frames and the file contains {len(table)}; it may be"
            " cut off."
        )
    return Markers(names, t_s, position, rate, unit, source=str(path), notes=tuple(notes))


def _begins(line: str, *words: str) -> bool:
    first = re.split(r"[\t,; ]+", line.strip(' \t,;"'), maxsplit=1)[0]
    return first.strip().lower() in words


def _mark(line: str) -> str:
    """What parts the cells."""
    return next((mark for mark in ("\t", ";", ",") if mark in line), " ")


def _times(path: Path, table: FloatArray, rate: float) -> tuple[FloatArray, list[str]]:
    """Times (N,), s, and what is to be said of them."""
    t_s, count = table[:, 1], len(table)
    if not np.isfinite(t_s).all() or (count > 1 and not np.ptp(t_s) > 0):
        if not 0 < rate < np.inf:
            raise RecordingError(f"{path}: neither the column Time nor DataRate gives the frames' times")
        first = table[0, 0] if np.isfinite(table[0, 0]) else 1.0
        even = np.asarray((first - 1.0 + np.arange(count)) / rate, np.float64)
        return even, [f"{path.name}: times are made of DataRate."]
    back = np.flatnonzero(np.diff(t_s) <= 0)
    if len(back):
        raise RecordingError(
            f"{path}: time does not increase after {t_s[back[0]]:g} s (frame {back[0] + 1}); export it again"
        )
    if count < 2 or not rate > 0:
        return t_s, []
    regular = (np.arange(count) - 0.5 * (count - 1)) / rate + t_s.mean()
    off, real = np.abs(regular - t_s).max(), (count - 1) / np.ptp(t_s)
    if 1e-9 <= off <= ROUNDED_S:
        return regular, []  # times written with three decimals jitter
    said = f"{path.name}: DataRate states {rate:g} Hz and the times make {real:g} Hz; the times count."
    return t_s, [] if off < 1e-9 or abs(real / rate - 1) < 0.01 else [said]


# ------------------------------------------------------------------------------------------------------ C3D


def read_c3d(path: Path) -> Markers:
    """Read the points of a C3D file."""
    check_input(path, RecordingError)
    with open(path, "rb") as file:
        start = file.read(2)
    if len(start) < 2 or start[1] != 0x50:
        raise RecordingError(f"{path}: not a C3D file (its second byte is not 0x50); export it again")
    data, parameters = _load(path)
    point = parameters.get("POINT", {})
    _refuse_cut_off(path, point)
    position = np.moveaxis(np.asarray(data["points"], dtype=np.float64)[:3], (0, 1, 2), (2, 1, 0))
    frames, count = position.shape[:2]
    if not frames or not count:
        what = "no frame" if count else "no point"
        raise RecordingError(f"{path}: the C3D file has {what}; export the markers with it")
    unit = str(_first(point, "UNITS", "")).strip()
    if not unit:
        raise RecordingError(f"{path}: the parameter POINT:UNITS is missing; export the file in mm or m")
    scale = _metres_in(unit, path)
    position = without_origin(position)
    residual = np.asarray(data["meta_points"]["residuals"], dtype=np.float64)
    if residual.size == frames * count:
        position[~(residual.reshape(count, frames).T >= 0)] = np.nan
    position[~np.isfinite(position).all(axis=2)] = np.nan
    rate = float(_first(point, "RATE", np.nan))
    if not (np.isfinite(rate) and rate > 0):
        raise RecordingError(f"{path}: the parameter POINT:RATE is missing, so the frames have no times")
    names, notes = _names(point, count, path)
    return Markers(
        names,
        (int(parameters["first_frame"]) + np.arange(frames)) / rate,
        position * scale,
        rate,
        unit,
        str(path),
        tuple(notes),
    )


def _load(path: Path) -> tuple[Any, dict[str, Any]]:
    """The data, and the parameters by group and name (and `first_frame`)."""
    import ezc3d

    if crashes_in_subprocess(path, lambda file: ezc3d.c3d(str(file))):
        raise RecordingError(f"{path}: a damaged C3D file; export it again")
    try:
        file = ezc3d.c3d(str(path))
        parameters = {group: dict(file["parameters"][group]) for group in file["parameters"]}
        return file["data"], {**parameters, "first_frame": file["header"]["points"]["first_frame"]}
    except Exception as error:  # whatever the library throws at a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: a damaged C3D file ({shown(reason, 80)}); export it again") from error


def _refuse_cut_off(path: Path, point: dict[str, Any]) -> None:
    """Refuse a file that ends before the last frame that its header counts; the library makes frames up."""
    with open(path, "rb") as file:
        header = file.read(512)
        file.seek(512 * (header[0] - 1) + 3)
        big_endian = file.read(1) == b"\x56"
    words = np.frombuffer(header[:24], dtype=">u2" if big_endian else "<u2")
    points, analogs, first, last, start = (int(words[k]) for k in (1, 2, 3, 4, 8))
    size = 4 if float(_first(point, "SCALE", -1.0)) < 0 else 2
    needed = (last - first + 1) * (4 * points + analogs) * size
    held = path.stat().st_size - 512 * (start - 1)
    if last >= first and held < needed:
        share = max(held, 0) / max(needed, 1)  # a header may count no points
        raise RecordingError(
            f"{path} is cut off: it contains {100 * share:.0f} % of the frames of its header; copy it again"
        )


def _first(group: dict[str, Any], name: str, default: Any) -> Any:
    value = group.get(name, {}).get("value", [])
    return value[0] if len(value) else default


def _names(point: dict[str, Any], count: int, path: Path) -> tuple[tuple[str, ...], list[str]]:
    """A name for every point; labels go on in LABELS2, LABELS3 .."""
    groups = ["LABELS", *(f"LABELS{number}" for number in range(2, 2 + count))]
    there = (point[group]["value"] for group in takewhile(point.__contains__, groups))
    labels = [str(name) for group in there for name in group][:count]
    names, notes = _told_apart(labels + [""] * (count - len(labels)), path)
    if len(labels) < count:
        notes.insert(0, f"{path.name}: {count - len(labels)} of {count} points have no name.")
    return names, notes


# ------------------------------------------------------------------------------- positions of a still object

#: A marker that strays farther than this from its mean was not still, m (rms).
STILL_M = 0.003
#: A marker is taken if it was seen in at least this share of the frames.
LEAST_SEEN = 0.3


def read_positions(path: str | os.PathLike[str]) -> dict[str, FloatArray]:
    """Positions (3,) m by marker, in the mocap's frame."""
    path = Path(path)
    if path.suffix.lower() in MARKER_FORMATS:
        return _still(read_markers(path))
    numbers, words = read_exact(path, ["marker", *"xyz"], words=["marker"], empty=[*"xyz"])
    rows = np.stack([numbers[axis] for axis in "xyz"], axis=1)
    names, _ = _told_apart(words["marker"], path)
    known = np.asarray(np.isfinite(rows).all(axis=1), bool)
    if not known.any():
        raise RecordingError(f"{path} has no marker; give marker,x,y,z in metres, one row per marker.")
    return {name: row for name, row, good in zip(names, rows, known.tolist(), strict=True) if good}


def _still(markers: Markers) -> dict[str, FloatArray]:
    """The mean over time, about the median; refused where a marker moved."""
    means = {}
    for name, track in zip(markers.names, np.moveaxis(markers.position, 1, 0), strict=True):
        track = track[np.isfinite(track).all(axis=1)]
        if len(track) < max(1, LEAST_SEEN * len(markers)):
            continue
        away = np.linalg.norm(track - np.median(track, axis=0), axis=1)
        spread = float(np.sqrt(np.mean(away**2)))
        if spread > STILL_M:
            raise RecordingError(
                f"{markers.source}: marker {name} moved by {1e3 * spread:.0f} mm (rms) and must be still; cut"
                " the file to the moment of the images."
            )
        means[name] = track[away <= max(3 * np.median(away), 1e-6)].mean(axis=0)
    if not means:
        raise RecordingError(f"{markers.source} has no marker that was seen for long enough.")
    return means


# ------------------------------------------------------------------------------------ markers named as joints

#: What is used as a joint if there are several, the best first, and what it is called.
_KINDS = {"centre": "the joint centre", "joint": "the marker", "skin": "the skin marker"}


def _skeleton_of(markers: Markers, path: Path, up: tuple[int, int] | None) -> list[SkeletonTable]:
    """The arms that a file of markers shows; `up` counts where the body does not show it."""
    notes = list(markers.notes)
    raw = RawSkeleton(path, time=markers.t_s, time_unit="s", notes=notes)
    by_joint: dict[str, list[tuple[JointName, int]]] = {}
    for column, marker in enumerate(markers.names):
        if (name := joint_name(marker)) is not None and name.joint:
            by_joint.setdefault(name.joint, []).append((name, column))
        elif name is not None:
            raw.rest.append((name, markers.position[:, column]))
    words = {}
    for joint, candidates in sorted(by_joint.items()):
        kind = next(kind for kind in _KINDS if any(name.kind == kind for name, _ in candidates))
        columns = {name.pair: at for name, at in reversed(candidates) if name.kind == kind}
        pair = [columns[side] for side in "ab"] if {"a", "b"} <= columns.keys() else []
        used = pair or list(columns.values())[-1:]
        place = markers.position[:, used].mean(axis=1)
        raw.points[joint] = np.column_stack([place, np.full(len(place), np.nan)])
        called = " and ".join(markers.names[at] for at in used)
        words[joint] = f"{joint} is {'the middle of' if pair else _KINDS[kind]} {called}"
        if kind == "skin" and (note := _ON_SKIN) not in notes:
            notes.append(note)
    require_arm(raw.points, path, "markers", markers.names)
    seen = [text for joint, text in words.items() if np.isfinite(raw.position[joint]).any()]
    notes.insert(len(markers.notes), "; ".join(seen) + ".")
    camera = CameraFrame.OPTICAL if any("k4abt" in name.lower() for name in markers.names) else None
    tables = raw.skeletons(Conventions("m", camera, up=up))
    rate = markers.rate_hz if np.isfinite(markers.rate_hz) else None
    return [replace(table, units=markers.unit, rate_hz=rate) for table in tables]


_ON_SKIN = "Skin markers are 1 to 4 cm from the joint centre: expect lengths that differ from the bones'."
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


def _read_segment_origins(path: Path) -> Markers | None:
    """Origins of the arms' segments: shoulder is the upper arm's, elbow the forearm's, wrist the hand's."""
    check_input(path, RecordingError)
    with open(path, "rb") as file:
        if b"ROTATION" not in file.read(_PARAMETER_BYTES):
            return None
    data, parameters = _load(path)
    group, point = parameters.get("ROTATION", {}), parameters.get("POINT", {})
    try:
        labels = [str(label) for label in group["LABELS"]["value"]]
        poses = np.asarray(data["rotations"], dtype=float)
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{path}: a damaged C3D file ({error}); export it again") from error
    joints = (_joint_of(label) for label in labels[: poses.shape[2]])
    named = {at: name for at, name in enumerate(joints) if name is not None}
    if not any("elbow" in name for name in named.values()):
        return None
    rates = (float(_first(each, "RATE", np.nan)) for each in (group, point))
    rate = next((rate for rate in rates if np.isfinite(rate) and rate > 0), None)
    if rate is None:
        raise RecordingError(f"{path}: neither ROTATION:RATE nor POINT:RATE gives the frames' times")
    unit = str(_first(point, "UNITS", "mm")).strip().lower()
    position = np.moveaxis(poses[:3, 3][:, list(named)], (0, 1, 2), (2, 1, 0)) * METRES.get(unit, 0.001)
    used = shown(", ".join(labels[at] for at in named), 120)
    note = f"{path.name}: joints are the origins of the segments {used}."
    t_s = np.arange(len(position)) / rate
    names = tuple(named.values())
    return Markers(names, t_s, without_origin(position), rate, unit, source=str(path), notes=(note,))


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


C3D_SKELETON = Format(
    "c3d",
    "C3D model markers or Theia3D segments",
    "skeleton",
    "the second byte 0x50, and a block of parameters where the first byte points",
    _is_c3d,
    lambda path: _skeleton_of(_read_segment_origins(path) or read_c3d(path), path, None),
)


# y, as OpenSim has it
TRC_SKELETON = Format(
    "trc",
    "TRC (OpenCap, Pose2Sim, Theia)",
    "skeleton",
    "a line that begins with Frame#, above the names of markers",
    lambda head: any(_begins(line, "frame#") for line in head.lines[:12]),
    lambda path: _skeleton_of(read_trc(path), path, (1, 1)),
)
