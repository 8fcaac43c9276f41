"""All formats of files, which of them a file belongs to, and files read, each once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from ..errors import RecordingError, UnoccludeError
from .recording.streams import ImuSamples
from .tables.imu import is_of_sensor, missing_axes, missing_axes_words
from .tables.imu_formats import IMU_FORMATS, NAMED_IMU
from .tables.joints import find_joint_columns
from .tables.table import HEAD_BYTES, FileHead, Format, Tables, first_rows, no_table, read_head, shown


@cache
def formats() -> tuple[Format, ...]:
    """All formats; where two recognise a file, the earlier one has it."""
    from .tables import binary, markers
    from .tables import skeleton_formats as skeletons

    return (
        *(binary.XDF, binary.ROSBAG1, binary.MCAP),
        *(skeletons.JOINT_ARRAY, markers.C3D_SKELETON, markers.TRC_SKELETON),
        *(skeletons.KINECT_JSON, skeletons.POSE_JSON, *skeletons.SKELETON_FORMATS),
        *(skeletons.JOINT_ROWS, skeletons.KINECT_NUMBERS),
        *(binary.MVNX, binary.APDM_HDF, binary.AXIVITY, *IMU_FORMATS, NAMED_IMU),
    )


def format_named(key: str) -> Format:
    """The format of that key."""
    found = next((each for each in formats() if each.key == key.strip().lower()), None)
    if found is None:
        raise RecordingError(f"{key} is not a format; formats are {keys()}.")
    return found


def keys() -> str:
    """Keys of all formats, for messages."""
    return ", ".join(each.key for each in formats())


def recognise(head: FileHead, kinds: tuple[str, ...] = ()) -> Format | None:
    """The format of a file by what is in it; those of the kinds first."""
    ordered = sorted(formats(), key=lambda each: bool(kinds) and each.kind not in kinds)
    return next((each for each in ordered if each.recognises(head)), None)


def unknown_file(head: FileHead) -> RecordingError:
    """The sentence about a file that no format recognises."""
    from .tables.video import is_video

    if is_video(head.raw):
        return RecordingError(
            f"{head.path} is a video; `unocclude import video {head.path} --model FILE.task` takes it as the"
            " camera."
        )
    if head.trouble:
        return RecordingError(head.trouble)
    if what := no_table(head.raw, head.text if len(head.raw) < HEAD_BYTES else ""):
        return RecordingError(f"{head.path} {what}")
    names = [name for name in head.table.names if name] if head.table is not None else []
    why = f" (none of its columns {shown(', '.join(names), 120)} is recognised)" if names else ""
    if missing := missing_axes(names):
        why = f" (it has {missing_axes_words(missing)})"
    if (
        re.search(r"[\[(]\s*-?[\d.]+\s*,\s*-?[\d.]+\s*,\s*-?[\d.]+\s*[\])]", head.text)
        and head.text[0] not in "{["
    ):
        why = " (several numbers in a cell; give each a column: wrist_right_x, wrist_right_y, ..)"
    return RecordingError(
        f"{head.path} has an unknown format{why}; it begins with: {first_rows(head)}. Known are"
        f" {keys()} (`unocclude import formats`); for any other table `unocclude import describe {head.path}`"
        " prints a recording.toml."
    )


class FileReader:
    """Reads files, each once."""

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
        """The format of a file that is to be an "imu" or a "skeleton" (or "" for either)."""
        if (key := self._named.get(kind)) is not None:
            return format_named(key)
        found = self.recognised(path, (kind, "recording") if kind else ())
        if found is None:
            raise unknown_file(read_head(path))
        if kind and found.kind not in (kind, "recording"):
            other = "--skeleton" if found.kind == "skeleton" else "--imu"
            raise RecordingError(f"{path} is recognised as {found.title}; name it with {other}.")
        return found

    def recognised(self, path: Path, kinds: tuple[str, ...] = ()) -> Format | None:
        """The format of a file, looked for once; those of the kinds first."""
        known = self._formats.get(path)
        if known is None or (kinds and known.kind not in kinds):
            head = read_head(path)
            own = (each for each in self._templates if each.recognises(head))
            known = self._formats[path] = next(own, None) or recognise(head, kinds)
        return known

    def read(self, path: Path, of: Format) -> Tables:
        """All tables of a file."""
        key = (path, of.key)
        if key not in self._tables:
            self._tables[key] = self.read_anew(path, of)
        return self._tables[key]

    def read_anew(self, path: Path, of: Format) -> Tables:
        """All tables of a file, which are not kept."""
        try:
            tables = of.read(path)
        except RecordingError as error:
            if not of.described and (missing := _missing(path, of.kind)):
                raise _lacks(path, of, missing) from error
            raise
        except UnoccludeError:  # a package or a model that is not there is no fault of the file
            raise
        except Exception as error:  # a damaged file fails anywhere, in libraries too
            raise RecordingError(
                f"{path} was recognised as {of.title}, but is damaged ({type(error).__name__}); export or"
                " copy it again."
            ) from error
        if not tables:
            raise RecordingError(f"{path} ({of.title}) has no rows; export it again.")
        if not of.described and (missing := _missing(path, of.kind)):
            halves = [t for t in tables if isinstance(t, ImuSamples) and (t.acc is None or t.gyro is None)]
            if of.kind == "skeleton" or halves:
                raise _lacks(path, of, missing)
            tables[0].notes.append(f"There is {missing_axes_words(missing)}: this vector was not read.")
        return tables


def _missing(path: Path, kind: str) -> dict[str, list[str]]:
    """Columns of a table's sensors, or of its arms' joints, that are not there while their siblings are."""
    table = read_head(path).table
    if table is None:
        return {}
    of_joints = find_joint_columns(table.names).incomplete if kind == "skeleton" else None
    return {
        name: two
        for name, two in missing_axes(table.names).items()
        if (is_of_sensor(name) if of_joints is None else set(two) & of_joints)
    }


def _lacks(path: Path, of: Format, missing: dict[str, list[str]]) -> RecordingError:
    return RecordingError(
        f"{path} ({of.title}) has {missing_axes_words(missing)}; export it again with all three axes."
    )
