"""A recovery as a CSV file, and as an Excel workbook with a sheet that describes the columns."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from ...array_types import FloatArray
from ...body import SEGMENTS, BodySegment
from ...errors import UnoccludeError
from ...result import Recovery
from ...result.segment_motion import SegmentMotion, TrunkMotion
from ...result.untrusted import usable
from ...runtime.outputs import writing
from ...runtime.packages import extra_module
from ...runtime.pool import Progress
from ..mcap.messages import nanoseconds

_ROWS = 20_000
_JOINTS = ("elbow", "wrist", "shoulder")


class ColumnGroup(NamedTuple):
    """Columns of an export that belong together.

    Attributes
    ----------
    names : list of str
        Of the columns.
    values : ndarray, shape (N, columns)
        nan where there is no answer.
    unit, description : str
        Of all of them.
    """

    names: list[str]
    values: FloatArray
    unit: str
    description: str


def export_csv(recovery: Recovery, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write one row a forearm-IMU sample; cells are empty where the method has no answer.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    path : path-like
        The file to write.
    force : bool
        Overwrite a file that exists.

    Notes
    -----
    Metres in the camera frame; `imu_q*` is the rotation IMU axes to camera; `t_s` is the IMU's own
    stamp with nine decimals; sigmas are one standard deviation per axis; velocity of the IMU, m/s.
    `trusted` is 1 where the answer is to be trusted, 0 where it is not, and empty without a verdict;
    `usable` (the last column) is 1 where there is an answer that is not distrusted, below the limit on sigma
    if one was set.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    header, values = csv_columns(recovery)
    header = [*header, "trusted", "usable"]
    marks = 2 * recovery.trusted.astype(np.uint8) + usable(recovery)
    words = np.array(["0,0", "0,1", "1,0", "1,1"] if recovery.has_verdict else [",0", ",1"] * 2)
    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    occluded = recovery.occluded.astype(int)
    line = "%s%d.%09d,%d" + ",%.9f" * values.shape[1] + ",%s\n"
    with writing(path, force) as temporary, open(temporary, "w", encoding="ascii", newline="") as file:
        file.write(",".join(header) + "\n")
        for start in range(0, len(stamp), _ROWS):
            part = slice(start, start + _ROWS)
            whole, rest = np.divmod(np.abs(stamp[part]), 1_000_000_000)
            sign = np.where(stamp[part] < 0, "-", "").tolist()
            heads = zip(sign, whole.tolist(), rest.tolist(), occluded[part].tolist(), strict=True)
            rows = zip(heads, values[part].tolist(), words[marks[part]].tolist(), strict=True)
            text = "".join([line % (*head, *row, last) for head, row, last in rows])
            file.write(text.replace("nan", ""))


def csv_columns(recovery: Recovery) -> tuple[list[str], FloatArray]:
    """Header of the export, and its number columns (N, C) between `t_s`, `occluded` and the marks."""
    groups = column_groups(recovery)
    header = ["t_s", "occluded", *(name for group in groups for name in group.names)]
    return header, np.concatenate([group.values for group in groups], axis=1)


def column_groups(recovery: Recovery) -> list[ColumnGroup]:
    """The numbers of an export, in the order of their columns."""
    count = len(recovery)
    nothing = np.full((count, 3), np.nan)
    position, sigma = (
        ("m", "position in the camera's frame"),
        ("m", "one standard deviation, per axis of the camera"),
    )
    sigma_deg = "square root of the trace of the orientation's covariance"
    groups: list[tuple[list[str], FloatArray, str, str]] = [
        (_xyz("imu"), recovery.position, *position),
        (
            [f"imu_q{part}" for part in "wxyz"],
            recovery.quaternion,
            "1",
            "rotation IMU axes to camera, quaternion",
        ),
    ]
    groups += [(_xyz(joint), recovery.joints.get(joint, nothing), *position) for joint in _JOINTS]
    groups.append((_xyz("sigma"), recovery.sigma_m, *sigma))
    groups.append((["sigma_deg"], recovery.sigma_deg, "deg", sigma_deg))
    for joint in ("wrist", "elbow", "shoulder"):
        spread = recovery.joint_covariance.get(joint)
        deviation = nothing if spread is None else np.sqrt(np.einsum("nii->ni", spread))
        groups.append((_xyz(f"{joint}_sigma"), deviation, *sigma))
    groups.append((["vx", "vy", "vz"], recovery.velocity, "m/s", "velocity of the IMU in the camera's frame"))
    if "hand" in recovery.joints:
        groups.append((_xyz("hand"), recovery.joints["hand"], *position))
    angles = recovery.angles()
    for angle in angles.angles:
        groups.append(([angle.column], angles.values[angle.name], "deg", angle.meaning))
        groups.append(([angle.sigma_column], angles.sigmas[angle.name], "deg", "one standard deviation"))
    for name, motion in recovery.segments.items():
        groups += _segment(SEGMENTS[name], motion)
    if recovery.trunk is not None:
        groups += _trunk(recovery.trunk)
    groups += [
        (
            [f"seen_by_{camera.name}"],
            camera.saw_at(recovery.t_s).astype(float),
            "1",
            "that camera saw the forearm",
        )
        for camera in recovery.estimates.cameras
        if camera.takes_part
    ]
    return [
        ColumnGroup(names, np.where(np.isfinite(values), values, np.nan).reshape(count, -1), *said)
        for names, values, *said in groups
    ]


def _segment(segment: BodySegment, motion: SegmentMotion) -> list[tuple[list[str], FloatArray, str, str]]:
    """Columns of an IMU on a further segment."""
    of, imu = segment.prefix, f"{segment.label.replace(' ', '-')} IMU"
    return [
        (_xyz(f"{of}_imu"), motion.position, "m", f"position of the {imu} in the camera's frame"),
        (
            [f"{of}_imu_q{part}" for part in "wxyz"],
            motion.quaternion,
            "1",
            f"rotation {imu} axes to camera, quaternion",
        ),
        (_xyz(segment.sigma_name), motion.sigma_m, "m", "one standard deviation, per axis of the camera"),
        ([f"{segment.sigma_name}_deg"], motion.sigma_deg, "deg", f"as sigma_deg, of the {imu}"),
    ]


def _trunk(trunk: TrunkMotion) -> list[tuple[list[str], FloatArray, str, str]]:
    """Columns of the thorax."""
    return [
        (
            [f"trunk_q{part}" for part in "wxyz"],
            trunk.quaternion,
            "1",
            "rotation thorax axes (ISB) to camera, quaternion",
        ),
        (["trunk_sigma_deg"], trunk.sigma_deg, "deg", "as sigma_deg, of the thorax"),
    ]


def _xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]


#: Rows of a sheet, the header's with them.
MOST_ROWS = 1_048_576
_SHEET_ROWS = 2_000
_DATE = re.compile(rb"(<dcterms:(?:created|modified)[^>]*>)[^<]*(</dcterms:)")


def check_xlsx(recovery: Recovery) -> None:
    """Refuse what no workbook can hold, before anything is written.

    Raises
    ------
    UnoccludeError
        openpyxl is not installed, or there are more samples than a sheet has rows.
    """
    extra_module("openpyxl", "openpyxl", "xlsx")
    if len(recovery) >= MOST_ROWS:
        raise UnoccludeError(
            f"{recovery.name} has {len(recovery):,} samples, and a sheet has at most {MOST_ROWS - 1:,}:"
            " export csv or parquet, or cut the recording"
        )


def export_xlsx(
    recovery: Recovery,
    path: str | os.PathLike[str],
    force: bool = False,
    progress: Progress | None = None,
) -> None:
    """Write the columns of the CSV export as the sheet `motion`; cells without an answer are empty.

    The sheet `columns` has unit and meaning of each, the sheet `about` recording, arm and verdict. `t_s` is
    rounded as a double is: of clocks that count from 1970 to some 0.2 microseconds.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    path : path-like
        The file to write.
    force : bool
        Overwrite a file that exists.
    progress : Progress, optional
        Told how far it is.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    check_xlsx(recovery)
    from openpyxl import Workbook

    groups = column_groups(recovery)
    values = np.concatenate([group.values for group in groups], axis=1)
    names = ["t_s", "occluded", *(name for group in groups for name in group.names), "trusted", "usable"]
    t_s = recovery.t_s + recovery.origin_ns / 1e9
    has_verdict = recovery.has_verdict
    book = Workbook(write_only=True)  # rows go to the disk as they come
    sheet = book.create_sheet("motion")
    sheet.freeze_panes = "B2"
    sheet.append(names)
    for start in range(0, len(recovery), _SHEET_ROWS):
        if progress is not None:
            progress(start / len(recovery), "writing rows")
        part = slice(start, start + _SHEET_ROWS)
        heads = zip(t_s[part].tolist(), recovery.occluded[part].tolist(), strict=True)
        marks = zip(recovery.trusted[part].tolist(), usable(recovery)[part].tolist(), strict=True)
        for (stamp, hidden), row, (trusted, good) in zip(heads, values[part].tolist(), marks, strict=True):
            sheet.append(
                [
                    stamp,
                    int(hidden),
                    *(None if value != value else value for value in row),
                    int(trusted) if has_verdict else None,
                    int(good),
                ]
            )
    _add_sheet(book, "columns", ("column", "unit", "meaning"), _meanings(recovery))
    _add_sheet(book, "about", ("what", "value"), _about(recovery))
    with writing(path, force) as temporary, tempfile.TemporaryFile() as made:
        book.save(made)
        _without_dates(made, temporary)


