"""A truth read from a file, its times counted from a recovery's origin."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ..array_types import FloatArray
from ..errors import RecordingError
from ..io.tables.file_head import shown
from ..recording import Truth
from ..result import Recovery
from ..runtime.inputs import check_input

#: What a truth may be read from.
FORMATS = (".mcap", ".csv")
_COLUMNS = ("t_s", "x", "y", "z")
_ORIENTATION = ("qw", "qx", "qy", "qz")


def read_truth(path: Path | str, recovery: Recovery) -> Truth:
    """Read the pose of the forearm IMU in the camera frame, on the IMU's clock.

    Parameters
    ----------
    path : path-like
        `.csv` with the columns t_s, x, y, z, qw, qx, qy, qz (m; the orientation columns may be missing or
        empty), or `.mcap` with `PoseInFrame`, `PoseStamped` or a recording's `/truth`.
    recovery : Recovery
        Whose origin the times are to count from.

    Raises
    ------
    RecordingError
        The file is missing, of another kind, or holds no pose.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(
            f"{path}: a truth is read from .c3d or .trc (markers), {' or '.join(FORMATS)} (poses), not from"
            f" '{path.suffix or path.name}'"
        )
    check_input(path, RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path}: there is no such file")
    if path.suffix.lower() == ".csv":
        return on_clock_of(recovery, read_truth_csv(path))
    return read_truth_mcap(path, recovery)


def read_truth_csv(path: Path) -> Truth:
    """Read a truth from a CSV file, its times as written.

    Raises
    ------
    RecordingError
        A column is missing, or a cell is no number; the text names the line.
    """
    check_input(path, RecordingError)
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            table = csv.reader(file)
            header = [name.strip() for name in next(table, [])]
            missing = [name for name in _COLUMNS if name not in header]
            if missing:
                raise RecordingError(
                    f"{path}: the column {', '.join(missing)} is missing; the file has"
                    f" {shown(', '.join(header)) or 'nothing'}"
                )
            rows = [(table.line_num, row) for row in table if any(cell.strip() for cell in row)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: not a CSV file with a header ({shown(str(error))})") from error
    values = np.full((len(rows), 8), np.nan)
    for place, name in enumerate(_COLUMNS + _ORIENTATION):
        if name in header:
            column = header.index(name)
            values[:, place] = [_number(row, column, path, line, name) for line, row in rows]
    values = values[np.isfinite(values[:, 0])]
    if not len(values):
        raise RecordingError(f"{path}: no row has a time")
    values = values[np.argsort(values[:, 0], kind="stable")]
    return Truth(values[:, 0], values[:, 1:4], values[:, 4:8], np.ones(len(values), dtype=bool))


def _number(row: list[str], column: int, path: Path, line: int, name: str) -> float:
    text = row[column].strip() if column < len(row) else ""
    if not text:
        return float("nan")
    try:
        return float(text)
    except ValueError:
        raise RecordingError(
            f"{path}, line {line}: '{shown(text, 40)}' in column {name} is no number"
        ) from None


def on_clock_of(recovery: Recovery, truth: Truth) -> Truth:
    """Count a plain file's times from the recovery's origin.

    A plain file counts from what the plain recording counted from: zero, or 1970. Where that leaves
    no overlap, its times are taken to count from the recovery's origin already.
    """
    shifted = truth.t_s - recovery.origin_ns * 1e-9
    if recovery.origin_ns and _overlap(shifted, recovery.t_s):
        return Truth(shifted, truth.position, truth.quaternion, truth.score, truth.joints)
    return truth


def _overlap(a: FloatArray, b: FloatArray) -> bool:
    return bool(len(a) and len(b) and a[0] <= b[-1] and b[0] <= a[-1])


def read_truth_mcap(path: Path, recovery: Recovery) -> Truth:
    """Read the truth of an MCAP file: the topic `/truth`, else its only topic of poses.

    Topics that name another side or body than the recovery's are another arm's.

    Raises
    ------
    RecordingError
        The file holds no pose, or several and none is called `/truth`.
    """
    from ..io import open_recording
    from ..io.recording.selection import is_of_other_arm

    all_poses = open_recording(path).poses
    poses = [one for one in all_poses if not is_of_other_arm(one.topic, recovery.side, recovery.body)]
    if all_poses and not poses:
        topics = ", ".join(one.topic for one in all_poses)
        raise RecordingError(
            f"{path}: no truth is named as that of the {recovery.arm_label}; it has {topics}"
        )
    named = [stream for stream in poses if stream.topic.rstrip("/").endswith("truth")] or poses
    if not named:
        raise RecordingError(f"{path}: the file holds no pose (PoseInFrame or PoseStamped) to take as truth")
    if len(named) > 1:
        topics = ", ".join(stream.topic for stream in named)
        raise RecordingError(
            f"{path}: several topics could be the truth ({topics}); keep one, or call it /truth"
        )
    stream = named[0]
    t_s: FloatArray = (stream.stamp_ns - recovery.origin_ns) / 1e9
    order = np.argsort(t_s, kind="stable")
    score = np.ones(len(t_s), dtype=bool) if stream.score is None else stream.score
    return Truth(
        t_s[order],
        stream.position[order],
        stream.quaternion[order],
        score[order],
        {name: value[order] for name, value in stream.joints.items()},
    )
