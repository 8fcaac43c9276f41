"""A recording from plain files: a folder with `recording.toml` and the tables that it names.

A template describes one layout of a laboratory's own tables, with the keys of recording.toml, and recognises
it by the table's columns:

    [template]
    title = "Our wrist sensor"
    names = ["Zeit", "aX", "aY", "aZ", "wX", "wY", "wZ"]   # the header; [] with width = 7 where there is none
    [imu]                       # or [camera]
    time_unit = "ms"
    accelerometer_unit = "g"
    gyroscope_unit = "deg/s"
    [imu.columns]
    t = "Zeit"
    ax = "aX"
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from calib.intrinsics import CameraFile, Intrinsics

from ...array_types import FloatArray
from ...errors import RecordingError
from ...runtime.inputs import check_input, inside, read_toml
from ..files import ImuFiles, import_files
from ..recording.keypoints import direction_of, lens_from_plain
from ..recording.streams import ImuSamples, RecordingFile, SkeletonTable
from ..registry import FileReader, recognise
from .columns import (
    LAYOUT_KEYS,
    CameraKeys,
    ImuKeys,
    TableKeys,
    read_imu_columns,
    read_keypoint_columns,
    read_pose_table,
    read_skeleton_columns,
)
from .table import Format, Tables, read_head, shown
from .units import ACCELERATION, ANGULAR_VELOCITY, METRES


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class _Truth(_Strict):
    file: str


class _Description(_Strict):
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


Model = TypeVar("Model", bound=BaseModel)


def _checked(path: Path, model: type[Model], values: dict[str, Any], section: str = "") -> Model:
    """Values of a TOML file as a model's; what is wrong is one sentence."""
    try:
        return model.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = section + ".".join(str(part) for part in first["loc"])
        what = {"extra_forbidden": "is not known here", "missing": "is missing"}.get(
            first["type"],
            f"is {shown(repr(first['input']), 60)}, but: {first['msg'][:1].lower()}{first['msg'][1:]}",
        )
        raise RecordingError(f"{path}: {where} {what}; correct it.") from error


def _toml(path: Path, lacks: str) -> dict[str, Any]:
    """What a TOML file contains; `lacks` goes on behind the name of one that does not exist."""
    check_input(path, RecordingError)
    try:
        return read_toml(path)
    except FileNotFoundError:
        raise RecordingError(f"{path} does not exist{lacks}") from None
    except (OSError, ValueError) as error:  # also a number of thousands of digits
        raise RecordingError(f"{path} is not readable TOML: {error}; correct it.") from error


# ------------------------------------------------------------------------------------------------ templates


class _Layout(_Strict):
    title: str = ""
    names: list[str] = []
    width: int | None = None


class _Written(_Strict):
    template: _Layout
    imu: dict[str, Any] | None = None
    camera: dict[str, Any] | None = None


def read_templates(paths: Sequence[Path]) -> list[Format]:
    """The templates of files."""
    return [_template(path) for path in paths]


def _template(path: Path) -> Format:
    written = _checked(path, _Written, _toml(path, "; check the name."))
    if (written.imu is None) == (written.camera is None):
        raise RecordingError(f"{path}: a template describes one table: give [imu] or [camera].")
    keys, names = written.imu or written.camera or {}, tuple(written.template.names)
    width = len(names) if written.template.width is None else written.template.width
    if width < 1 or (names and width != len(names)):
        raise RecordingError(f"{path}: [template] names lists the table's columns, or width counts them.")

    if written.camera is None:
        of = _imu_format(_checked(path, ImuKeys, {**keys, "file": ""}, "imu."), path.stem)
    else:
        of = _camera_format(_checked(path, CameraKeys, {**keys, "skeleton": ""}, "camera."), path, "camera")
    return replace(
        of,
        key=f"template:{path.stem}",
        title=written.template.title or path.stem,
        recognised_by=f"the columns {shown(', '.join(names), 120)}" if names else f"{width} columns",
        recognises=lambda head: (
            head.table is not None and (head.table.names, head.table.width) == (names, width)
        ),
    )