def _without_dates(made: IO[bytes], path: Path) -> None:
    """The workbook without the time at which it was written: the same result gives the same bytes."""
    with zipfile.ZipFile(made) as source, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as target:
        for name in source.namelist():
            entry = zipfile.ZipInfo(name)  # of 1980
            entry.compress_type = zipfile.ZIP_DEFLATED
            with source.open(name) as content, target.open(entry, "w") as file:
                if name == "docProps/core.xml":
                    file.write(_DATE.sub(rb"\g<1>1980-01-01T00:00:00Z\g<2>", content.read()))
                else:
                    shutil.copyfileobj(content, file)


def _meanings(recovery: Recovery) -> Iterable[tuple[str, str, str]]:
    yield "t_s", "s", "the IMU's own stamp"
    yield "occluded", "0/1", "1 where the camera had no forearm"
    for group in column_groups(recovery):
        for name in group.names:
            yield name, group.unit, group.description
    yield "trusted", "0/1", "0 where the answer is not to be trusted; empty without a verdict"
    yield "usable", "0/1", "1 where there is an answer that is not distrusted"


def _about(recovery: Recovery) -> Iterable[tuple[str, str]]:
    yield "recording", recovery.name
    yield "arm", recovery.arm_label
    yield "method", recovery.method
    yield "verdict", recovery.estimates.verdict
    for note in recovery.notes:
        yield "note", note


def _add_sheet(book: object, title: str, heads: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    """A sheet of texts; none of them is taken for a formula."""
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.utils.exceptions import IllegalCharacterError

    sheet = book.create_sheet(title)  # type: ignore[attr-defined]
    sheet.append(heads)
    for row in rows:
        cells = []
        for text in row:
            try:
                cell = WriteOnlyCell(sheet, value=text)
            except IllegalCharacterError:
                cell = WriteOnlyCell(sheet, value="".join(c for c in text if c.isprintable()))
            cell.data_type = "s"
            cells.append(cell)
        sheet.append(cells)
