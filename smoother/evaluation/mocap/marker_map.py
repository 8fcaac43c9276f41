"""Which markers make a joint: the map that `--markers` names.

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

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input, read_toml

#: Joints that a map may name.
MAPPED_JOINTS = ("shoulder", "elbow", "wrist", "hand")
#: Single markers on the bones.
LANDMARKS = ("medial_epicondyle", "lateral_epicondyle", "radial_styloid", "ulnar_styloid")
PLATE = "imu_plate"


@dataclass(frozen=True)
class MarkerMap:
    """Names of markers by what they stand for.

    Attributes
    ----------
    joints : dict[str, tuple of str]
        Names of the markers whose mean is the joint's centre, by joint.
    plate : tuple of str
        Names of the markers on the IMU's plate; empty without one.
    landmarks : dict[str, str]
        A marker's name by landmark.
    plate_A : dict[str, ndarray], shape (3,), m
        Places of the plate's markers in the IMU's axes, by name; empty where unknown.
    R_A_P, p_A_P : ndarray, shape (3, 3) and (3,), m, or None
        Rotation and origin of the plate's axes in the IMU's.
    source : str
        What to call the map in messages.
    """

    joints: dict[str, tuple[str, ...]]
    plate: tuple[str, ...] = ()
    landmarks: dict[str, str] = field(default_factory=dict)
    plate_A: dict[str, FloatArray] = field(default_factory=dict)
    R_A_P: FloatArray | None = None
    p_A_P: FloatArray | None = None
    source: str = "the marker map"


def read_marker_map(path: Path | str) -> MarkerMap:
    """Read a map of markers.

    Raises
    ------
    RecordingError
        The file is missing, not TOML, or a key or value is not one of a map; the text names the key.
    """
    path = Path(path)
    check_input(path, RecordingError)
    try:
        document = read_toml(path)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # also a number of thousands of digits
        raise RecordingError(f"{path} is not TOML: {error}") from error
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
        raise RecordingError(f"{path}: [plate] and [{PLATE}] say the same thing twice; keep one of them")
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
    """The map of a file whose markers are called as joints are.

    Raises
    ------
    RecordingError
        No marker is called as a joint is; the text lists those that are there.
    """
    plain = {_bare(name).lower(): name for name in names}
    joints: dict[str, tuple[str, ...]] = {joint: (plain[joint],) for joint in MAPPED_JOINTS if joint in plain}
    if not joints:
        raise RecordingError(
            f"{source}: say with --markers MAP.toml which markers make a joint; it holds {_listed(names)}"
        )
    return MarkerMap(joints, source=source)


def find_markers(wanted: Sequence[str], names: Sequence[str], map_source: str, source: str) -> list[int]:
    """Places of the wanted markers among a file's names; a subject's prefix (`Subj:RWRA`) may be left out.

    Raises
    ------
    RecordingError
        A marker is not there, or only with the prefixes of several subjects.
    """
    columns = []
    for name in wanted:
        exact = [k for k, other in enumerate(names) if other == name]
        matches = exact or [k for k, other in enumerate(names) if _bare(other) == _bare(name)]
        if not exact and ":" in name:  # with a prefix, only names without one will do
            matches = [k for k in matches if ":" not in names[k]]
        if not matches:
            raise RecordingError(f"{map_source}: {source} has no marker {name!r}; it holds {_listed(names)}")
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
    """A list of so many finite numbers as an array (size,); None where it is none."""
    good = isinstance(value, list) and len(value) == size
    if not good or not all(isinstance(x, int | float) and np.isfinite(x) for x in value):
        return None
    return np.array(value, dtype=np.float64)
