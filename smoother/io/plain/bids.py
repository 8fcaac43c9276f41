"""A Motion-BIDS data set as a recording: camera joints by their POS channels, IMUs by ACCEL and GYRO."""

from __future__ import annotations

import csv
import json
from datetime import datetime
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
from ..devices.files import add_imu, add_skeleton
from ..recording.streams import RecordingFile
from ..tables.joint_columns import ARM
from ..tables.protocol import ImuTable, SkeletonTable

#: What channels' units are in SI.
_SCALES = {
    "m": 1.0, "cm": 0.01, "mm": 0.001, "m/s^2": 1.0, "g": 9.80665, "rad/s": 1.0, "deg/s": np.pi / 180,
}  # fmt: skip
_AXES = {"LSA": CameraFrame.KINECT, "RIA": CameraFrame.OPTICAL}


def open_bids(folder: Path, subject: str = "", session: str = "", task: str = "") -> RecordingFile:
    """Read one session.

    Parameters
    ----------
    folder : Path
        The data set.
    subject, session, task : str
        Labels; "" where there is only one.

    Returns
    -------
    file : RecordingFile
        For `write_recording`. Times are relative to the first sample; streams are as far apart as
        `acq_time` states.

    Raises
    ------
    RecordingError
        There is no such session, or it lacks skeleton or IMU.
    """
    paths = _motion_files(folder, subject, session, task)
    began = _began(paths[0])
    file = RecordingFile(paths[0], notes=[])
    starts = [began[path.name] for path in paths if path.name in began]
    if len(starts) < len(paths):
        file.notes.append(
            "No acq_time states when the streams began: the offset is estimated from the motion."
        )
        file.clocks_unrelated = True
        began, starts = {}, [0.0]
    for path in paths:
        shift_s = began.get(path.name, 0.0) - min(starts)
        columns, t_s = _columns(path)
        skeleton = _skeleton(path, columns, t_s)
        if skeleton is not None:
            topic = "/skeleton" if not file.arms else f"/skeleton_{len(file.arms) + 1}"
            add_skeleton(file, [skeleton], str(path), topic, shift_s)
        for name, imu in _imus(columns, t_s).items():
            add_imu(file, f"/imu/{name}", imu, str(path), shift_s)
    if not file.arms or not file.imus:
        has = "no skeleton of an arm" if not file.arms else "no IMU with ACCEL and GYRO"
        raise RecordingError(f"{folder}: the session has {has}; unocclude needs both, of one arm")
    return file


def _motion_files(folder: Path, subject: str, session: str, task: str) -> list[Path]:
    """The motion files of one session, in order of their names."""
    found = sorted(
        path for path in folder.glob("sub-*/**/motion/*_motion.tsv") if "derivatives" not in path.parts
    )
    if not found:
        raise RecordingError(f"{folder}: it has no sub-*/motion/*_motion.tsv of Motion-BIDS")
    wanted = {"sub": subject, "ses": session, "task": task}
    for key, label in wanted.items():
        have = sorted({_entities(path).get(key, "") for path in found})
        if not label and len(have) > 1:
            option = {"sub": "--subject", "ses": "--session", "task": "--task"}[key]
            raise RecordingError(f"{folder}: choose one with {option}: {', '.join(have)}")
        found = [path for path in found if not label or _entities(path).get(key) == label]
        if not found:
            raise RecordingError(f"{folder}: there is no {key}-{label}; there are {', '.join(have)}")
    return found


def _entities(path: Path) -> dict[str, str]:
    return dict(part.split("-", 1) for part in path.stem.split("_") if "-" in part)


def _began(path: Path) -> dict[str, float]:
    """By file name `acq_time`, s."""
    scans = next(path.parent.parent.glob("*_scans.tsv"), None)
    if scans is None:
        return {}
    times = {}
    for row in _rows(scans):
        try:
            times[Path(row["filename"]).name] = datetime.fromisoformat(row["acq_time"]).timestamp()
        except (KeyError, ValueError, OverflowError):
            continue
    return times


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            return list(csv.DictReader(file, delimiter="\t"))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path} cannot be read: {error}") from error


