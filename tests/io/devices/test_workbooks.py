"""Excel workbooks are read as the tables that they hold."""

from __future__ import annotations

import sys
from datetime import datetime, timedelta
from pathlib import Path

import device_files as made
import numpy as np
import pytest

from smoother.errors import RecordingError
from smoother.io.devices.registry import FileReader, recognise
from smoother.io.plain.folder import open_csv
from smoother.io.tables.protocol import ImuTable, read_head
from smoother.io.tables.text_table import read_sheet

openpyxl = pytest.importorskip("openpyxl", reason="the extra `xlsx` is not installed")


def as_workbook(text: Path, path: Path, separator: str = ",", before: tuple[str, ...] = ()) -> Path:
    """A table of text as a workbook with numbers in its cells, behind sheets of words."""
    book = openpyxl.Workbook()
    book.active.append(["notes of the session"])
    for name in before:
        book.create_sheet(name).append(["words"])
    sheet = book.create_sheet("data")
    for line in text.read_text("utf-8").splitlines():
        cells = [cell.strip('"') for cell in line.split(separator)]
        sheet.append([float(cell) if is_number(cell) else cell or None for cell in cells])
    book.save(path)
    return path


def is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(
    ("key", "separator"), [("nilspod", ","), ("x-imu", ","), ("xsens-dot", ","), ("imu-table", ";")]
)
def test_a_workbook_reads_as_its_table(tmp_path: Path, key: str, separator: str):
    made.EXAMPLES[key](tmp_path / "a.csv")
    path = as_workbook(tmp_path / "a.csv", tmp_path / "a.xlsx", separator, ("one", "two"))
    importer = recognise(read_head(path))
    assert importer is not None and importer.key == key
    reader = FileReader()
    (mine,), (theirs,) = (reader.read(each, importer) for each in (path, tmp_path / "a.csv"))
    assert isinstance(mine, ImuTable) and isinstance(theirs, ImuTable)
    assert np.allclose(mine.acc, theirs.acc) and np.allclose(mine.gyro, theirs.gyro)
    assert np.allclose(mine.t_s, theirs.t_s)


def test_dates_in_cells(tmp_path: Path):
    book = openpyxl.Workbook()
    book.active.append(["Zeit", "x", "y"])
    for k in range(20):
        book.active.append([datetime(2026, 3, 12, 9, 30) + timedelta(milliseconds=10 * k), k, 0.5])
    book.save(tmp_path / "a.xlsx")
    times, dates = read_sheet(tmp_path / "a.xlsx").times(0)
    assert dates and np.allclose(np.diff(times), 0.01, atol=1e-3)


def test_a_recording_toml_may_name_a_workbook(tmp_path: Path):
    made.EXAMPLES["nilspod"](tmp_path / "a.csv")
    as_workbook(tmp_path / "a.csv", tmp_path / "a.xlsx")
    columns = ["gx", "gy", "gz", "ax", "ay", "az"]
    lines = [
        "[imu.forearm_right]",
        'file = "a.xlsx"',
        "skip_rows = 0",
        'gyroscope_unit = "deg/s"',
        "[imu.forearm_right.columns]",
        "t = 1",
    ]
    lines += [f"{name} = {k}" for k, name in enumerate(columns, 2)]
    (tmp_path / "recording.toml").write_text("\n".join(lines) + "\n")
    (imu,) = open_csv(tmp_path).imus
    assert np.allclose(imu.acc, made.ACC, atol=1e-5)


def test_without_openpyxl_the_sentence_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made.EXAMPLES["nilspod"](tmp_path / "a.csv")
    path = as_workbook(tmp_path / "a.csv", tmp_path / "a.xlsx")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    assert recognise(read_head(path)) is None
    with pytest.raises(RecordingError, match=r"pip install '\.\[xlsx\]'.*or save it as CSV"):
        read_sheet(path)


def test_a_damaged_workbook_is_one_sentence(tmp_path: Path):
    made.EXAMPLES["nilspod"](tmp_path / "a.csv")
    path = as_workbook(tmp_path / "a.csv", tmp_path / "a.xlsx")
    raw = path.read_bytes()
    for cut in (200, len(raw) // 2, len(raw) - 10):
        path.write_bytes(raw[:cut])
        with pytest.raises(RecordingError, match=r"cannot be read|is an archive"):
            read_sheet(path)
        assert recognise(read_head(path)) is None
