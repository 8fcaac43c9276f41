"""What device files contain, stream by stream: names, rates, units, axes, and a small plot of each."""

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
from ..registry import FileReader, Tables, unknown_file
from .columns import Guess, guess_of
from .imu import ImuTable
from .skeletons import SkeletonTable
from .table import (
    HEAD_BYTES,
    FileHead,
    Format,
    Table,
    first_rows,
    is_workbook,
    read_head,
    read_table,
    shown,
    unpacked_size,
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


@dataclass(frozen=True)
class StreamPlot:
    """A small plot of a stream."""

    title: str  # What is plotted ("accelerometer", "m/s^2")
    unit: str  # What is plotted ("accelerometer", "m/s^2")
    t_s: list[float]  # Middle of each column, from the stream's first sample
    lines: list[dict[str, Any]]  # `name` ("x"), `low` and `high`


@dataclass(frozen=True)
class DescribedStream:
    """One IMU or one person's skeleton of a file."""

    kind: str  # "imu" or "skeleton"
    name: str  # What the file calls the sensor; "" where it does not say
    holds: list[str]  # Sensors of the device, or joints
    count: int  # Samples or frames
    rate_hz: float | None  # Median rate
    start_s: float  # First time on the file's own clock, and from there to the last
    duration_s: float  # First time on the file's own clock, and from there to the last
    units: str  # As the file has them
    axes: str = ""  # Of a skeleton: "kinect", "optical", "zup", or "" where the file does not settle them
    body: int | None = None  # The file's number of the person
    plots: list[StreamPlot] = field(default_factory=list)


@dataclass
class DescribedFile:
    """A file among others."""

    file: str  # Its path as given
    format: str = ""  # Key and name of its importer; "" where it is of none
    title: str = ""  # Key and name of its importer; "" where it is of none
    # "imu", "skeleton", "recording", "video", "model" (of the pose landmarker), "calibration", "description"
    # (a recording.toml), or "" where the file is not recognised or cannot be read
    kind: str = ""
    streams: list[DescribedStream] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # What was decided or corrected
    error: str = ""  # Why it cannot be used; "" where it can
    guess: dict[str, Any] | None = None  # Of a table that no importer knows

    def to_dict(self) -> dict[str, Any]:
        """As plain values."""
        return asdict(self)


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
        importer = reader.recognised(path)
        if importer is None:
            about.guess = _guess(path, head)
            about.error = str(unknown_file(head))
            return about
        about.format, about.title, about.kind = importer.key, importer.title, importer.kind
        with _beginning(path, head) as (short, notes):
            tables = reader.read(short, importer)
            about.streams, about.notes = _streams(path, tables)
            about.notes += notes
            reader.forget(short)
        if any(table.units for table in tables):  # where the units are wrong, the columns can be described
            about.guess = _guess(path, head)
    except RecordingError as error:
        about.error = str(error)
    return about


@contextmanager
def _beginning(path: Path, head: FileHead) -> Iterator[tuple[Path, list[str]]]:
    """A file, or a copy of a long table's first rows: looking at it must not take memory with its length."""
    workbook = is_workbook(head.raw)
    size = unpacked_size(path) if workbook and head.text else path.stat().st_size
    longest = _WORKBOOK if workbook else _BEGINNING
    if size <= longest or head.table is None:
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
    if path.suffix.lower() == ".toml" and "unocclude calibration" in head.text[:4000]:
        return "calibration", "Calibration"
    return None


def _streams(path: Path, tables: Tables) -> tuple[list[DescribedStream], list[str]]:
    streams: list[DescribedStream] = []
    notes: list[str] = []
    for table in tables:
        if isinstance(table, SkeletonTable):
            skeleton = repaired_skeleton(table, str(path))
            streams.append(_skeleton(skeleton))
            notes += skeleton.notes
        else:
            imu = repaired_imu(table, str(path))
            streams.append(_imu(imu))
            notes += imu.notes
    return streams, list(dict.fromkeys(notes))


def _imu(table: ImuTable) -> DescribedStream:
    sensors = {
        "accelerometer": (table.acc, "m/s^2"),
        "gyroscope": (table.gyro, "rad/s"),
        "magnetometer": (table.mag, "as in the file"),
    }
    t_s = times_of(table)
    there = {name: (values, unit) for name, (values, unit) in sensors.items() if values is not None}
    plots = [
        _plot(name, unit, t_s, {axis: values[:, k] for k, axis in enumerate("xyz")})
        for name, (values, unit) in there.items()
        if name != "magnetometer"
    ]
    return DescribedStream("imu", table.name, list(there), *_timing(t_s), table.units, plots=plots)


def _skeleton(table: SkeletonTable) -> DescribedStream:
    t_s = times_of(table)
    frame = "" if table.frame is None else str(table.frame.value)
    tracked = {
        joint: np.where((table.state[joint] == JointState.TRACKED)[:, None], table.position[joint], np.nan)
        for joint in table.position
    }
    seen = [joint for joint, values in tracked.items() if np.isfinite(values).any()]
    plots = []
    for side in ("left", "right", ""):
        names = [f"{joint}_{side}" if side else joint for joint in _PLOTTED]
        if name := next((name for name in names if name in seen), None):
            axes = {axis: tracked[name][:, k] for k, axis in enumerate("xyz")}
            plots.append(_plot(name.replace("_", " "), "m", t_s, axes))
    return DescribedStream("skeleton", "", sorted(seen), *_timing(t_s), table.units, frame, table.body, plots)


def _timing(t_s: FloatArray) -> tuple[int, float | None, float, float]:
    """Count, rate, first time and duration of corrected times."""
    if not len(t_s):
        return 0, None, 0.0, 0.0
    rate = median_rate_hz(t_s)
    return (
        len(t_s),
        round(rate, 3) if math.isfinite(rate) else None,
        float(t_s[0]),
        round(float(t_s[-1] - t_s[0]), 3),
    )


def _plot(title: str, unit: str, t_s: FloatArray, lines: dict[str, FloatArray]) -> StreamPlot:
    """Least and largest value of each line in `BINS` columns of even length."""
    if not len(t_s):
        return StreamPlot(title, unit, [], [])
    since = t_s - t_s[0]
    length = max(float(since[-1]), 1e-9)
    bins = min(BINS, max(len(t_s), 1))
    column = np.minimum((since / length * bins).astype(np.int64), bins - 1)
    middles = (np.arange(bins) + 0.5) * length / bins
    drawn = []
    for name, values in lines.items():
        low, high = np.full(bins, np.inf), np.full(bins, -np.inf)
        good = np.isfinite(values)
        np.minimum.at(low, column[good], values[good])
        np.maximum.at(high, column[good], values[good])
        drawn.append({"name": name, "low": _rounded(low), "high": _rounded(high)})
    return StreamPlot(title, unit, [round(float(t), 4) for t in middles], drawn)


def _rounded(values: FloatArray) -> list[float | None]:
    return [float(f"{value:.4g}") if math.isfinite(value) else None for value in values]


def guessed_table(path: Path, reader: FileReader) -> tuple[Format | None, Table | None, Guess | None]:
    """The importer of a file, and what it would be taken for as a plain table."""
    head = read_head(path)
    importer = reader.recognised(path)
    try:
        with _beginning(path, head) as (short, notes):
            sheet = read_table(short)
            sheet.path = path
            sheet.notes += notes
    except RecordingError:
        if importer is None:
            raise
        return importer, None, None
    guess = guess_of(sheet)
    if not guess.kind:
        raise RecordingError(
            f"{path} has {sheet.width} columns and {len(sheet)} rows, and none of them look like an"
            f" accelerometer's, a gyroscope's or a joint's; it begins: {first_rows(head)}."
        )
    return importer, sheet, guess


def _guess(path: Path, head: FileHead) -> dict[str, Any] | None:
    """What a table of an unknown layout seems to contain; None if it is not a table, or is too long."""
    if not head.text:
        return None
    try:
        with _beginning(path, head) as (short, _):
            sheet = read_table(short)
        guess = guess_of(sheet)
    except RecordingError:
        return None
    return {**_plain(guess), "names": column_names(sheet), "rows": _first_rows(sheet)}


def _plain(guess: Guess) -> dict[str, Any]:
    return {
        "kind": guess.kind,
        "columns": guess.columns,
        "keys": guess.keys,
        "reasons": guess.reasons,
        "unsure": guess.unsure,
    }


def column_names(sheet: Table) -> list[str]:
    """Names of a table's columns as written; () where it has no header."""
    return list(sheet.names)


def _first_rows(sheet: Table) -> list[list[str]]:
    width = sheet.width
    columns = [[shown(cell, 24) for cell in sheet.texts(k)[:SHOWN_ROWS]] for k in range(width)]
    return [list(row) for row in zip(*columns, strict=True)]
