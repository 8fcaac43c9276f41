"""The table of importers, which of them a file belongs to, and files read by them, each once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ...errors import RecordingError, UnoccludeError
from ..tables.columns import MissingAxis, missing_axes, missing_axes_words
from ..tables.imu import ImuTable
from ..tables.imu_formats import IMU_FORMATS
from ..tables.joints import find_joint_columns
from ..tables.phone_formats import PHONE_FORMATS
from ..tables.skeleton_formats import SKELETON_FORMATS
from ..tables.table import (
    HEAD_BYTES,
    FileHead,
    Format,
    Tables,
    first_rows,
    no_table,
    read_head,
    shown,
)


@cache
def formats() -> tuple[Format, ...]:
    """All importers; where two recognise a file, the earlier one has it."""
    from . import marker_skeletons, message_files, named_table, sensor_files, skeleton_json, skeleton_tables

    importers: list[Format] = [
        *(message_files.XDF, message_files.ROSBAG1, message_files.MCAP),
        *(skeleton_tables.JOINT_ARRAY, marker_skeletons.C3D_SKELETON, marker_skeletons.TRC_SKELETON),
        *(skeleton_json.KINECT_JSON, skeleton_json.POSE_JSON, *SKELETON_FORMATS),
        *(skeleton_tables.JOINT_ROWS, skeleton_tables.KINECT_NUMBERS),
    ]
    #: Files that are not plain tables, listed behind a row of `IMU_FORMATS`.
    behind: dict[str, Format] = {
        "xsens-dot": sensor_files.MVNX,
        "apdm": sensor_files.APDM_HDF,
        "phyphox": sensor_files.AXIVITY,
    }
    for row in (*IMU_FORMATS, *PHONE_FORMATS):
        importers.append(row)
        if row.key in behind:
            importers.append(behind[row.key])
    importers.append(named_table.NAMED_IMU)  # of no device; only what no other importer knows
    return tuple(importers)


def format_named(key: str) -> Format:
    """The importer of that key."""
    for importer in formats():
        if importer.key == key.strip().lower():
            return importer
    raise RecordingError(
        f"{key} is not a format; formats are {', '.join(importer.key for importer in formats())}."
    )


def recognise(head: FileHead, kinds: tuple[str, ...] = ()) -> Format | None:
    """The importer that a file belongs to, by what is in it."""
    for importer in formats():
        if (not kinds or importer.kind in kinds) and importer.recognises(head):
            return importer
    for importer in formats() if kinds else ():
        if importer.kind not in kinds and importer.recognises(head):
            return importer
    return None


def unknown_file(head: FileHead) -> RecordingError:
    """The sentence about a file that no importer recognises."""
    from .video_file import is_video

    if is_video(head.raw):
        return RecordingError(
            f"{head.path} is a video; `unocclude import video {head.path} --model FILE.task` takes it as the"
            " camera, and `smooth --video` shows it in the report."
        )
    if head.trouble:
        return RecordingError(head.trouble)
    if what := no_table(head.raw, head.text if len(head.raw) < HEAD_BYTES else ""):
        return RecordingError(f"{head.path} {what}")
    return RecordingError(
        f"{head.path} has an unknown format{_lacking(head)}; it begins with: {first_rows(head)}. Known are"
        f" {keys()} (`unocclude import formats`); for any other table `unocclude import describe {head.path}`"
        " prints a recording.toml."
    )


def _lacking(head: FileHead) -> str:
    layout = head.table
    missing = [] if layout is None else missing_axes(layout.names)
    if missing:
        return f" (it has {missing_axes_words(missing)})"
    names = [name for name in layout.names if name] if layout is not None else []
    return f" (none of its columns {shown(', '.join(names), 120)} is recognised)" if names else ""


def keys() -> str:
    """Keys of all importers, for messages."""
    return ", ".join(importer.key for importer in formats())


class FileReader:
    """Reads device files, each once."""

    def __init__(
        self,
        imu_format: str | None = None,
        skeleton_format: str | None = None,
        templates: Sequence[Format] = (),
    ) -> None:
        self._named = {"imu": imu_format, "skeleton": skeleton_format}
        self._templates = templates
        self._tables: dict[tuple[Path, str], Tables] = {}
        self._formats: dict[Path, Format | None] = {}

    def format_of(self, path: Path, kind: str) -> Format:
        """The importer of a file that is to be an "imu" or a "skeleton" (or "" for either)."""
        if (key := self._named.get(kind)) is not None:
            return format_named(key)
        importer = self.recognised(path, (kind, "recording") if kind else ())
        if importer is None:
            raise unknown_file(read_head(path))
        if kind and importer.kind not in (kind, "recording"):
            other = "--skeleton" if importer.kind == "skeleton" else "--imu"
            raise RecordingError(f"{path} is recognised as {importer.title}; name it with {other}.")
        return importer

    def recognised(self, path: Path, kinds: tuple[str, ...] = ()) -> Format | None:
        """The importer of a file, looked for once; those of the kinds first."""
        known = self._formats.get(path)
        if known is None or (kinds and known.kind not in kinds):
            head = read_head(path)
            own = (each for each in self._templates if each.recognises(head))
            known = self._formats[path] = next(own, None) or recognise(head, kinds)
        return known

    def read(self, path: Path, importer: Format) -> Tables:
        """All tables of a file."""
        key = (path, importer.key)
        if key not in self._tables:
            try:
                self._tables[key] = importer.read(path)
            except RecordingError as error:
                if missing := _missing(path, importer.kind):
                    raise _lacks(path, importer, missing) from error
                recognised = self._formats.get(path) is importer  # what the user names is not overruled
                tables = self._by_names(path, importer, error) if recognised else []
                if not tables:
                    raise
                self._tables[key] = tables
            except UnoccludeError:  # a package or a model that is not there is no fault of the file
                raise
            except Exception as error:  # a damaged file fails anywhere, in libraries too
                raise RecordingError(
                    f"{path} was recognised as {importer.title}, but is damaged ({type(error).__name__});"
                    " export or copy it again."
                ) from error
            if not self._tables[key]:
                raise RecordingError(f"{path} ({importer.title}) has no rows; export it again.")
            if importer not in self._templates:  # those name their columns themselves
                _check_axes(path, importer, self._tables[key])
        return self._tables[key]

    def forget(self, path: Path) -> None:
        """Drop the tables of a file, which may be many."""
        self._tables = {key: tables for key, tables in self._tables.items() if key[0] != path}

    def _by_names(self, path: Path, importer: Format, error: RecordingError) -> list[ImuTable]:
        """A table that its importer refuses and whose columns suffice; [] where they do not."""
        from .named_table import NAMED_IMU, read_named_imu

        if importer.kind != "imu" or importer is NAMED_IMU or not NAMED_IMU.recognises(read_head(path)):
            return []
        try:
            tables = read_named_imu(path)
        except RecordingError:
            return []
        whole = [table for table in tables if table.acc is not None and table.gyro is not None]
        for table in whole:
            table.notes.append(f"It was read by its columns: as {importer.title} it cannot be ({error})")
        return whole


def _check_axes(path: Path, importer: Format, tables: Tables) -> None:
    """Refuse a table that lacks a column of a sensor or joint, unless others give it; note the rest."""
    missing = _missing(path, importer.kind)
    if not missing:
        return
    if importer.kind == "skeleton":
        raise _lacks(path, importer, missing)
    for table in tables:
        if isinstance(table, ImuTable) and (table.acc is None or table.gyro is None):
            raise _lacks(path, importer, missing)
    tables[0].notes.append(f"There is {missing_axes_words(missing)}: this vector was not read.")


def _missing(path: Path, kind: str) -> list[MissingAxis]:
    """Columns of a table's sensors, or of its arms' joints, that are not there while their siblings are."""
    head = read_head(path)
    layout = head.table
    if layout is None:
        return []
    if kind == "skeleton":
        incomplete = find_joint_columns(layout.names).incomplete
        return [each for each in missing_axes(layout.names) if set(each.present) & incomplete]
    return [each for each in missing_axes(layout.names) if each.is_of_sensor]


def _lacks(path: Path, importer: Format, missing: list[MissingAxis]) -> RecordingError:
    return RecordingError(
        f"{path} ({importer.title}) has {missing_axes_words(missing)}; export it again with all three axes."
    )
