"""A recording from plain files: a folder with `recording.toml` and the CSV files that it names.

Recordings of published data sets: BROAD and UTD-MHAD.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from ...linalg import unit
from ...measurements.timestamps import begins_frames, clock_resets, resets_message, strayed
from ...recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording, Truth
from ...runtime.inputs import check_input, crashes_in_subprocess, inside, marked_encoding, read_toml
from ...units import STANDARD_GRAVITY
from ..devices.files import add_imu, add_skeleton, rate_note, times_of
from ..devices.registry import FileReader, recognise
from ..devices.repair import Timed, count_from_zero, of_one_length, repaired_imu, repaired_skeleton, shifts
from ..mcap.messages import nanoseconds
from ..recording.camera_streams import CAMERA_TOPIC
from ..recording.decode import JointRows, frames_of, joint_code
from ..recording.keypoints import NAMED_TOPIC, TOPIC, lens_from_plain
from ..recording.read import select_recording
from ..recording.selection import Selection
from ..recording.streams import (
    ArmFrames,
    CameraStream,
    ImuSamples,
    KnownLens,
    PoseSamples,
    RecordingFile,
    TopicInfo,
)
from ..tables.imu import ImuTable, paired
from ..tables.skeletons import SkeletonTable
from ..tables.table import HEAD_BYTES, Tables, is_data, read_head, shown
from ..tables.units import ACCELERATION, ANGULAR_VELOCITY, METRES
from .columns import (
    LAYOUT_KEYS,
    CameraKeys,
    ImuKeys,
    TableKeys,
    read_imu_columns,
    read_keypoint_columns,
    read_skeleton_columns,
)
from .table import imu_columns, read_table, vectors
from .template import TableTemplate, with_template

_STATES = {state.name.lower(): state for state in JointState}
_LAST_S = 9.2e9  # beyond it, nanoseconds do not fit into 64 bits


class _Truth(BaseModel):
    model_config = ConfigDict(extra="forbid")
    file: str


class _Description(BaseModel):
    model_config = ConfigDict(extra="forbid")
    camera: CameraKeys | None = None
    cameras: dict[str, CameraKeys] = Field(default_factory=dict)
    imu: Annotated[dict[str, ImuKeys], Field(min_length=1)]
    truth: _Truth | None = None

    @model_validator(mode="before")
    @classmethod
    def _cameras_apart(cls, values: Any) -> Any:
        """`[camera.NAME]` are further cameras; without a `[camera]` of its own the first of them is it."""
        camera = values.get("camera") if isinstance(values, dict) else None
        if not isinstance(camera, dict):
            return values
        own = {key: each for key, each in camera.items() if key in CameraKeys.model_fields}
        named = {key: each for key, each in camera.items() if key not in own and isinstance(each, dict)}
        own |= {key: each for key, each in camera.items() if key not in named and key not in own}
        if not own and named:
            own = named.pop(next(iter(named)))
        rest = {key: each for key, each in values.items() if key != "cameras"}
        return {**rest, "camera": own, "cameras": named}


def import_csv(
    folder: str | os.PathLike[str], *, prefer_side: str | None = None, **selection: Unpack[Selection]
) -> Recording:
    """Read one arm from a folder of plain files; options and errors as in `read_recording`."""
    return select_recording(open_csv(folder), prefer_side=prefer_side, **selection)


def open_csv(
    folder: str | os.PathLike[str], *, outside: bool = False, templates: Sequence[TableTemplate] = ()
) -> RecordingFile:
    """Read all streams of a folder of plain files, for `write_recording` or `select_recording`."""
    folder = Path(folder)
    if folder.name == "recording.toml" and folder.is_file():  # as shells complete it
        folder = folder.parent
    description = _describe(folder)
    _check_places(folder, description, outside)
    description.imu = {name: with_template(keys, folder, templates) for name, keys in description.imu.items()}
    camera = description.camera = with_template(description.camera, folder, templates)
    file = RecordingFile(folder, camera_frame=None if camera is None else camera.frame)
    if camera is not None and camera.gravity is not None:
        file.gravity_hint = _down(camera.gravity, folder, "camera")
    plain = {
        name: section
        for name, section in description.imu.items()
        if section.is_plain and is_plain_text(folder / section.file)  # type: ignore[operator]
    }
    skeleton = None if camera is None or not camera.is_plain else camera.skeleton
    is_plain = camera is not None and skeleton is not None and is_plain_text(folder / skeleton)
    if camera is not None and skeleton is not None and is_plain:
        _skeleton(file, folder / skeleton, METRES[camera.position_unit])
    for name, section in plain.items():
        file.imus.append(_imu(file, folder / section.file, name, section))  # type: ignore[operator]
        file.notes += rate_note(file.imus[-1])
    others = {name: section for name, section in description.imu.items() if name not in plain}
    _add_columns(file, folder, None if is_plain else camera, others)
    for name, keys in description.cameras.items():
        _add_camera(file, folder, name, keys)
    if description.truth is not None:
        file.poses.append(read_pose_table(folder / description.truth.file))
    for topic, schema, stamp in [
        *((i.topic, "unocclude.Imu", i.stamp_ns) for i in file.imus),
        *((topic, _schema(arm), arm.stamp_ns) for topic, arm in {a.topic: a for a in file.arms}.items()),
        *((p.topic, "foxglove.PoseInFrame", p.stamp_ns) for p in file.poses),
    ]:
        file.topics.append(TopicInfo(topic, schema, "csv", len(stamp), int(stamp.min()), int(stamp.max())))
    return file


def _down(gravity: list[float], folder: Path, section: str) -> FloatArray:
    """The direction of down that a section of recording.toml states."""
    direction = unit(np.array(gravity))
    if not (np.isfinite(gravity).all() and abs(np.linalg.norm(direction) - 1) < 1e-6):
        raise RecordingError(
            f"{folder / 'recording.toml'}: [{section}] gravity is zero or no numbers; give the direction of"
            " down."
        )
    return np.asarray(direction)


def _add_camera(file: RecordingFile, folder: Path, name: str, keys: CameraKeys) -> None:
    """A further camera's skeleton, on its own clock and in its own frame."""
    if keys.file is None:
        raise RecordingError(
            f"{folder / 'recording.toml'}: [camera.{name}] names no skeleton; give skeleton = a file, or"
            " keypoints = a file and intrinsics."
        )
    if not name or any(mark in name for mark in "/\\ "):
        raise RecordingError(
            f"{folder / 'recording.toml'}: [camera.{shown(name, 40)}] is not a camera's name; use letters and"
            " digits."
        )
    path, topic = folder / keys.file, f"{CAMERA_TOPIC}{name}"
    hint = None if keys.gravity is None else _down(keys.gravity, folder, f"camera.{name}")
    if keys.keypoints is None and keys.is_plain and is_plain_text(path):
        _skeleton(file, path, METRES[keys.position_unit], topic, name)
    else:
        tables = [repaired_skeleton(table, str(path)) for table in _bodies(path, keys)]
        file.notes += [f"{path.name}: {note}" for note in dict.fromkeys(n for t in tables for n in t.notes)]
        known = _known_lens(keys, folder, f"camera.{name}")
        if known is not None:
            topic = NAMED_TOPIC.format(name)
            file.lenses[topic] = known
        add_skeleton(file, tables, str(folder), topic, 0.0, name, known)
    file.cameras[topic] = CameraStream(name, keys.frame, hint)