def _columns(path: Path) -> tuple[list[tuple[dict[str, str], FloatArray]], FloatArray]:
    """Each channel's row of channels.tsv with its values in SI, and the times, s."""
    beside = path.with_name(path.name.replace("_motion.tsv", "_channels.tsv"))
    sidecar = path.with_suffix(".json")
    if not beside.exists() or not sidecar.exists():
        missing = beside if not beside.exists() else sidecar
        raise RecordingError(f"{path}: {missing.name} is missing beside it")
    try:
        values = np.genfromtxt(path, delimiter="\t", missing_values="n/a", filling_values=np.nan, ndmin=2)
        about = json.loads(sidecar.read_text(encoding="utf-8"))
        rate_hz = float(about["SamplingFrequency"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"{path} cannot be read as Motion-BIDS: {error}") from error
    channels = _rows(beside)
    if values.shape[1] != len(channels):
        raise RecordingError(
            f"{path}: it has {values.shape[1]} columns, but {beside.name} lists {len(channels)} channels"
        )
    latency = [k for k, channel in enumerate(channels) if channel.get("type", "").upper() == "LATENCY"]
    t_s = values[:, latency[0]] if latency else np.arange(len(values)) / rate_hz
    columns = []
    for channel, column in zip(channels, values.T, strict=True):
        scale = _SCALES.get(channel.get("units", "").strip(), 1.0)
        columns.append((channel, column * scale))
    return columns, np.asarray(t_s)


def _triples(columns: list[tuple[dict[str, str], FloatArray]], kind: str) -> dict[str, FloatArray]:
    """(N, 3) by tracked point of a type of channel."""
    parts: dict[str, dict[str, FloatArray]] = {}
    for channel, values in columns:
        if channel.get("type", "").upper() == kind and channel.get("component", "") in ("x", "y", "z"):
            parts.setdefault(channel.get("tracked_point", ""), {})[channel["component"]] = values
    return {
        point: np.stack([axes[axis] for axis in "xyz"], axis=1)
        for point, axes in parts.items()
        if len(axes) == 3
    }


def _imus(columns: list[tuple[dict[str, str], FloatArray]], t_s: FloatArray) -> dict[str, ImuTable]:
    """IMUs by the names that recordings give them, such as forearm_right."""
    acc, gyro, mag = (_triples(columns, kind) for kind in ("ACCEL", "GYRO", "MAGN"))
    found = {}
    for point in acc:
        if point in gyro:
            whole = np.isfinite(acc[point]).all(axis=1) & np.isfinite(gyro[point]).all(axis=1)
            field = mag[point][whole] if point in mag else None
            name = _imu_name(point)
            found[name] = ImuTable(name, t_s[whole], acc[point][whole], gyro[point][whole], field)
    return found


def _imu_name(point: str) -> str:
    """`right_forearm` as `forearm_right`; another name as it is."""
    for side in ("left", "right"):
        if point.startswith(f"{side}_"):
            return f"{point.removeprefix(f'{side}_')}_{side}"
    return point


def _skeleton(
    path: Path, columns: list[tuple[dict[str, str], FloatArray]], t_s: FloatArray
) -> SkeletonTable | None:
    """The joints of arms among the tracked points; None without an elbow, wrist or hand."""
    states = {
        channel.get("name", "").removesuffix("_state"): values
        for channel, values in columns
        if channel.get("name", "").endswith("_state")
    }
    position, state = {}, {}
    for point, places in _triples(columns, "POS").items():
        name = _imu_name(point)
        joint = name.rsplit("_", 1)[0]
        if joint not in (*ARM, "strap"):
            continue
        known = np.isfinite(places).all(axis=1)
        given = states.get(point, np.full(len(places), float(JointState.TRACKED)))
        position[name] = places
        state[name] = np.where(known, given, JointState.NOT_TRACKED).astype(np.int8)
    if not position:
        return None
    return SkeletonTable(0, t_s, position, state, _camera_frame(path))


def _camera_frame(path: Path) -> CameraFrame | None:
    """By the reference frame's SpatialAxes, where they are a camera's."""
    beside = path.with_name(path.name.replace("_motion.tsv", "_channels.json"))
    try:
        levels = json.loads(beside.read_text(encoding="utf-8"))["reference_frame"]["Levels"]
        axes = {str(level["SpatialAxes"]) for level in levels.values()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    if axes == {"__S"}:
        return CameraFrame.ZUP
    return next((_AXES[each] for each in axes if each in _AXES), None) if len(axes) == 1 else None
