"""The arm's motion by motion capture, in its own frame {E} and on its own clock; which markers make a joint.

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
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.file import toml_document

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...io.tables.markers import Markers
from ...linalg import nearest_rotation
from ...measures.motion import one_sign
from ...recording import Truth
from ..metrics import BRIDGED_S
from ..words import said

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


_said = partial(said, "reference")
#: Windows tried for smoothing the plate's pose, s; 0.16 s is a low-pass at about 10 Hz, as labs use it.
SMOOTH_S = (0.06, 0.08, 0.12, 0.16, 0.2, 0.24, 0.32, 0.4)
#: A map whose plate differs from the one that was seen by more than this is of another plate, m (rms).
OTHER_PLATE_M = 0.005
#: Joints next to each other are apart by this, m; a file whose unit is wrong shows by it.
BONE_M = (0.08, 0.8)
#: Markers on skin and a shoulder that shifts change an upper arm's length by less (10 to 90 %), m.
LENGTH_CHANGES_M = 0.05
#: Markers that fit one body in fewer of the frames that show three of them are not on one.
LEAST_RIGID = 0.5


@dataclass(frozen=True)
class MocapMotion:
    """Joint centres, landmarks and the plate's pose."""

    t_s: FloatArray  # (n,) s: on the mocap's clock
    joints: dict[str, FloatArray] = field(default_factory=dict)  # dict of (n, 3) m: positions by name, in {E}
    # dict of (n, 3) m: Positions by name, in {E}; nan where a marker of theirs was not seen
    landmarks: dict[str, FloatArray] = field(default_factory=dict)
    R_E_P: FloatArray | None = None  # (n, 3, 3) and (n, 3) m: pose of the plate's axes {P}
    p_E_P: FloatArray | None = None
    R_A_P: FloatArray | None = None  # (3, 3) and (3,) m: the plate's axes in the IMU's
    p_A_P: FloatArray | None = None
    source: str = "the motion capture"  # What to call it in messages
    notes: tuple[str, ...] = ()  # What was decided, one sentence each

    @property
    def quaternion(self) -> FloatArray:
        """(N, 4) qw, qx, qy, qz of `R_E_P`; nan where there is none."""
        result = np.full((len(self.t_s), 4), np.nan)
        if self.R_E_P is not None:
            known = np.isfinite(self.R_E_P).all(axis=(1, 2))
            result[known] = Rotation.from_matrix(self.R_E_P[known]).as_quat(scalar_first=True)
        return result


def motion_of_markers(markers: Markers, marker_map: MarkerMap) -> MocapMotion:
    """Joint centres as means of their markers, the plate as a rigid body."""

    def places(names: Sequence[str]) -> FloatArray:
        index = find_markers(names, markers.names, marker_map.source, markers.source)
        return markers.position[:, index]

    plate = MocapMotion(markers.t_s, source=markers.source, notes=markers.notes)
    positions = {joint: places(names) for joint, names in marker_map.joints.items()}
    _check_unit(positions, markers)
    if marker_map.plate:
        plate = _with_plate(plate, places(marker_map.plate), marker_map)
    joints = {joint: each.mean(axis=1) for joint, each in positions.items()}
    landmarks = {name: places([marker])[:, 0] for name, marker in marker_map.landmarks.items()}
    notes = list(plate.notes)
    for joint, centre in joints.items():
        if not np.isfinite(centre).any():
            raise RecordingError(
                f"{markers.source}: the markers of the {joint} ({', '.join(marker_map.joints[joint])}) are"
                " never seen together; correct the map"
            )
    notes += _exchanged(joints)
    shares = [np.isfinite(centre).all(axis=1).mean() for centre in joints.values()]
    poor = [f"{name} {100 * share:.0f} %" for name, share in zip(joints, shares, strict=True) if share < 0.8]
    if poor:
        notes.append(_said("incomplete", joints=", ".join(poor)))
    return replace(plate, joints=joints, landmarks=landmarks, notes=tuple(notes))


def _check_unit(positions: dict[str, FloatArray], markers: Markers) -> None:
    """Refuse bones of impossible length, from markers (N, M, 3) by joint."""
    for one, other in (("elbow", "wrist"), ("shoulder", "elbow")):
        if one not in positions or other not in positions:
            continue
        length = np.linalg.norm(positions[one].mean(axis=1) - positions[other].mean(axis=1), axis=1)
        length = length[np.isfinite(length)]
        if len(length) and not BONE_M[0] < float(np.median(length)) < BONE_M[1]:
            raise RecordingError(
                f"{markers.source}: {one} and {other} are {float(np.median(length)):.3g} m apart; check that"
                f" the file's coordinates are in its unit, {markers.unit}, and the marker map"
            )


def _exchanged(joints: dict[str, FloatArray]) -> list[str]:
    """Whether lengths show that elbow and wrist are called by each other's name."""
    if not {"elbow", "wrist"} <= set(joints):
        return []
    elbow, wrist = joints["elbow"], joints["wrist"]

    def apart(one: FloatArray, other: FloatArray) -> FloatArray:
        length = np.linalg.norm(one - other, axis=1)
        return length[np.isfinite(length)]

    signs = []
    if "hand" in joints:
        near, far = apart(joints["hand"], elbow), apart(joints["hand"], wrist)
        if len(near) and len(far) and np.median(near) < np.median(far):
            near_cm, far_cm = (100 * float(np.median(each)) for each in (near, far))
            signs.append(f"the hand is {near_cm:.0f} cm from the elbow and {far_cm:.0f} cm from the wrist")
    if "shoulder" in joints:
        steady, changing = apart(joints["shoulder"], wrist), apart(joints["shoulder"], elbow)
        if len(steady) and len(changing):
            own, other = (float(np.subtract(*np.percentile(each, [90, 10]))) for each in (steady, changing))
            if other > LENGTH_CHANGES_M and own < 0.5 * other:
                signs.append(
                    f"the upper arm's length changes by {100 * other:.0f} cm, shoulder to wrist by"
                    f" {100 * own:.0f} cm"
                )
    return [_said("exchanged", signs="; ".join(signs))] if signs else []


