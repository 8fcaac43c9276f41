"""Texts that a spreadsheet would run are escaped in every table, and read back as they were."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from smoother.runtime.csv_rows import read_cell, write_rows
from smoother.study.inputs import _rows


@pytest.mark.parametrize(
    ("value", "written"),
    [
        ('=HYPERLINK("http://x")', '\'=HYPERLINK("http://x")'),
        *(
            ("+1+cmd", "'+1+cmd"),
            ("-2+3", "'-2+3"),
            ("@SUM(A1)", "'@SUM(A1)"),
            ("\t=1", "'\t=1"),
            (" =1", "' =1"),
        ),
        *(
            ("-2.5", "-2.5"),
            ("+1e-3", "+1e-3"),
            (-2.5, "-2.5"),
            ("a=b", "a=b"),
            ("", ""),
            (None, ""),
            ("'a", "'a"),
        ),
        ("'=1", "''=1"),
    ],
)
def test_a_formula_is_a_text(value: object, written: str):
    file = io.StringIO()
    write_rows(file, [["x", value]])
    ((_, cell),) = csv.reader(io.StringIO(file.getvalue(), newline=""))
    assert cell == written and read_cell(cell) == ("" if value is None else str(value))


def test_tables_of_a_study(tmp_path: Path):
    with (tmp_path / "sessions.csv").open("w") as file:
        write_rows(file, [("file", "person", "session"), ("a.mcap", "=p", "-s1")])
    ((_, cells),) = _rows(tmp_path / "sessions.csv")
    assert (cells["person"], cells["session"]) == ("=p", "-s1"), "names are the same again"
