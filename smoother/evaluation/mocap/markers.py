"""Markers of motion capture: which make a joint, the rigid bodies that they form, gaps filled.

::

    [markers]
    shoulder = ["ACR"]                   # the mean of a list is the joint's centre
    elbow = ["EL_MED", "EL_LAT"]
    wrist = ["WR_RAD", "WR_ULN"]
    hand = ["HA_RAD", "HA_ULN"]
    imu_plate = ["IMU1", "IMU2", "IMU3", "IMU4"]   # rigid with the IMU, three or more
    medial_epicondyle = "EL_MED"         # optional, with lateral_epicondyle: the elbow's own axis
    lateral_epicondyle = "EL_LAT"
    radial_styloid = "WR_RAD"            # optional, with ulnar_styloid: the forearm's own axes
    ulnar_styloid = "WR_ULN"

    [imu_plate]                          # optional: the plate's markers in the IMU's axes, m
    IMU1 = [-0.041, -0.026, 0.004]

    [plate]                              # optional, instead: the plate's axes in the IMU's
    R_A_P = [1.0, 0.0, 0.0, 0.0]         # qw, qx, qy, qz
    p_A_P = [0.0, 0.0, 0.0]              # m

The plate's axes {P}: origin at the mean of its markers, x from the first to the second, z normal to the
plane of the first three (x cross the way to the third), y = z cross x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.file import toml_document

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...linalg import nearest_rotation, runs
from ..metrics import STAMP_S

#: Joints that a map may name.
MAPPED_JOINTS = ("shoulder", "elbow", "wrist", "hand")
#: Single markers on the bones.
LANDMARKS = ("medial_epicondyle", "lateral_epicondyle", "radial_styloid", "ulnar_styloid")
PLATE = "imu_plate"


@dataclass(frozen=True)
class MarkerMap:
    """Names of markers by what they represent."""

    joints: dict[str, tuple[str, ...]]  # Names of the markers whose mean is the joint's centre, by joint
    plate: tuple[str, ...] = ()  # Names of the markers on the IMU's plate; empty without one
    landmarks: dict[str, str] = field(default_factory=dict)  # A marker's name by landmark
    # dict of (3,) m: Places of the plate's markers in the IMU's axes, by name; empty where unknown
    plate_A: dict[str, FloatArray] = field(default_factory=dict)
    R_A_P: FloatArray | None = None  # (3, 3) and (3,) m: rotation and origin of the plate's axes in the IMU's
    p_A_P: FloatArray | None = None
    source: str = "the marker map"  # What to call the map in messages


def read_marker_map(path: Path | str) -> MarkerMap:
    """Read a map of markers."""
    path = Path(path)
    document = toml_document(path, str(path))
    _known(document, ("markers", PLATE, "plate"), path, "the file")
    named = document.get("markers")
    if not isinstance(named, dict) or not named:
        raise RecordingError(f'{path}: a [markers] table is missing, such as wrist = ["RAD", "ULN"]')
    _known(named, (*MAPPED_JOINTS, PLATE, *LANDMARKS), path, "[markers]")
    lists = {key: _names(value, key, path) for key, value in named.items()}
    landmarks = {key: lists[key][0] for key in LANDMARKS if key in lists}
    plate = lists.get(PLATE, ())
    if plate and len(set(plate)) < 3:
        raise RecordingError(f"{path}: {PLATE} names {len(set(plate))} markers; a pose needs three or more")
    if "plate" in document and PLATE in document:
        raise RecordingError(f"{path}: [plate] and [{PLATE}] define the same thing twice; keep one of them")
    own = document.get("plate", {})
    _known(own, ("R_A_P", "p_A_P"), path, "[plate]")
    places = {
        name: _vector(value, 3, f"[{PLATE}] {name}", path) for name, value in document.get(PLATE, {}).items()
    }
    if places and len(set(places) & set(plate)) < 3:
        raise RecordingError(f"{path}: [{PLATE}] places fewer than three of the markers that {PLATE} names")
    R_A_P = None
    if "R_A_P" in own:
        quaternion = _vector(own["R_A_P"], 4, "[plate] R_A_P", path)
        if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
            raise RecordingError(f"{path}: [plate] R_A_P must be a unit quaternion [qw, qx, qy, qz]")
        R_A_P = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    p_A_P = _vector(own["p_A_P"], 3, "[plate] p_A_P", path) if "p_A_P" in own else None
    joints = {joint: lists[joint] for joint in MAPPED_JOINTS if joint in lists}
    return MarkerMap(joints, plate, landmarks, places, R_A_P, p_A_P, str(path))


def map_by_names(names: Sequence[str], source: str) -> MarkerMap:
    """The map of a file whose markers are called as joints are."""
    plain = {_bare(name).lower(): name for name in names}
    joints: dict[str, tuple[str, ...]] = {joint: (plain[joint],) for joint in MAPPED_JOINTS if joint in plain}
    if not joints:
        raise RecordingError(
            f"{source}: state with --markers MAP.toml which markers make a joint; it has {_listed(names)}"
        )
    return MarkerMap(joints, source=source)


def find_markers(wanted: Sequence[str], names: Sequence[str], map_source: str, source: str) -> list[int]:
    """Places of the wanted markers among a file's names; a subject's prefix (`Subj:RWRA`) may be left out."""
    columns = []
    for name in wanted:
        exact = [k for k, other in enumerate(names) if other == name]
        matches = exact or [k for k, other in enumerate(names) if _bare(other) == _bare(name)]
        if not exact and ":" in name:  # with a prefix, only names without one will do
            matches = [k for k in matches if ":" not in names[k]]
        if not matches:
            raise RecordingError(f"{map_source}: {source} has no marker {name!r}; it has {_listed(names)}")
        if len(matches) > 1:
            several = ", ".join(names[k] for k in matches)
            raise RecordingError(f"{map_source}: {name!r} may be any of {several}; name it with its subject")
        columns.append(matches[0])
    return columns


def _bare(name: str) -> str:
    return name.rsplit(":", 1)[-1].strip()


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:60])
    return f"{shown} and {len(names) - 60} more" if len(names) > 60 else shown


def _known(table: Any, keys: Sequence[str], path: Path, where: str) -> None:
    if not isinstance(table, dict):
        raise RecordingError(f"{path}: {where} must be a table")
    for key in table:
        if key not in keys:
            raise RecordingError(f"{path}: {where} has the key {key!r}; it may have {', '.join(keys)}")


def _names(value: Any, key: str, path: Path) -> tuple[str, ...]:
    listed: Any = [value] if isinstance(value, str) else value
    good = isinstance(listed, list) and listed and all(isinstance(item, str) for item in listed)
    if not good:
        raise RecordingError(f'{path}: {key} must be a list of marker names, such as ["RAD", "ULN"]')
    return tuple(item.strip() for item in listed)


def _vector(value: Any, size: int, key: str, path: Path) -> FloatArray:
    values = numbers(value, size)
    if values is None:
        raise RecordingError(f"{path}: {key} must be {size} numbers")
    return values


def numbers(value: Any, size: int) -> FloatArray | None:
    """A list of this many finite numbers as an array (size,); None where it is none."""
    good = isinstance(value, list) and len(value) == size
    if not good or not all(isinstance(x, int | float) and np.isfinite(x) for x in value):
        return None
    return np.array(value, dtype=np.float64)


#: A marker this far off its place on the body is mistaken (swapped, or a ghost), m.
MISTAKEN_M = 0.005
#: The seen markers must spread this far across their longest line, m (rms), or the pose could turn about it.
LEAST_WIDTH_M = 0.004
#: Frames that a shape is found from.
_MOST_FRAMES = 2000


@dataclass(frozen=True)
class ClusterMotion:
    """The poses of a rigid cluster."""

    rotation: FloatArray  # (n, 3, 3) and (n, 3) m: `p_E = rotation p_P + position`; nan where unknown
    position: FloatArray
    residual_m: FloatArray  # (n,) m: rms distance of the seen markers from the body
    used: BoolArray  # bool (n, m): the marker was used
    mistaken: int  # Single samples that were rejected


def fit_poses(
    shape: FloatArray, observed: FloatArray, weight: FloatArray | BoolArray
) -> tuple[FloatArray, FloatArray]:  # rotation (n, 3, 3) and (n, 3) m, position (n, 3, 3) and (n, 3) m
    """Least-squares poses (N, 3, 3), (N, 3) that bring a shape to the markers seen (Kabsch 1976)."""
    weight = np.asarray(weight, dtype=np.float64)
    shape = np.broadcast_to(np.where(np.isfinite(shape), shape, 0.0), observed.shape)
    observed = np.where(weight[..., None] > 0, observed, 0.0)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    centre_shape = np.einsum("nm,nmi->ni", weight, shape) / total
    centre_seen = np.einsum("nm,nmi->ni", weight, observed) / total
    from_centre, to_centre = shape - centre_shape[:, None], observed - centre_seen[:, None]
    rotation = nearest_rotation(np.einsum("nm,nmi,nmj->nij", weight, to_centre, from_centre))
    return rotation, centre_seen - np.einsum("nij,nj->ni", rotation, centre_shape)


def find_shape(position: FloatArray) -> FloatArray:  # position (n, m, 3) m
    """The shape (M, 3) m of a rigid cluster from its motion, in its own axes; nan for what never showed."""
    finite: BoolArray = np.asarray(np.isfinite(position).all(axis=2))
    rows = np.flatnonzero(finite.sum(axis=1) >= 3)
    if not len(rows):
        return np.full(position.shape[1:], np.nan)
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), _MOST_FRAMES)).astype(int)]
    position, finite = position[rows], finite[rows]
    shape = _typical(position, finite)
    for _ in range(8):
        known = np.isfinite(shape).all(axis=1)
        weight = finite & known
        good = (weight.sum(axis=1) >= 3) & (_width(shape, weight) >= LEAST_WIDTH_M)
        if not good.any():
            break
        rotation, origin = fit_poses(shape, position[good], weight[good])
        in_body = np.einsum("nji,nmj->nmi", rotation, position[good] - origin[:, None])
        for marker in np.flatnonzero(finite[good].any(axis=0)):
            shape[marker] = np.nanmedian(in_body[:, marker], axis=0)
    return np.asarray(shape - np.nanmean(shape, axis=0))


def _typical(position: FloatArray, finite: BoolArray) -> FloatArray:
    """Of the frames with the most markers, the one (M, 3) whose distances are most like the others'."""
    count = finite.sum(axis=1)
    fullest = finite[np.argmax(count)]
    whole = np.flatnonzero((finite == fullest).all(axis=1))
    whole = whole[np.linspace(0, len(whole) - 1, min(len(whole), 200)).astype(int)]
    places = position[whole][:, fullest]
    apart = np.linalg.norm(places[:, :, None] - places[:, None, :], axis=3)
    off = np.abs(apart - np.median(apart, axis=0)).max(axis=(1, 2))
    shape = np.full(position.shape[1:], np.nan)
    shape[fullest] = places[np.argmin(off)]
    return shape