def _describe(folder: Path) -> _Description:
    path = folder / "recording.toml"
    check_input(path, RecordingError)
    try:
        return _Description.model_validate(read_toml(path))
    except FileNotFoundError:
        there = (
            "the folder does not exist" if not folder.is_dir() else "it describes the files of a recording"
        )
        raise RecordingError(
            f"{path} does not exist ({there}); `unocclude import csv --help` shows one."
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = {"extra_forbidden": "is not known here", "missing": "is missing"}.get(
            first["type"],
            f"is {shown(repr(first['input']), 60)}, but: {first['msg'][:1].lower()}{first['msg'][1:]}",
        )
        raise RecordingError(f"{path}: {where} {what}; correct it.") from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:  # also a number of thousands of digits
        raise RecordingError(f"{path} is not readable TOML: {error}.") from error


def _check_places(folder: Path, description: _Description, outside: bool) -> None:
    """Refuse files elsewhere, and what is not a file."""
    truth = description.truth
    cameras = [each for each in (description.camera, *description.cameras.values()) if each is not None]
    names = [camera.file for camera in cameras if camera.file is not None]
    for section in description.imu.values():
        names += [section.file] if isinstance(section.file, str) else section.file
    names += [] if truth is None else [truth.file]
    for name in names:
        if "\0" in name:
            raise RecordingError(
                f"{folder / 'recording.toml'} names {shown(repr(name), 60)}, which is not a file's name."
            )
        if not outside and inside(folder, name) is None:
            raise RecordingError(
                f"{folder / 'recording.toml'} names {shown(name, 120)}, which lies outside its folder; copy"
                " it into the folder, or give --outside if you trust the recording."
            )
        check_input(folder / name, RecordingError)


def _add_columns(
    file: RecordingFile, folder: Path, camera: CameraKeys | None, imus: dict[str, ImuKeys]
) -> None:
    """Tables of other layouts, their times corrected, on one clock with the rest."""
    if camera is None and not imus:
        return
    bodies: list[SkeletonTable] = []
    if camera is not None and camera.file is not None:  # IMUs alone can still be calibrated
        path = folder / camera.file
        bodies = [repaired_skeleton(table, str(path)) for table in _bodies(path, camera)]
        file.notes += [f"{path.name}: {note}" for note in dict.fromkeys(n for t in bodies for n in t.notes)]
    sensors = {}
    for name, keys in imus.items():
        source = f"[imu.{name}] of {folder / 'recording.toml'}"
        tables = [repaired_imu(table, source) for table in _sensors(folder, name, keys)]
        sensors[name] = paired(tables, source)
        file.notes += [f"imu.{name}: {note}" for note in sensors[name].notes]
    streams = [Timed(arm.topic, arm.stamp_ns / 1e9, False) for arm in file.arms[:1]]
    streams += [Timed(table.units, times_of(table), False) for table in bodies]
    streams += [Timed(imu.topic, imu.stamp_ns / 1e9, True) for imu in file.imus]
    streams += [Timed(f"imu.{name}", times_of(table), True) for name, table in sensors.items()]
    shift, sentences = shifts(streams)
    file.notes += sentences
    described = [*imus.values(), *([camera] if camera is not None else [])]
    own_starts = count_from_zero(streams) and not of_one_length(streams)
    if own_starts:
        file.notes.append(
            "Camera and IMU both count from about zero and differ in length, so only the motion shows their"
            " offset and whether they belong together."
        )
    # what is counted at a rate has no clock at all
    counted = any(keys.rate_hz is not None for keys in described)
    file.clocks_unrelated = bool(sentences) or own_starts or counted
    moved = iter(shift)
    if file.arms:
        shift_ns = round(next(moved) * 1e9)
        for arm in file.arms:
            arm.stamp_ns = arm.stamp_ns + shift_ns
    skeleton_shift = [next(moved) for _ in bodies]
    for imu in file.imus:
        imu.stamp_ns = imu.stamp_ns + round(next(moved) * 1e9)
    if camera is not None and bodies:
        known = _known_lens(camera, folder, "camera")
        if known is not None:
            file.lenses[TOPIC] = known
        topic = "/skeleton" if known is None else TOPIC
        add_skeleton(file, bodies, str(folder), topic, skeleton_shift[0], known=known)
    for name, table in sensors.items():
        add_imu(file, f"/imu/{name}", table, str(folder), next(moved))


def _sensors(folder: Path, name: str, keys: ImuKeys) -> list[ImuTable]:
    """The tables of a section, whose units count for files of other kinds as well."""
    files = [folder / file for file in ([keys.file] if isinstance(keys.file, str) else keys.file)]
    if not any(map(_is_container, files)):
        return read_imu_columns(folder, keys)
    parts: list[ImuTable] = []
    for path in files:
        tables = [table for table in _contained(path, "imu", keys) if isinstance(table, ImuTable)]
        named = [table for table in tables if name == table.name.rpartition("/")[2]]
        if len(tables) > 1 and len(named) != 1:
            listed = ", ".join(table.name for table in tables)
            raise RecordingError(
                f"{path} contains {len(tables)} sensors ({listed}); take one with `unocclude import files"
                f" --imu {name}={path}#{tables[0].name}`."
            )
        parts += named if len(tables) > 1 else tables
    stated = keys.model_fields_set
    for table in parts:
        units = table.units.split(", ")
        if table.acc is not None and "accelerometer_unit" in stated:
            table.acc = table.acc * (ACCELERATION[keys.accelerometer_unit] / ACCELERATION[units[0]])
        if table.gyro is not None and "gyroscope_unit" in stated:
            table.gyro = table.gyro * (ANGULAR_VELOCITY[keys.gyroscope_unit] / ANGULAR_VELOCITY[units[-1]])
    return parts


def _bodies(path: Path, keys: CameraKeys) -> list[SkeletonTable]:
    """The bodies of a section's file, in metres by its unit; of keypoints u, v and score."""
    if keys.keypoints is not None:
        return read_keypoint_columns(path, keys)
    if not _is_container(path):
        return read_skeleton_columns(path, keys)
    tables = [table for table in _contained(path, "skeleton", keys) if isinstance(table, SkeletonTable)]
    if not tables:
        raise RecordingError(f"{path} has no skeleton; name the camera's file.")
    for table in tables:
        if "position_unit" in keys.model_fields_set:
            factor = METRES[keys.position_unit] / METRES.get(table.units, 1.0)
            table.position = {joint: place * factor for joint, place in table.position.items()}
        table.frame = keys.frame
    return tables


def _schema(arm: ArmFrames) -> str:
    return "unocclude.Skeleton" if arm.lens is None else "unocclude.Keypoints2D"


def _known_lens(keys: CameraKeys, folder: Path, section: str) -> KnownLens | None:
    """The lens of a section with keypoints."""
    if keys.keypoints is None:
        return None
    try:
        return KnownLens(lens_from_plain(keys.intrinsics or {}))
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingError(
            f"{folder / 'recording.toml'}: [{section}] intrinsics are not whole ({error}); keypoints need"
            " intrinsics = {width, height, fx, fy, cx, cy [, k1, k2, p1, p2, k3]}."
        ) from error


def _is_container(path: Path) -> bool:
    """Whether a file is binary and of a known format."""
    return path.is_file() and not (head := read_head(path)).text and recognise(head) is not None


def _contained(path: Path, kind: str, keys: TableKeys) -> Tables:
    reader = FileReader()
    importer = reader.format_of(path, kind)
    if layout := keys.model_fields_set & LAYOUT_KEYS:
        raise RecordingError(f"{path} is no table ({importer.title}); leave out {', '.join(sorted(layout))}.")
    return reader.read(path, importer)


def is_plain_text(path: Path) -> bool:
    """Whether a file begins with UTF-8 and rows right below the names, as this program writes tables."""
    if not path.is_file():
        return True  # what is missing is said where it is read
    with path.open("rb") as file:
        raw = file.read(HEAD_BYTES)
    if marked_encoding(raw) not in (None, "utf-8-sig") or b"\0" in raw:
        return False
    try:
        lines = [
            line for line in codecs.getincrementaldecoder("utf-8")().decode(raw).splitlines() if line.strip()
        ]
    except UnicodeDecodeError:
        return False
    below = lines[1].split(",") if len(lines) > 2 else []
    return len(below) < 2 or not any(below) or any(is_data(cell.strip()) for cell in below)


def _imu(file: RecordingFile, path: Path, name: str, section: ImuKeys) -> ImuSamples:
    t_s, acc, gyro, mag = imu_columns(path)
    times, strays = strayed(t_s, "samples")
    file.notes += [f"{path.name}: {note}" for note in strays]
    there = np.isfinite(times)
    t_s, acc, gyro, mag = times[there], acc[there], gyro[there], None if mag is None else mag[there]
    t_s, steps = clock_resets(t_s, acc)
    if steps:
        file.notes.append(f"{path.name}: {resets_message(steps, 'samples')}")
    acc *= ACCELERATION[section.accelerometer_unit]
    if section.gyroscope_unit != "rad/s":
        gyro = gyro * ANGULAR_VELOCITY[section.gyroscope_unit]
    return ImuSamples(f"/imu/{name}", name, _stamps(t_s, path), acc, gyro, mag)


def _skeleton(
    file: RecordingFile, path: Path, metres: float, topic: str = "/skeleton", camera: str = "camera"
) -> None:
    numbers, texts = read_table(
        path,
        ("t_s", "joint", "x", "y", "z", "state"),
        ("body",),
        words=("joint", "state"),
        empty=("x", "y", "z"),
    )
    codes = {name: joint_code(name) for name in set(texts["joint"])}
    _refuse_unknown(path, "joint", texts["joint"], [name for name, code in codes.items() if code is None])
    states = {name: _STATES.get(name.lower()) for name in set(texts["state"])}
    _refuse_unknown(path, "state", texts["state"], [name for name, state in states.items() if state is None])
    pairs = np.array([codes[name] for name in texts["joint"]], np.int64)
    state = np.array([states[name] for name in texts["state"]], np.int64)
    body = numbers.get("body", np.zeros(len(pairs)))
    if not (np.isfinite(body).all() and (body >= 0).all() and (body == np.rint(body)).all()):
        raise RecordingError(f"{path}: column body must contain whole numbers from 0; correct it.")
    position = vectors(numbers, *"xyz") * metres
    kind = (body * 100 + pairs[:, 0] * 10 + pairs[:, 1]).astype(np.int64)
    stamp = _stamps(_frame_times(file, path, numbers["t_s"], kind), path)
    bare = (state != JointState.NOT_TRACKED) & ~np.isfinite(position).all(axis=1)
    frames, frame = frames_of(stamp)
    rows = JointRows()
    frame = np.arange(len(stamp)) if frame is None else frame
    rows.add_joints(frame, body.astype(np.int64), pairs[:, 0], pairs[:, 1], state, position)
    frame_of_file = file.camera_frame if topic == "/skeleton" else None
    file.arms += rows.arms(frames, topic, camera, frame_of_file)
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


def _frame_times(file: RecordingFile, path: Path, t_s: FloatArray, kind: IntArray) -> FloatArray:
    """Times of the rows; behind a clock that was set back they go on, with a note."""
    is_new = np.append(True, t_s[1:] != t_s[:-1])[: len(t_s)]
    times, strays = strayed(t_s[is_new], "frames")
    if strays and np.isfinite(times).all():  # others are left out with the stamps that are far from all
        file.notes += [f"{path.name}: {note}" for note in strays]
        t_s = times[np.cumsum(is_new) - 1]
    if not begins_frames(t_s, kind):
        return t_s
    times, steps = clock_resets(t_s[is_new])
    if steps:
        file.notes.append(f"{path.name}: {resets_message(steps, 'frames')}")
    return times[np.cumsum(is_new) - 1]


def _refuse_unknown(path: Path, column: str, cells: list[str], unknown: list[str]) -> None:
    if not unknown:
        return
    allowed = {
        "joint": "shoulder, elbow, wrist, hand or strap, with _left or _right where there are both",
        "state": "tracked, inferred or not_tracked",
    }[column]
    row = next(i for i, cell in enumerate(cells) if cell in unknown)
    raise RecordingError(
        f"{path}, line {row + 2}: {column} '{shown(cells[row], 40)}' is not known; it is {allowed}."
    )


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
            f"{path}: t_s is {t_s[row]} in row {row + 1}, which is not a time in seconds; correct it."
        )
    return nanoseconds(t_s, 0)


