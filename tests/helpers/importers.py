"""Files of devices: written in a layout, read by their importer, compared with the motion."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from imu_files import motion

from smoother.io import open_csv
from smoother.io.recording.read import select_recordings
from smoother.io.recording.streams import ImuSamples, RecordingFile, SkeletonTable
from smoother.io.registry import FileReader, recognise
from smoother.io.tables.table import read_head
from smoother.recording import Recording

ACC, GYRO = motion()
COUNT = len(ACC)
DEG = np.degrees(GYRO)
TIME = np.arange(COUNT) * 0.01
MICROS = (np.arange(COUNT) * 10_000 + 4_000_000).astype(np.int64)
EPOCH = 1_520_000_000_000 + 10 * np.arange(COUNT)
NANOS = (np.arange(COUNT) * 10_000_000 + 123_456_789_000).astype(np.int64)


def import_csv(folder: Path, **options: Any) -> Recording:
    """The one arm of a folder with a recording.toml."""
    return select_recording(open_csv(folder), **options)


def select_recording(file: RecordingFile, **options: Any) -> Recording:
    """The one arm of a file that is meant."""
    return select_recordings(file, alone=True, **options)[0]


def written(tmp_path: Path, *lines: str, newline: str = "\n") -> Path:
    """A file of these lines, whose name says nothing."""
    path = tmp_path / "anything.dat"
    path.write_text(newline.join(lines) + newline, encoding="utf-8")
    return path


def tables(path: Path, key: str) -> list[Any]:
    """What a file holds, read by its importer, which must be the one of that key."""
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == key, importer
    return list(FileReader().read(path, importer))


def streams(path: Path, key: str) -> tuple[list[SkeletonTable], list[ImuSamples]]:
    """Skeletons and IMUs of a recording."""
    found = tables(path, key)
    skeletons = [table for table in found if isinstance(table, SkeletonTable)]
    return skeletons, [table for table in found if isinstance(table, ImuSamples)]


def check(
    table: ImuSamples, acc: np.ndarray | None, gyro: np.ndarray | None, t_s: np.ndarray | None = None
) -> None:
    """The table's values are these, to rounding."""
    for values, expected in ((table.acc, acc), (table.gyro, gyro)):
        if expected is None:
            assert values is None
        else:
            np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)
    if t_s is not None:
        np.testing.assert_allclose(table.t_s, t_s, rtol=0, atol=1e-6)


def xyz(name: str, form: str = "{}_{}") -> list[str]:
    """Names of three columns."""
    return [form.format(name, axis) for axis in "XYZ"]


def turning(count: int, rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, specific force and angular velocity of a sensor that turns about a level axis."""
    t = np.arange(count) / rate_hz
    angle, rate = 0.8 * np.sin(2 * t), 1.6 * np.cos(2 * t)
    acc = 9.81 * np.stack([np.sin(angle), np.cos(angle), 0 * t], axis=1)
    return t, acc, np.stack([0 * t, 0 * t, rate], axis=1)


def workbook(path: Path, rows: Iterable[Sequence[object]], before: Sequence[str] = ()) -> Path:
    """A workbook of these rows, behind sheets of words."""
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    for name in before:
        book.create_sheet(name).append(["words"])
    sheet = book.create_sheet()
    for row in rows:
        sheet.append(row)
    book.save(path)
    return path


def as_workbook(text: Path, path: Path, separator: str = ",") -> Path:
    """A table of text as a workbook with numbers in its cells, behind sheets of words."""
    lines = (
        [cell.strip('"') for cell in line.split(separator)] for line in text.read_text("utf-8").splitlines()
    )
    rows = (
        [float(c) if re.fullmatch(r"-?[\d.]+(E[+-]\d+)?", c) else c or None for c in cells] for cells in lines
    )
    return workbook(path, rows, ("notes", "one", "two"))
