"""The byte reference: masks, texts of files, a few commands run twice, and a change that is reported."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from smoother import __version__
from tools.faults.cases import Case
from tools.reference import __main__ as program
from tools.reference import inputs, running
from tools.reference.cases import GROUPS
from tools.reference.comparison import first_difference
from tools.reference.renderings import LONG_LINE, broken_lines, masked, rendering
from tools.reference.running import Group

SMALL = (
    Group(
        "small",
        "simulate arm -o a.mcap --protocol random --duration-s 4 --seed 1\n"
        "info a.mcap --json info.json\n"
        "info none.mcap\n",
    ),
    Group("settings", "config --json config.json"),
)


def test_masks(tmp_path: Path):
    rows = "rows-1795420283402529695-04b04ee2.parquet"
    text = f'{tmp_path}/a.mcap by unocclude {__version__}, "load": 0.67, {rows}'
    assert masked(text, tmp_path) == ('FOLDER/a.mcap by unocclude VERSION, "load": LOAD, rows-MOMENT.parquet')
    status = "     8.1 s  visible; IMU 80.0 /s, delay 0 ms; step 19.9 ms; load 65 %\nwritten: l.mcap\n"
    assert masked(status) == "written: l.mcap\n"
    kept = '"sigma_m": 0.65954, "duration_s": 14.9875, at 8.1 s'
    assert masked(kept) == kept


def test_long_lines_are_broken_without_loss():
    line = ",".join(["1.5"] * LONG_LINE)
    assert broken_lines(line).replace("\n", "") == line and broken_lines(line).count("\n") > 100
    assert broken_lines("a,b\r\n") == "a,b\\r\n"


def test_dates_of_a_zip_do_not_count(tmp_path: Path):
    texts = []
    for year in (2001, 2020):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.writestr(zipfile.ZipInfo("b.txt", (year, 1, 1, 0, 0, 0)), "words\n")
        texts.append(rendering(tmp_path / "a.zip", tmp_path))
    assert texts[0] == texts[1] and "words" in texts[0]


def test_a_column_that_differs_is_named(tmp_path: Path):
    import pyarrow
    from pyarrow import parquet

    texts = []
    for value in (1.0, 2.0):
        columns = {"t_s": [0.0, 1.0], "x_m": [0.0, value], "finished": [str(value), ""]}
        parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
        texts.append(rendering(tmp_path / "a.parquet", tmp_path))
    changed = [line for line in first_difference(*texts, 9) if line.startswith(("+", "-"))]
    assert len(changed) == 2 and all("column x_m double" in line for line in changed)


def test_names_are_no_two_groups_names():
    names = [group.name for group in GROUPS]
    assert len(set(names)) == len(names) and not any(":" in name for name in names)
    lines = [f"{group.name}: {line}" for group in GROUPS for line in group.commands]
    assert len(set(lines)) == len(lines)


def test_damaged_files_stay_chosen():
    cases = [
        Case(f"family {number % 4}", "fault", str(number), "", "", (), lambda folder: None)
        for number in range(1000)
    ]
    some, all_of_them = inputs.chosen(cases[:900]), inputs.chosen(cases)
    assert 60 <= len(all_of_them) <= 68
    names = {case.name for case in all_of_them}
    assert sum(case.name in names for case in some) > 0.8 * len(some)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="cases run in forked processes")
def test_a_change_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    for name, value in running.ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(running, "_PRELOADED", ())
    monkeypatch.setattr(program, "GROUPS", SMALL)
    file = str(tmp_path / "reference.zip")
    assert program.main(["write", file, "--processes", "1"]) == 0
    assert program.main(["compare", file, "--processes", "2"]) == 0
    printed = capsys.readouterr().out
    assert "4 cases" in printed and "differs:" not in printed

    real = running.run

    def other(words: Sequence[str]) -> int:
        return real(["2" if word == "1" else word for word in words])

    monkeypatch.setattr(running, "run", other)
    assert program.main(["compare", file, "--only", "small", "--processes", "1"]) == 1
    printed = capsys.readouterr().out
    assert "differs: small: simulate arm" in printed and "| a.mcap" in printed
    assert "+/imu/" in printed or "+chunk" in printed
    assert "settings" not in printed
