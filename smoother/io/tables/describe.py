"""What files contain, stream by stream: names, rates, units, axes, and a small plot of each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...linalg import median_rate_hz
from ...recording import JointState
from ..files import files_meant, times_of
from ..recording.streams import ImuSamples, SkeletonTable
from ..registry import FileReader, unknown_file
from .guess import Guess, guess_of
from .table import (
    HEAD_BYTES,
    DeviceTable,
    FileHead,
    Format,
    first_rows,
    is_workbook,
    part_sizes,
    read_head,
    read_table,
    shown,
    workbook_text,
)
from .times import repaired_imu, repaired_skeleton
from .video import is_model, is_video

#: Columns of a plot: of the samples that fall into one, the least and the largest are kept.
BINS = 200
#: A longer table is described by its beginning, bytes: all of 16 MB takes some 170 MB of memory.
_BEGINNING = 16_000_000
#: Of a workbook, bytes unpacked and rows.
_WORKBOOK, _WORKBOOK_ROWS = 60_000_000, 100_000
#: Rows of an unknown table that are shown.
SHOWN_ROWS = 6
#: Joints that are plotted, the first that a side has.
_PLOTTED = ("wrist", "strap", "hand", "elbow")


@dataclass
class DescribedFile:
    """A file among others."""

    file: str  # Its path as given
    format: str = ""  # Key and title of its format; "" where it is of none
    title: str = ""
    # "imu", "skeleton", "recording", "video", "model" (of the pose landmarker), "calibration", "description"
    # (a recording.toml), or "" where the file is not recognised or cannot be read
    kind: str = ""
    # One IMU or one person's skeleton each: `kind`, `name` of the sensor, `holds` (sensors or joints),
    # `count`, `rate_hz`, `start_s`, `duration_s`, `units`, `axes`, `body`, and `plots`, each with `title`,
    # `unit`, `t_s` in the middle of each column, `lines` (`name`, `low`, `high`)
    streams: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # What was decided or corrected
    error: str = ""  # Why it cannot be used; "" where it can
    guess: dict[str, Any] | None = None  # Of a table that no format knows


def describe_files(
    paths: list[Path], reader: FileReader | None = None, output: Path | None = None
) -> list[DescribedFile]:
    """Look at files, one after the other; none is refused."""
    reader = reader or FileReader()
    return [describe_file(path, reader) for path in files_meant(paths, output)]


def describe_file(path: Path, reader: FileReader) -> DescribedFile:
    """What one file contains; what is wrong with it is in `error`."""
    about = DescribedFile(str(path))
    try:
        head = read_head(path)
        if what := _no_stream(path, head):
            about.kind, about.title = what
            return about
        found = reader.recognised(path)
        if found is None:
            about.guess = _guess(path)
            about.error = str(unknown_file(head))
            return about
        about.format, about.title, about.kind = found.key, found.title, found.kind
        with _beginning(path, head) as (short, notes):
            tables = reader.read_anew(short, found)
            for table in tables:
                stream, said = _stream(table, str(path))
                about.streams.append(stream)
                about.notes += [note for note in said if note not in about.notes]
            about.notes += notes
        if any(table.units for table in tables):  # where the units are wrong, the columns can be described
            about.guess = _guess(path)
    except RecordingError as error:
        about.error = str(error)
    return about


@contextmanager
def _beginning(path: Path, head: FileHead) -> Iterator[tuple[Path, list[str]]]:
    """A file, or a copy of a long table's first rows: looking at it must not take memory with its length."""
    workbook = is_workbook(head.raw)
    size = sum(part_sizes(path).values()) if workbook and head.text else path.stat().st_size
    if size <= (_WORKBOOK if workbook else _BEGINNING) or head.table is None:
        yield path, []
        return
    with TemporaryDirectory() as folder:
        short = Path(folder) / path.name
        if workbook:
            short.write_text(workbook_text(path, _WORKBOOK_ROWS), encoding="utf-8")
        else:
            with path.open("rb") as file:
                raw = file.read(_BEGINNING)
            end = raw.rfind(b"\n\0" if b"\n\0" in raw[:HEAD_BYTES] else b"\n")
            short.write_bytes(raw[: end + (2 if raw[end + 1 : end + 2] == b"\0" else 1)])
        share = "" if workbook else f" ({_BEGINNING / size:.0%} of it)"
        try:
            yield short, [f"{path.name} is long: it is described by its beginning{share}."]
        except RecordingError as error:
            raise RecordingError(str(error).replace(str(short), str(path))) from error


def _no_stream(path: Path, head: FileHead) -> tuple[str, str] | None:
    """Kind and title of a file that is not a device's stream but is used."""
    if is_video(head.raw):
        return "video", "Video"
    if head.raw.startswith(b"PK") and is_model(path):
        return "model", "Model of MediaPipe's pose landmarker"
    if path.name == "recording.toml":
        return "description", "recording.toml"
    is_calibration = path.suffix.lower() == ".toml" and "unocclude calibration" in head.text[:4000]
    return ("calibration", "Calibration") if is_calibration else None