_UTD_RATE_HZ = 50.0
#: Rows of UTD-MHAD's Kinect v1 skeleton, right arm.
_UTD_ROWS = {"shoulder": 8, "elbow": 9, "wrist": 10, "hand": 11}


def import_broad(
    mat: str | os.PathLike[str], *, rate_hz: float = 30.0, noise_m: float = 0.008, seed: int = 0
) -> Recording:
    """Make a recording of a trial of BROAD (Laidig et al., Data 6(7):72, 2021)."""
    fields = _load(
        mat, ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "opt_pos", "sampling_rate", "movement"), "BROAD"
    )
    rate = float(fields["sampling_rate"].ravel()[0])
    position = fields["opt_pos"].astype(float)
    t_s = np.arange(len(position)) / rate
    frames = np.arange(0.0, t_s[-1] + 0.5 / rate, 1.0 / rate_hz)
    frames = frames[frames <= t_s[-1]]
    # A nan on either side makes the interpolated position nan: such a frame is not tracked.
    observed = np.stack([np.interp(frames, t_s, axis) for axis in position.T], axis=1)
    observed = observed + np.random.default_rng(seed).normal(0.0, noise_m, observed.shape)
    joints, state = _empty_tracks(len(frames))
    joints[:, JOINTS.index("strap")] = observed
    state[:, JOINTS.index("strap")] = np.where(
        np.isfinite(observed).all(axis=1), JointState.TRACKED, JointState.NOT_TRACKED
    )
    joints[state == JointState.NOT_TRACKED] = np.nan
    truth = Truth(t_s, position, fields["opt_quat"].astype(float), fields["movement"].ravel().astype(bool))
    imu = ImuStream(
        "/imu/forearm",
        t_s,
        fields["imu_acc"].astype(float),
        fields["imu_gyr"].astype(float),
        fields["imu_mag"].astype(float),
    )
    note = (
        f"Optical positions at {rate_hz:g} Hz with {noise_m * 1000:g} mm of white noise (seed {seed}) serve "
        "as the camera."
    )
    return Recording(
        imu=imu,
        arm=JointTracks("/skeleton", frames, joints, state),
        camera_frame=CameraFrame.ZUP,
        truth=truth,
        name=Path(mat).name,
        notes=(note,),
    )