def template_text(
    title: str, kind: str, names: Sequence[str], width: int, columns: dict[str, Any], keys: dict[str, Any]
) -> str:
    """A template's file."""
    import tomlkit

    section = "imu" if kind == "imu" else "camera"
    about = {"title": title, "names": list(names), "width": width}
    return tomlkit.dumps({"template": about, section: {**keys, "columns": columns}})


# ----------------------------------------------------------------------------------------------- the folder


def open_csv(folder: str | os.PathLike[str], *, outside: bool = False) -> RecordingFile:
    """Read all streams of a folder of plain files, for `write_recording` or `select_recordings`."""
    folder = Path(folder)
    if folder.name == "recording.toml" and folder.is_file():  # as shells complete it
        folder = folder.parent
    description = read_description(folder)
    _check_places(folder, description, outside)
    toml, camera = folder / "recording.toml", description.camera
    cameras = {**({} if camera is None else {"": camera}), **description.cameras}
    if cameras.keys() == {""} and cameras[""].file is None:
        cameras = {}  # IMUs alone can still be calibrated
    lenses, of_cameras, files = {}, [], []
    for name, keys in cameras.items():
        section = f"camera.{shown(name, 40)}" if name else "camera"
        if keys.file is None:
            raise RecordingError(
                f"{toml}: [{section}] names no skeleton; give skeleton or keypoints = a file."
            )
        if name and any(mark in name for mark in "/\\ "):
            raise RecordingError(f"{toml}: [{section}] is not a camera's name; use letters and digits.")
        if keys.keypoints is not None:
            lenses[name] = CameraFile(_lens(keys, toml, section))
        of_cameras.append(_camera_format(keys, toml, section))
        files.append(folder / keys.file)
    imus = [
        ImuFiles(
            tuple(folder / file for file in keys.files),
            name,
            formats=tuple(_imu_format(keys, name, number) for number in range(len(keys.files))),
        )
        for name, keys in description.imu.items()
    ]
    all_keys: list[TableKeys] = [*description.imu.values(), *([camera] if camera else [])]
    described = [keys for keys in all_keys if not keys.is_plain]
    file, _ = import_files(
        files,
        imus,
        formats=of_cameras,
        cameras=list(cameras),
        lenses=lenses,
        one_clock=not described,  # as the product's own tables have
        one_recorder=True,
    )
    file.path = folder
    # what is counted at a rate has no clock at all
    file.clocks_unrelated |= any(keys.rate_hz is not None for keys in described)
    if camera is not None:
        file.camera_frame, file.gravity_hint = camera.frame, _down(camera.gravity, toml, "camera")
    if description.truth is not None:
        file.poses.append(read_pose_table(folder / description.truth.file))
    return file


def read_description(folder: Path) -> _Description:
    """What a folder's recording.toml states."""
    path = folder / "recording.toml"
    there = "the folder does not exist" if not folder.is_dir() else "it describes the files of a recording"
    lacks = f" ({there}); `unocclude import csv --help` shows one."
    return _checked(path, _Description, _toml(path, lacks))


def _check_places(folder: Path, description: _Description, outside: bool) -> None:
    """Refuse files elsewhere, and what is not a file."""
    toml = folder / "recording.toml"
    cameras = [each for each in (description.camera, *description.cameras.values()) if each is not None]
    names = [camera.file for camera in cameras if camera.file is not None]
    names += [file for section in description.imu.values() for file in section.files]
    names += [] if description.truth is None else [description.truth.file]
    for name in names:
        if "\0" in name:
            raise RecordingError(f"{toml} names {shown(repr(name), 60)}, which is not a file's name.")
        if not outside and inside(folder, name) is None:
            raise RecordingError(
                f"{toml} names {shown(name, 120)}, which lies outside its folder; copy it into the folder, or"
                " give --outside if you trust the recording."
            )
        check_input(folder / name, RecordingError)


