"""A recording from plain files: a folder with `recording.toml` and the CSV files that it names."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path
from typing import Annotated, Literal, Unpack

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...errors import RecordingError
from ...linalg import unit
from ...recording import CameraFrame, FloatArray, IntArray, JointState, Recording
from ...units import STANDARD_GRAVITY
from ..mcap.stamps import nanoseconds
from ..recording.choose import Selection
from ..recording.joint_rows import JointRows, frames_of
from ..recording.read import select_recording
from ..recording.skeletons import joint_code
from ..recording.streams import ImuSamples, PoseSamples, RecordingFile, TopicInfo
from .imu_table import imu_columns
from .table import read_table, vectors

_STATES = {
    "tracked": JointState.TRACKED,
    "inferred": JointState.INFERRED,
    "not_tracked": JointState.NOT_TRACKED,
}
_LAST_S = 9.2e9  # beyond it, nanoseconds do not fit into 64 bits


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Camera(_Section):
    frame: CameraFrame
    skeleton: str | None = None
    gravity: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    position_unit: Literal["m", "mm"] = "m"


class _Imu(_Section):
    file: str
    accelerometer_unit: Literal["m/s^2", "g"] = "m/s^2"
    gyroscope_unit: Literal["rad/s", "deg/s"] = "rad/s"


class _Truth(_Section):
    file: str


class _Description(_Section):
    camera: _Camera | None = None
    imu: Annotated[dict[str, _Imu], Field(min_length=1)]
    truth: _Truth | None = None


def import_csv(
    folder: str | os.PathLike[str], *, prefer_side: str | None = None, **selection: Unpack[Selection]
) -> Recording:
    """Read one arm from a folder of plain files; options and errors as in `read_recording`."""
    return select_recording(open_csv(folder), prefer_side=prefer_side, **selection)


def open_csv(folder: str | os.PathLike[str]) -> RecordingFile:
    """Read all streams of a folder of plain files, for `write_recording` or `select_recording`.

    Parameters
    ----------
    folder : path-like
        Holds `recording.toml` and the files that it names.

    Returns
    -------
    RecordingFile
        All IMUs, arms and the truth, in SI units, times as the files have them.

    Raises
    ------
    RecordingError
        A file, column or key is missing, unknown or not readable; the message names it.
    """
    folder = Path(folder)
    description = _describe(folder)
    camera = description.camera
    file = RecordingFile(folder, camera_frame=None if camera is None else camera.frame)
    if camera is not None and camera.gravity is not None:
        file.gravity_hint = unit(np.array(camera.gravity))
        if np.isnan(file.gravity_hint).any():
            raise RecordingError(
                f"{folder / 'recording.toml'}: [camera] gravity is zero; give the direction of down."
            )
    if camera is not None and camera.skeleton is not None:  # without one the IMUs can still be calibrated
        _skeleton(file, folder / camera.skeleton, 0.001 if camera.position_unit == "mm" else 1.0)
    for name, section in description.imu.items():
        file.imus.append(_imu(folder / section.file, name, section))
    if description.truth is not None:
        file.poses.append(read_pose_table(folder / description.truth.file))
    for topic, schema, stamp in [
        *((i.topic, "unocclude.Imu", i.stamp_ns) for i in file.imus),
        *((a.topic, "unocclude.Skeleton", a.stamp_ns) for a in file.arms[:1]),
        *((p.topic, "foxglove.PoseInFrame", p.stamp_ns) for p in file.poses),
    ]:
        file.topics.append(TopicInfo(topic, schema, "csv", len(stamp), int(stamp.min()), int(stamp.max())))
    return file


def _describe(folder: Path) -> _Description:
    path = folder / "recording.toml"
    try:
        return _Description.model_validate(tomllib.loads(path.read_bytes().decode("utf-8-sig")))
    except FileNotFoundError:
        there = (
            "the folder does not exist" if not folder.is_dir() else "it describes the files of a recording"
        )
        raise RecordingError(
            f"{path} does not exist ({there}); `unocclude import csv --help` shows one."
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise RecordingError(f"{path} is not readable TOML: {error}.") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = {"extra_forbidden": "is not known here", "missing": "is missing"}.get(
            first["type"], f"is {first['input']!r}, but: {first['msg'][:1].lower()}{first['msg'][1:]}"
        )
        raise RecordingError(f"{path}: {where} {what}; mend it.") from error


def _imu(path: Path, name: str, section: _Imu) -> ImuSamples:
    t_s, acc, gyro, mag = imu_columns(path)
    if section.accelerometer_unit == "g":
        acc *= STANDARD_GRAVITY
    if section.gyroscope_unit == "deg/s":
        gyro = np.radians(gyro)
    return ImuSamples(f"/imu/{name}", name, _stamps(t_s, path), acc, gyro, mag)


def _skeleton(file: RecordingFile, path: Path, metres: float) -> None:
    numbers, texts = read_table(
        path,
        ("t_s", "joint", "x", "y", "z", "state"),
        ("body",),
        words=("joint", "state"),
        empty=("x", "y", "z"),
    )
    stamp = _stamps(numbers["t_s"], path)
    codes = {name: joint_code(name) for name in set(texts["joint"])}
    _refuse_unknown(path, "joint", texts["joint"], [name for name, code in codes.items() if code is None])
    states = {name: _STATES.get(name.lower()) for name in set(texts["state"])}
    _refuse_unknown(path, "state", texts["state"], [name for name, state in states.items() if state is None])
    pairs = np.array([codes[name] for name in texts["joint"]], np.int64)
    state = np.array([states[name] for name in texts["state"]], np.int64)
    body = numbers.get("body", np.zeros(len(stamp)))
    if not (np.isfinite(body).all() and (body >= 0).all() and (body == np.rint(body)).all()):
        raise RecordingError(f"{path}: column body must hold whole numbers from 0; mend it.")
    position = vectors(numbers, *"xyz") * metres
    bare = (state != JointState.NOT_TRACKED) & ~np.isfinite(position).all(axis=1)
    frames, frame = frames_of(stamp)
    rows = JointRows()
    frame = np.arange(len(stamp)) if frame is None else frame
    rows.add_joints(frame, body.astype(np.int64), pairs[:, 0], pairs[:, 1], state, position)
    file.arms = rows.arms(frames, "/skeleton", "camera", file.camera_frame)
    if bare.any():
        file.notes.append(
            f"{path.name}: {int(bare.sum())} rows that are tracked or inferred have no position, the first "
            f"at {numbers['t_s'][bare][0]:.3f} s."
        )
    key = np.stack([stamp, body.astype(np.int64), pairs[:, 0], pairs[:, 1]])
    repeated = len(stamp) - np.unique(key, axis=1).shape[1] if len(stamp) < 3_000_000 else 0
    if repeated:
        file.notes.append(
            f"{path.name}: {repeated} rows repeat a joint and time; the last of each was taken."
        )


def _refuse_unknown(path: Path, column: str, cells: list[str], unknown: list[str]) -> None:
    if not unknown:
        return
    allowed = {
        "joint": "shoulder, elbow, wrist, hand or strap, with _left or _right where there are both",
        "state": "tracked, inferred or not_tracked",
    }[column]
    row = next(i for i, cell in enumerate(cells) if cell in unknown)
    raise RecordingError(f"{path}, line {row + 2}: {column} {cells[row]!r} is not known; it is {allowed}.")


def read_pose_table(path: Path) -> PoseSamples:
    """Read poses from `t_s, x, y, z [, qw, qx, qy, qz]`; errors as in `read_table`."""
    turn = ("qw", "qx", "qy", "qz")
    columns, _ = read_table(path, ("t_s", "x", "y", "z"), turn, empty=("x", "y", "z", *turn))
    position = vectors(columns, *"xyz")
    quaternion = np.full((len(position), 4), np.nan)
    if all(name in columns for name in turn):
        quaternion = vectors(columns, *turn)
    return PoseSamples("/truth", "camera", _stamps(columns["t_s"], path), position, quaternion)


def _stamps(t_s: FloatArray, path: Path) -> IntArray:
    usable = np.isfinite(t_s) & (np.abs(t_s) < _LAST_S)
    if not usable.all():
        row = int(np.flatnonzero(~usable)[0])
        raise RecordingError(
            f"{path}: t_s is {t_s[row]} in row {row + 1}, which is no time in seconds; mend it."
        )
    return nanoseconds(t_s, 0)