def follow(shape: FloatArray, position: FloatArray) -> ClusterMotion:
    """Poses of a body of known shape (M, 3) in every frame with three markers that span a plane."""
    known = np.isfinite(shape).all(axis=1)
    weight: BoolArray = np.asarray(np.isfinite(position).all(axis=2) & known)
    count, mistaken = len(position), 0
    rotation, origin = np.full((count, 3, 3), np.nan), np.full((count, 3), np.nan)
    residual = np.full(count, np.nan)
    open_rows = np.flatnonzero(weight.sum(axis=1) >= 3)
    while len(open_rows):
        wide = _width(shape, weight[open_rows]) >= LEAST_WIDTH_M
        open_rows = open_rows[wide & (weight[open_rows].sum(axis=1) >= 3)]
        if not len(open_rows):
            break
        observed, used = position[open_rows], weight[open_rows]
        R, p, off = _fit(shape, observed, used)
        fits = off.max(axis=1) <= MISTAKEN_M
        fitted = open_rows[fits]
        rotation[fitted], origin[fitted] = R[fits], p[fits]
        residual[fitted] = np.sqrt((off[fits] ** 2).sum(axis=1) / used[fits].sum(axis=1))
        # of three markers nothing shows which one is wrong
        open_rows = open_rows[~fits & (used.sum(axis=1) > 3)]
        weight[open_rows, _odd_one(shape, position[open_rows], weight[open_rows])] = False
        mistaken += len(open_rows)
    weight[~np.isfinite(residual)] = False
    return ClusterMotion(rotation, origin, residual, weight, mistaken)