def _down(gravity: list[float] | None, toml: Path, section: str) -> FloatArray | None:
    """The direction of down that a section of recording.toml states."""
    try:
        return None if gravity is None else direction_of(gravity)
    except ValueError as error:
        raise RecordingError(
            f"{toml}: [{section}] {error}; give the direction of down, as in [0, -1, 0]."
        ) from None


def _imu_format(keys: ImuKeys, name: str, number: int = 0) -> Format:
    """How a file of a section is read; its units count for files of other kinds as well."""

    def read(path: Path) -> Tables:
        if not _is_container(path):
            return [read_imu_columns(path, keys, number)]
        tables = [table for table in _contained(path, "imu", keys) if isinstance(table, ImuSamples)]
        named = [table for table in tables if name == table.topic.rpartition("/")[2]]
        if len(tables) > 1 and len(named) != 1:
            listed = ", ".join(table.topic for table in tables)
            raise RecordingError(
                f"{path} contains {len(tables)} sensors ({listed}); take one with `unocclude import files"
                f" --imu {name}={path}#{tables[0].topic}`."
            )
        tables = named if len(tables) > 1 else tables
        for table in tables:
            units = table.units.split(", ")
            if table.acc is not None and "accelerometer_unit" in keys.model_fields_set:
                table.acc = table.acc * (ACCELERATION[keys.accelerometer_unit] / ACCELERATION[units[0]])
            if table.gyro is not None and "gyroscope_unit" in keys.model_fields_set:
                table.gyro = table.gyro * (
                    ANGULAR_VELOCITY[keys.gyroscope_unit] / ANGULAR_VELOCITY[units[-1]]
                )
        return tables

    return _section(f"imu.{name}", "imu", read, number)


def _section(name: str, kind: str, read: Callable[[Path], Tables], number: int = 0) -> Format:
    """The format of a file that a section describes."""
    title = f"[{name}] of recording.toml"
    return Format(f"{name} {number}", title, kind, title, lambda head: False, read, described=True)


def _camera_format(keys: CameraKeys, toml: Path, section: str) -> Format:
    """How the bodies of a section's file are read: in metres; of keypoints u, v and score."""

    def read(path: Path) -> Tables:
        if keys.keypoints is not None:
            tables = read_keypoint_columns(path, keys)
        elif not _is_container(path):
            tables = read_skeleton_columns(path, keys)
        else:
            tables = [t for t in _contained(path, "skeleton", keys) if isinstance(t, SkeletonTable)]
            if not tables:
                raise RecordingError(f"{path} has no skeleton; name the camera's file.")
            for table in tables:
                if "position_unit" in keys.model_fields_set:
                    factor = METRES[keys.position_unit] / METRES.get(table.units, 1.0)
                    table.position = {joint: place * factor for joint, place in table.position.items()}
                table.frame = keys.frame
        tables[0].gravity_hint = _down(keys.gravity, toml, section)
        return tables

    return _section(section, "skeleton", read)


def _lens(keys: CameraKeys, toml: Path, section: str) -> Intrinsics:
    """The lens of a section with keypoints."""
    try:
        return lens_from_plain(keys.intrinsics or {})
    except (ValueError, TypeError, KeyError) as error:
        raise RecordingError(
            f"{toml}: [{section}] intrinsics are not whole ({error}); keypoints need"
            " intrinsics = {width, height, fx, fy, cx, cy [, k1, k2, p1, p2, k3]}."
        ) from error


def _is_container(path: Path) -> bool:
    """Whether a file is binary and of a known format."""
    return path.is_file() and not (head := read_head(path)).text and recognise(head) is not None


def _contained(path: Path, kind: str, keys: TableKeys) -> Tables:
    reader = FileReader()
    of = reader.format_of(path, kind)
    if layout := keys.model_fields_set & LAYOUT_KEYS:
        raise RecordingError(f"{path} is no table ({of.title}); leave out {', '.join(sorted(layout))}.")
    return reader.read(path, of)
