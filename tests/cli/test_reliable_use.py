"""What a shell does to a command: readers that go, signals while it loads, cells a spreadsheet runs."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from results import made

from smoother import Recording, UnoccludeError, validate, write_recovery
from smoother.cli.run import run
from smoother.recording import Truth
from smoother.runtime.outputs import csv_rows

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"
MAIN = "from smoother.cli import main; main()"


@pytest.mark.parametrize("redirect", ["", "2>&1"])
def test_a_result_is_written_though_the_reader_goes(tmp_path: Path, redirect: str) -> None:
    out = tmp_path / "out.mcap"
    words = f"smooth {DEMO} -o {out} --draws 0 {redirect}"
    command = f"set -o pipefail; {sys.executable} -c '{MAIN}' {words} | head -n 1"
    ended = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0 and out.stat().st_size > 100_000, ended.stderr
    assert "Traceback" not in ended.stderr and "Exception" not in ended.stderr


def test_a_module_that_is_interrupted_while_it_loads(monkeypatch, capsys) -> None:
    def load(*_: object, **__: object) -> int:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr("smoother.cli.app.app", load)
    assert run(["config"]) == 1
    assert "interrupted" in capsys.readouterr().err


def test_no_cell_is_a_formula(tmp_path: Path) -> None:
    evil = ["=HYPERLINK(1)", "+1+2", "-2+3", "@SUM(1)", "\tx", "\r=1"]
    harmless = ["-0.5", "+1e-3", "a=b", 3, None]
    with csv_rows(tmp_path / "a.csv") as write:
        write([*evil, *harmless])
    with open(tmp_path / "a.csv", newline="") as file:
        [row] = csv.reader(file)
    assert row[: len(evil)] == ["'" + cell.strip() if cell.strip()[0] in "=+-@" else "x" for cell in evil]
    assert row[len(evil) :] == ["-0.5", "+1e-3", "a=b", "3", ""]


def test_a_file_name_is_no_formula_in_measures(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_recovery(made(), "=cmd.mcap")
    done("measures", os.path.join(".", "=cmd.mcap"), "--csv", "m.csv")
    with open("m.csv", newline="") as file:
        assert not [cell for row in csv.reader(file) for cell in row if cell.startswith("=")]


def test_a_misspelt_place_of_an_imu(tmp_path: Path, capsys) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).touch()
    words = ("import", "files", "--skeleton", tmp_path / "a.csv", "-o", tmp_path / "o.mcap")
    assert "forearm_right" in refused(capsys, *words, "--imu", f"forearm_rigth={tmp_path / 'b.csv'}")
    assert "do you mean" not in refused(capsys, *words, "--imu", f"forearm_right_2={tmp_path / 'b.csv'}")


def test_what_python_says_is_pythons(tmp_path: Path) -> None:
    (tmp_path / "a.csv").touch()
    with pytest.raises(UnoccludeError, match="force=True"):
        made().export(tmp_path / "a.csv")
    t = np.arange(60) / 30.0
    mm = np.tile([100.0, 200.0, 2100.0], (60, 1))
    with pytest.raises(UnoccludeError, match="positions are in metres"):
        Recording.from_arrays(t, np.ones((60, 3)), np.ones((60, 3)), t, {"wrist": mm, "elbow": mm})


def test_a_result_is_no_truth_of_itself() -> None:
    one = made()
    itself = Truth(one.t_s, one.position, one.quaternion, np.ones(len(one), bool))
    assert any("result itself" in note for note in validate(one, itself).notes)