def motion_of_truth(truth: Truth, source: str) -> MocapMotion:
    """A reference of poses as if a plate whose axes are the IMU's had been captured."""
    quaternion = truth.quaternion
    R_E_P = np.full((len(truth), 3, 3), np.nan)
    known = np.isfinite(quaternion).all(axis=1)
    R_E_P[known] = Rotation.from_quat(quaternion[known], scalar_first=True).as_matrix()
    position = np.where(truth.score[:, None], truth.position, np.nan)
    return MocapMotion(truth.t_s, truth.joints, {}, R_E_P, position, np.eye(3), np.zeros(3), source=source)


def _with_plate(motion: MocapMotion, positions: FloatArray, marker_map: MarkerMap) -> MocapMotion:
    """Add the plate's pose: its shape from the frames, its axes from the map where that states them."""
    shape = find_shape(positions)
    if np.isfinite(shape).all(axis=1).sum() < 3:
        raise RecordingError(
            f"{motion.source}: the plate's markers ({', '.join(marker_map.plate)}) are never seen three at a"
            " time, or lie on a line, so the plate has no pose"
        )
    shape, R_A_P, p_A_P = _in_stated_axes(shape, marker_map, motion.source)
    poses = follow(shape, positions)
    answered = np.isfinite(poses.residual_m)
    tried = np.isfinite(positions).all(axis=2).sum(axis=1) >= 3
    if not answered.sum() >= LEAST_RIGID * tried.sum():
        raise RecordingError(
            f"{motion.source}: the plate's markers ({', '.join(marker_map.plate)}) do not move as one body;"
            " correct the map"
        )
    rms_mm = 1000 * np.sqrt(np.nanmean(poses.residual_m**2))
    notes = [_said("plate", markers=len(shape), percent=100 * answered.mean(), rms_mm=rms_mm)]
    if poses.mistaken:
        notes.append(_said("mistaken", count=poses.mistaken))
    rotation, position = smoothed(motion.t_s, poses.rotation, poses.position)
    posed = replace(motion, R_E_P=rotation, p_E_P=position, notes=(*motion.notes, *notes))
    return replace(posed, R_A_P=R_A_P, p_A_P=p_A_P)


def _in_stated_axes(
    shape: FloatArray, marker_map: MarkerMap, source: str
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """The shape in the IMU's axes where the map places its markers, else in {P}; and those axes in {A}."""
    if marker_map.plate_A:
        placed = np.array([marker_map.plate_A.get(name, np.full(3, np.nan)) for name in marker_map.plate])
        both = np.isfinite(placed).all(axis=1) & np.isfinite(shape).all(axis=1)
        R, p = fit_poses(shape, placed[None], both[None])
        in_imu = shape @ R[0].T + p[0]
        off = float(np.sqrt(((in_imu - placed)[both] ** 2).sum(axis=1).mean()))
        if off > OTHER_PLATE_M:
            raise RecordingError(
                f"{marker_map.source}: [imu_plate] places the markers {1000 * off:.1f} mm (rms) from where"
                f" {source} has them on the plate; check the places, their unit (m) and their names"
            )
        return in_imu, np.eye(3), np.zeros(3)
    axes, origin = plate_axes(shape)
    return (shape - origin) @ axes, marker_map.R_A_P, marker_map.p_A_P


def smoothed(t_s: FloatArray, rotation: FloatArray, position: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses low-passed without delay, not across missing frames, by cubics (Savitzky, Golay)."""
    known = np.isfinite(rotation).all(axis=(1, 2)) & np.isfinite(position).all(axis=1)
    rotation, position = rotation.copy(), position.copy()
    rotation[~known], position[~known] = np.nan, np.nan
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        return rotation, position
    period = float(np.median(np.diff(t_s)))
    # a missing frame would shift the samples against the window, so the parts end there
    parts = np.split(rows, np.flatnonzero(np.diff(t_s[rows]) > min(1.5 * period, BRIDGED_S)) + 1)
    quaternions = [one_sign(Rotation.from_matrix(rotation[part]).as_quat()) for part in parts]
    for part, smooth in zip(parts, _best_smooth(quaternions, period), strict=True):
        rotation[part] = Rotation.from_quat(smooth).as_matrix()
    for part, smooth in zip(parts, _best_smooth([position[part] for part in parts], period), strict=True):
        position[part] = smooth
    return rotation, position


def _best_smooth(parts: list[FloatArray], period_s: float) -> list[FloatArray]:
    """Each part (n, d) smoothed with the window that predicts best; shorter ones as they are."""
    from scipy.signal import savgol_coeffs, savgol_filter

    best, least = parts, np.inf
    windows = sorted({2 * round(0.5 * length / period_s) + 1 for length in SMOOTH_S})
    windows = [window for window in windows if window >= 5]
    scored = [part for part in parts if windows and len(part) >= windows[-1]]
    for window in windows:
        own_share = savgol_coeffs(window, 3)[window // 2]
        half = windows[-1] // 2  # the ends of a part are fitted from one side: not scored
        error = sum(
            float(
                (((part - savgol_filter(part, window, 3, axis=0)) / (1 - own_share))[half:-half] ** 2).sum()
            )
            for part in scored
        )
        if scored and error < least:
            least = error
            best = [savgol_filter(part, window, 3, axis=0) if len(part) >= window else part for part in parts]
    return best