def import_utd_mhad(inertial_mat: str | os.PathLike[str], skeleton_mat: str | os.PathLike[str]) -> Recording:
    """Make a recording of a trial of UTD-MHAD (Chen, Jafari, Kehtarnavaz, ICIP 2015), actions 1-21."""
    inertial = _load(inertial_mat, ("d_iner",), "UTD-MHAD (inertial)")["d_iner"].astype(float)
    skeleton = _load(skeleton_mat, ("d_skel",), "UTD-MHAD (skeleton)")["d_skel"].astype(float)
    if inertial.ndim != 2 or inertial.shape[1] != 6 or skeleton.ndim != 3 or skeleton.shape[:2] != (20, 3):
        raise RecordingError(
            f"{inertial_mat}, {skeleton_mat}: shapes {inertial.shape} and {skeleton.shape} are not "
            "UTD-MHAD's (N, 6) and (20, 3, n)."
        )
    samples, frames = len(inertial), skeleton.shape[2]
    t_s = np.asarray((np.arange(samples) + 0.5) / _UTD_RATE_HZ, np.float64)
    frame_s = (np.arange(frames) + 0.5) * (samples / _UTD_RATE_HZ / frames)
    joints, state = _empty_tracks(frames)
    for joint, row in _UTD_ROWS.items():
        joints[:, JOINTS.index(joint)] = skeleton[row].T
        state[:, JOINTS.index(joint)] = JointState.TRACKED
    # The Kinect writes zeros for a body that it does not have.
    nothing = ~np.isfinite(joints).all(axis=2) | (np.abs(joints).max(axis=2) < 1e-9)
    state[nothing], joints[nothing] = JointState.NOT_TRACKED, np.nan
    acc: FloatArray = inertial[:, :3] * STANDARD_GRAVITY
    gyro: FloatArray = inertial[:, 3:] * (np.pi / 180)
    return Recording(
        imu=ImuStream("/imu/forearm_right", t_s, acc, gyro),
        arm=JointTracks("/skeleton", frame_s, joints, state),
        side="right",
        camera_frame=CameraFrame.KINECT,
        name=Path(inertial_mat).name.removesuffix("_inertial.mat").removesuffix(".mat"),
        notes=("Frame times are spread evenly over the IMU's interval, as the files have none.",),
    )


def _empty_tracks(frames: int) -> tuple[FloatArray, NDArray[np.int8]]:
    return np.full((frames, len(JOINTS), 3), np.nan), np.zeros((frames, len(JOINTS)), np.int8)


def _load(path: str | os.PathLike[str], fields: tuple[str, ...], kind: str) -> dict[str, NDArray]:
    from scipy.io import loadmat

    check_input(path, RecordingError)
    if not Path(path).exists():
        raise RecordingError(f"{path} does not exist; check the name.")
    if crashes_in_subprocess(Path(path), loadmat):  # a damaged type of data leads it past its table
        raise RecordingError(f"{path} is a damaged Matlab file; download it again.")
    try:
        data = loadmat(path)
    except Exception as error:  # scipy raises many kinds on files that are not Matlab's
        raise RecordingError(f"{path} cannot be read as a Matlab file: {error}.") from error
    missing = [name for name in fields if name not in data]
    if missing:
        raise RecordingError(f"{path} is not a trial of {kind}: it lacks {', '.join(missing)}.")
    return {name: np.asarray(data[name]) for name in fields}