def _stream(table: ImuSamples | SkeletonTable, source: str) -> tuple[dict[str, Any], list[str]]:
    """A stream with corrected times, and what was decided of it."""
    if isinstance(table, ImuSamples):
        imu = repaired_imu(table, source)
        sensors = {"accelerometer": imu.acc, "gyroscope": imu.gyro, "magnetometer": imu.mag}
        holds, t_s = [name for name, values in sensors.items() if values is not None], times_of(imu)
        units = (("accelerometer", "m/s^2"), ("gyroscope", "rad/s"))
        plots = [_plot(name, unit, t_s, each) for name, unit in units if (each := sensors[name]) is not None]
        of_kind: dict[str, Any] = {
            "kind": "imu",
            "name": imu.topic,
            "axes": "",
            "body": None,
            "units": imu.units,
        }
        notes = imu.notes
    else:
        body = repaired_skeleton(table, source)
        t_s, notes = times_of(body), body.notes
        tracked = {
            joint: np.where((body.state[joint] == JointState.TRACKED)[:, None], place, np.nan)
            for joint, place in body.position.items()
        }
        holds = sorted(joint for joint, values in tracked.items() if np.isfinite(values).any())
        plots = []
        for side in ("left", "right", ""):
            names = [f"{joint}_{side}" if side else joint for joint in _PLOTTED]
            if name := next((name for name in names if name in holds), None):
                plots.append(_plot(name.replace("_", " "), "m", t_s, tracked[name]))
        axes = "" if body.frame is None else str(body.frame.value)
        of_kind = {"kind": "skeleton", "name": "", "axes": axes, "body": body.body, "units": body.units}
    rate = median_rate_hz(t_s) if len(t_s) else math.nan
    timing = {
        "count": len(t_s),
        "rate_hz": round(rate, 3) if math.isfinite(rate) else None,
        "start_s": float(t_s[0]) if len(t_s) else 0.0,
        "duration_s": round(float(t_s[-1] - t_s[0]), 3) if len(t_s) else 0.0,
    }
    return {**of_kind, "holds": holds, **timing, "plots": plots}, notes


def _plot(title: str, unit: str, t_s: FloatArray, values: FloatArray) -> dict[str, Any]:
    """Least and largest value of x, y and z in `BINS` columns of even length."""
    since = t_s - t_s[:1]
    length = max(float(since[-1]), 1e-9) if len(t_s) else 0.0
    bins = min(BINS, len(t_s))
    column = np.minimum((since / length * bins).astype(np.int64), bins - 1) if bins else np.zeros(0, int)
    lines = []
    for name, line in zip("xyz", values.T, strict=True):
        low, high, good = np.full(bins, np.inf), np.full(bins, -np.inf), np.isfinite(line)
        np.minimum.at(low, column[good], line[good])
        np.maximum.at(high, column[good], line[good])
        lines.append({"name": name, "low": _rounded(low), "high": _rounded(high)})
    middles = [round((at + 0.5) * length / bins, 4) for at in range(bins)]
    return {"title": title, "unit": unit, "t_s": middles, "lines": lines if bins else []}


def _rounded(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.4g}") if math.isfinite(value) else None for value in values]


def guessed_table(path: Path, reader: FileReader) -> tuple[Format | None, DeviceTable | None, Guess | None]:
    """The format of a file, and what it would be taken for as a plain table."""
    found = reader.recognised(path)
    try:
        table, guess = _guessed(path)
    except RecordingError:
        if found is None:
            raise
        return found, None, None
    if not guess.kind:
        raise RecordingError(
            f"{path} has {table.width} columns and {len(table)} rows, and none of them look like an"
            f" accelerometer's, a gyroscope's or a joint's; it begins: {first_rows(read_head(path))}."
        )
    return found, table, guess


def _guessed(path: Path) -> tuple[DeviceTable, Guess]:
    """A file as a plain table, and what that seems to contain."""
    with _beginning(path, read_head(path)) as (short, notes):
        table = read_table(short)
        table.path = path
        table.notes += notes
    return table, guess_of(table)


def _guess(path: Path) -> dict[str, Any] | None:
    """What a table of an unknown layout seems to contain, as plain values; None if it is not a table."""
    try:
        table, guess = _guessed(path)
    except RecordingError:
        return None
    columns = [[shown(cell, 24) for cell in table.texts(at)[:SHOWN_ROWS]] for at in range(table.width)]
    rows = [list(row) for row in zip(*columns, strict=True)]
    return {**asdict(guess), "names": list(table.names), "rows": rows}
