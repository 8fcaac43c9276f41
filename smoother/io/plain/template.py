"""Templates: how a laboratory's own tables are read, kept in a file for the next import.

A template describes one layout, with the keys of recording.toml, and recognises it by the table's columns:

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

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from ...errors import RecordingError
from ...runtime.inputs import check_input, read_toml
from ..tables.imu import ImuTable
from ..tables.skeletons import SkeletonTable
from ..tables.table import FileHead, read_head, shown
from .columns import CameraKeys, ImuKeys, read_imu_columns, read_skeleton_columns


class _About(BaseModel):
    model_config = ConfigDict(extra="forbid")
    title: str = ""
    names: list[str] = []
    width: int | None = None


class _Written(BaseModel):
    model_config = ConfigDict(extra="forbid")
    template: _About
    imu: dict[str, Any] | None = None
    camera: dict[str, Any] | None = None


@dataclass(frozen=True)
class TableTemplate:
    """An importer of one layout, as a template describes it; see `Format`."""

    path: Path  # The template
    key: str  # As in `Format`
    title: str  # As in `Format`
    kind: str  # As in `Format`
    names: tuple[str, ...]  # Columns of the tables that it is for; () where they have no header
    width: int  # Their number
    keys: dict[str, Any]  # Of recording.toml's section, without the file

    @property
    def recognised_by(self) -> str:
        """Its columns."""
        return f"the columns {shown(', '.join(self.names), 120)}" if self.names else f"{self.width} columns"

    def recognises(self, head: FileHead) -> bool:
        """Whether a table has exactly these columns."""
        layout = head.table
        return layout is not None and tuple(layout.names) == self.names and layout.width == self.width

    def read(self, path: Path) -> list[ImuTable] | list[SkeletonTable]:
        """Read a table as described; see `Format.read`."""
        if self.kind == "imu":
            return read_imu_columns(path.parent, _imu_keys(self.path, {**self.keys, "file": path.name}))
        return read_skeleton_columns(path, _camera_keys(self.path, {**self.keys, "skeleton": path.name}))


def read_templates(paths: Sequence[Path]) -> list[TableTemplate]:
    """The templates of files."""
    return [_read(path) for path in paths]


Keys = TypeVar("Keys", ImuKeys, CameraKeys, CameraKeys | None)


def with_template(keys: Keys, folder: Path, templates: Sequence[TableTemplate]) -> Keys:
    """A section of recording.toml without its table's columns, with a template for that table."""
    name = keys.file if isinstance(keys, ImuKeys) else keys.skeleton if keys is not None else None
    if not templates or keys is None or not isinstance(name, str) or not keys.is_plain:
        return keys
    kind = "imu" if isinstance(keys, ImuKeys) else "skeleton"
    head = read_head(folder / name)
    own = next((each for each in templates if each.kind == kind and each.recognises(head)), None)
    if own is None:
        return keys
    values = {**own.keys, **keys.model_dump(exclude_unset=True)}
    return _imu_keys(own.path, values) if isinstance(keys, ImuKeys) else _camera_keys(own.path, values)


def _read(path: Path) -> TableTemplate:
    check_input(path, RecordingError)
    try:
        written = _Written.model_validate(read_toml(path))
    except FileNotFoundError:
        raise RecordingError(f"{path} does not exist; check the name.") from None
    except ValidationError as error:
        raise _wrong(path, error) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise RecordingError(f"{path} is not readable TOML: {error}.") from error
    if (written.imu is None) == (written.camera is None):
        raise RecordingError(f"{path}: a template describes one table: give [imu] or [camera].")
    about = written.template
    kind, keys = ("imu", written.imu) if written.imu is not None else ("skeleton", written.camera)
    assert keys is not None
    # refused now rather than at the first file
    _imu_keys(path, {**keys, "file": ""}) if kind == "imu" else _camera_keys(path, {**keys, "skeleton": ""})
    width = about.width if about.width is not None else len(about.names)
    if width < 1 or (about.names and width != len(about.names)):
        raise RecordingError(f"{path}: [template] names lists the table's columns, or width counts them.")
    title = about.title or path.stem
    return TableTemplate(path, f"template:{path.stem}", title, kind, tuple(about.names), width, keys)


def _imu_keys(path: Path, keys: dict[str, Any]) -> ImuKeys:
    try:
        return ImuKeys.model_validate(keys)
    except ValidationError as error:
        raise _wrong(path, error, "imu.") from error


def _camera_keys(path: Path, keys: dict[str, Any]) -> CameraKeys:
    try:
        return CameraKeys.model_validate(keys)
    except ValidationError as error:
        raise _wrong(path, error, "camera.") from error


def _wrong(path: Path, error: ValidationError, section: str = "") -> RecordingError:
    first = error.errors()[0]
    where = section + ".".join(str(part) for part in first["loc"])
    what = {"extra_forbidden": "is not known here", "missing": "is missing"}.get(
        first["type"],
        f"is {shown(repr(first['input']), 60)}, but: {first['msg'][:1].lower()}{first['msg'][1:]}",
    )
    return RecordingError(f"{path}: {where} {what}; correct it.")


def template_text(
    title: str, kind: str, names: Sequence[str], width: int, columns: dict[str, Any], keys: dict[str, Any]
) -> str:
    """A template's file."""
    import tomlkit

    section = "imu" if kind == "imu" else "camera"
    document = {
        "template": {"title": title, "names": list(names), "width": width},
        section: {**keys, "columns": columns},
    }
    return tomlkit.dumps(document)