def _fit(
    shape: FloatArray, observed: FloatArray, used: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses, and how far each used marker (N, M) is off its place, m."""
    R, p = fit_poses(shape, observed, used)
    off = observed - np.einsum("nij,mj->nmi", R, shape) - p[:, None]
    return R, p, np.linalg.norm(np.where(used[..., None], off, 0.0), axis=2)


def _odd_one(shape: FloatArray, observed: FloatArray, used: BoolArray) -> IntArray:
    """The marker (N,) without which the others fit best."""
    error = np.full(used.shape, np.inf)
    for marker in range(used.shape[1]):
        without = used.copy()
        without[:, marker] = False
        rest = (_fit(shape, observed, without)[2] ** 2).sum(axis=1)
        error[:, marker] = np.where(used[:, marker], rest, np.inf)
    return np.asarray(error.argmin(axis=1))


def _width(shape: FloatArray, weight: BoolArray) -> FloatArray:
    """Rms distance (N,) m of the chosen markers from the line through them."""
    shape = np.where(np.isfinite(shape), shape, 0.0)
    weight = weight.astype(np.float64)
    total = np.maximum(weight.sum(axis=1), 1.0)
    centre = weight @ shape / total[:, None]
    second = np.einsum("nm,mi,mj->nij", weight, shape, shape) / total[:, None, None]
    spread = np.linalg.eigvalsh(second - centre[:, :, None] * centre[:, None, :])
    return np.sqrt(np.maximum(spread[:, 1], 0.0))


def plate_axes(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Axes (3, 3) and origin (3,) of {P} in the shape's own axes, as the map of markers defines them."""
    known = shape[np.isfinite(shape).all(axis=1)]
    x = known[1] - known[0]
    x = x / np.linalg.norm(x)
    ways = known[2:] - known[0]
    off_line = np.linalg.norm(ways - (ways @ x)[:, None] * x, axis=1)
    way = ways[np.argmax(off_line > LEAST_WIDTH_M)]
    z = np.cross(x, way)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z]), known.mean(axis=0)


