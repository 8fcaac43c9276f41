"""Delimited text in every dress that devices and spreadsheets give it, and Excel workbooks."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import device_files as made
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from importers import as_workbook, workbook

from smoother.errors import RecordingError
from smoother.io.registry import recognise
from smoother.io.tables.columns import read_exact as read_strict
from smoother.io.tables.table import read_head, read_table, seconds_of_dates
from smoother.io.tables.units import ACCELERATION, ANGULAR_VELOCITY, plain_unit, split_unit

NAMES = ("Time", "Acc X", "Acc Y", "Acc Z")
ROWS = np.array([[0.01 * k, 0.5 + k, -9.81 - k / 7, 1e-5 * k] for k in range(12)])


def table(
    separator: str = ",", comma: bool = False, end: str = "", names: tuple[str, ...] = NAMES
) -> list[str]:
    """Lines of a small table."""
    lines = [separator.join(names) + end] if names else []
    for row in ROWS:
        cells = [repr(float(value)) for value in row]
        lines.append(separator.join(c.replace(".", ",") if comma else c for c in cells) + end)
    return lines


def read(text: str):
    return read_table(Path("file.csv"), text=text)


def values(sheet) -> np.ndarray:
    return sheet.vectors(range(4))


@given(
    separator=st.sampled_from([",", ";", "\t", "|", " ", ", ", "; ", "  "]),
    comma=st.booleans(),
    trailing=st.booleans(),
    sep_line=st.sampled_from(["", "sep=,", '"sep=\t"', '"sep=,"', "sep=;"]),
    preamble=st.sampled_from([(), ("Device: 7", "Rate:,100,Hz", ""), ("// a", "# 12")]),
    units=st.booleans(),
    header=st.booleans(),
    newline=st.sampled_from(["\n", "\r\n", "\r"]),
    last=st.booleans(),
)
def test_any_dress(separator, comma, trailing, sep_line, preamble, units, header, newline, last):
    comma &= separator.strip() != ","
    end = separator.strip() if trailing else ""
    names = ("t", "ax", "ay", "az") if not separator.strip() else NAMES
    lines = table(separator, comma, end, names if header else ())
    if units and header:
        lines.insert(1, separator.join(("s", "m/(s^2)", "m/s²", "m/s^2")) + end)
    lines = [line for line in (sep_line, *preamble) if line or preamble] + lines
    sheet = read(newline.join(lines) + (newline if last else ""))
    assert np.array_equal(values(sheet), ROWS)
    assert sheet.names[:4] == (names if header else ())
    if units and header:
        assert [plain_unit(u) for u in sheet.units[:4]] == ["s", "m/(s^2)", "m/s^2", "m/s^2"]
    assert len(sheet.notes) == (not last) and all("without a line break" in note for note in sheet.notes)


@pytest.mark.parametrize("cut", [1, 3, 6, 7])
@pytest.mark.parametrize("comma", [False, True])
def test_a_table_that_ends_within_a_number(cut: int, comma: bool):
    rows = [[f"{0.01 * k:.4f}", *(f"{value:.6f}" for value in (k, -k, 9.81))] for k in range(12)]
    text = "\n".join(";".join(row) for row in [NAMES, *rows])
    text = text.replace(".", ",") if comma else text
    sheet = read(text[:-cut])
    assert len(sheet) == 11 and sheet.notes == ["The last line is cut off and was left out."]
    sheet = read(text)  # cut off behind the number, or by a program that ends files so
    assert len(sheet) == 12 and sheet.numbers(3)[11] == 9.81
    assert sheet.notes == [
        "The file ends without a line break; if it was cut off, what came behind line 13 is missing."
    ]


def test_gaps_in_a_table_are_missing_and_said():
    lines = table()
    lines[3] = "0.02,,-10,nan"
    lines[5] = "0.04,-124.874.1,1,2"
    lines[7] = "0.06,1"
    lines.insert(9, lines[0])
    lines.insert(10, "")
    lines[-1] = lines[-1][:6]
    sheet = read("\n".join(lines))
    assert len(sheet) == 11
    acc = sheet.numbers(1)
    assert np.isnan(acc[[2, 4]]).all() and acc[5] == 5.5
    assert np.isnan(sheet.numbers(3)[2]) and sheet.numbers(2)[2] == -10
    said = " ".join(sheet.notes)
    for part in ("'-124.874.1' in line 6", "last line is cut off", "Repeated headers", "as missing: 1."):
        assert part in said
    assert sheet.line(4) == 6


def test_first_rows_without_most_sensors_are_rows():
    lines = ["t,ax,ay,az,gx,gy,gz", "0.0,,,,,,", "0.1,1,2,3,,,", *(f"0.{k},1,2,3,4,5,6" for k in range(2, 9))]
    sheet = read("\n".join(lines))
    assert len(sheet) == 9 and sheet.labels[1] == "ax"
    assert np.isnan(sheet.numbers(4)[:2]).all() and sheet.numbers(4)[2] == 4


@pytest.mark.parametrize("text", ["", "hello\nworld\n", "a,b,c\n", "x" * 400_000, "\x1b[31mred\n" * 5])
def test_what_is_no_table_is_one_short_sentence(tmp_path: Path, text: str):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(RecordingError) as error:
        read_table(path)
    assert str(path) in str(error.value) and len(str(error.value)) < 400 + len(str(path))
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    "cells, seconds",
    [
        (["1970-01-01 00:12:50.360704"], 770.360704),
        (["2021-08-20T20:21:13.835Z"], 1629490873.835),
        (["2021-08-20T20:21:13.835+0800"], 1629490873.835 - 8 * 3600),
        (["2021-08-20_20:21:13_835 GMT+8"], 1629490873.835 - 8 * 3600),
        (["20.08.2021 20:21:13,835"], 1629490873.835),
        (["8/20/2021 8:21:13.835 PM"], 1629490873.835),
        (["20/08/2021 20:21:13.835"], 1629490873.835),
        (["20:21.5"], 1221.5),
        (["20:21:13.835"], 73273.835),
        (["2021-08-20 20:21"], 1629490860.0),
        (["8/20/2021 8:21:13.835 pM"], 1629490873.835),
        *(
            ([cell], np.nan)
            for cell in ("20:21", "2021-08-20 20:61:13", "2021-08-20 20:21:60", "2021-02-30 1:02:03")
        ),
    ],
)
def test_dates(cells: list[str], seconds: float):
    assert seconds_of_dates(cells)[0] == pytest.approx(seconds, abs=1e-6, nan_ok=True)


def test_dates_of_which_too_many_are_none_and_times_past_midnight():
    dates = [f"2026-03-12 09:30:{k:02d}" if k % 5 else "soon" for k in range(1, 50)]
    with pytest.raises(RecordingError, match="line 6: 'soon' in column when is not a time"):
        read("\n".join(["when,x", *(f"{date},1" for date in dates), ""])).times(0)
    assert np.allclose(seconds_of_dates(["23:59:59.5", "00:00:00.5", "00:00:01.5"]), 86399.5 + np.arange(3))
    assert np.allclose(seconds_of_dates(["59:59.5", "00:00.5", "00:01.5"]), 3599.5 + np.arange(3))
    first_of_month = seconds_of_dates(["03/12/2021 10:00:00", "13/12/2021 10:00:00"])
    assert np.ptp(first_of_month) == 10 * 86_400  # one of them has no 13th month


def test_units():
    assert split_unit("accelerometerAccelerationX(G)") == ("accelerometerAccelerationX", "G")
    assert split_unit("Acc [m/(s^2)]") == ("Acc", "m/(s^2)")
    assert ACCELERATION[plain_unit("[g]")] == 9.80665
    assert ANGULAR_VELOCITY[plain_unit("°/s")] == pytest.approx(np.pi / 180)
    assert ANGULAR_VELOCITY[plain_unit("(rad/sec)")] == 1


@pytest.mark.parametrize("minus", ["\u2212", "\u2013", "\u2012"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_typographic_minus_signs(tmp_path: Path, minus: str, encoding: str):
    """Word processors and German locales write them; no sign may be lost, and no name changed."""
    if encoding == "cp1252" and minus != "\u2013":
        pytest.skip("it has this dash only")
    path = tmp_path / "a.csv"
    lines = ["t;gain 2\u20133;b", *(f"{k};{minus}{k},5;{minus}1e{minus}2" for k in range(1, 60)), ""]
    path.write_bytes("\n".join(lines).encode(encoding))
    sheet = read_table(path)
    assert not sheet.notes and sheet.names[1] == "gain 2\u20133"
    assert (sheet.numbers(1) == -np.arange(1, 60) - 0.5).all() and (sheet.numbers(2) == -0.01).all()
    plain = tmp_path / "plain.csv"
    plain.write_text(f"t_s,ax\n0,{minus}1.5\n1,2\n", encoding="utf-8")
    table, _ = read_strict(plain, ("t_s", "ax"))
    assert table["ax"].tolist() == [-1.5, 2.0]


@pytest.mark.parametrize(("wrong", "refused"), [(5, False), (6, True)])
def test_more_than_a_twentieth_of_no_numbers_is_refused(tmp_path: Path, wrong: int, refused: bool):
    path = tmp_path / "a.csv"
    path.write_text(
        "\n".join(["t,x", *(f"{k},{'#WERT!' if 3 <= k < 3 + wrong else k}" for k in range(100)), ""])
    )
    sheet = read_table(path)
    if refused:
        with pytest.raises(RecordingError, match=r"line 5: '#WERT!' in column x .* 6 of its 100 cells"):
            sheet.numbers(1)
    else:
        assert np.isnan(sheet.numbers(1)).sum() == wrong and "#WERT!" in sheet.notes[0]


def test_dates_in_cells(tmp_path: Path):
    start = datetime(2026, 3, 12, 9, 30)
    rows = [[start + timedelta(milliseconds=10 * k), k, 0.5] for k in range(20)]
    times, dates = read_table(workbook(tmp_path / "a.xlsx", [["Zeit", "x", "y"], *rows])).times(0)
    assert dates and np.allclose(np.diff(times), 0.01, atol=1e-3)


def test_a_damaged_workbook_is_one_sentence(tmp_path: Path):
    made.EXAMPLES["nilspod"](tmp_path / "a.csv")
    path = as_workbook(tmp_path / "a.csv", tmp_path / "a.xlsx")
    raw = path.read_bytes()
    for cut in (200, len(raw) // 2, len(raw) - 10):
        path.write_bytes(raw[:cut])
        with pytest.raises(RecordingError, match=r"cannot be read|is an archive"):
            read_table(path)
        assert recognise(read_head(path)) is None