#: What is hidden for longer stays unknown, s.
LONGEST_S = 0.75
#: Visible time on each side that is fitted, s, and how much of it must be there.
SIDE_S, LEAST_SIDE_S = 0.25, 0.1


def fill_on_plate(
    t_s: FloatArray, position: FloatArray, R_E_P: FloatArray, p_E_P: FloatArray
) -> tuple[FloatArray, int]:  # path (n, 3) m, count
    """A marker's path, filled where it was hidden for a moment."""
    on_plate = np.einsum("nji,nj->ni", R_E_P, position - p_E_P)
    seen, known, has_plate = (
        np.asarray(np.isfinite(each).all(axis=1)) for each in (position, on_plate, p_E_P)
    )
    filled, count = position.copy(), 0
    for missing in runs(~seen):
        first, stop = missing.start, missing.stop
        if first == 0 or stop == len(t_s) or t_s[stop] - t_s[first - 1] > LONGEST_S:
            continue
        begin, end = t_s[first - 1], t_s[stop]
        before = known & (t_s >= begin - SIDE_S) & (t_s <= begin + STAMP_S)
        after = known & (t_s >= end - STAMP_S) & (t_s <= end + SIDE_S)
        if not all(side.any() and np.ptp(t_s[side]) >= LEAST_SIDE_S for side in (before, after)):
            continue
        middle = 0.5 * (begin + end)
        beside = np.flatnonzero(before | after)
        fit = np.polynomial.polynomial.polyfit(t_s[beside] - middle, on_plate[beside], 3)
        rows = np.arange(first, stop)[has_plate[first:stop]]
        there = np.polynomial.polynomial.polyval(t_s[rows] - middle, fit).T
        filled[rows] = np.einsum("nij,nj->ni", R_E_P[rows], there) + p_E_P[rows]
        count += len(rows)
    return filled, count
