"""`unocclude batch` on this machine: outputs, rows, what is computed again and what is not."""

from __future__ import annotations

import json
import os
import shutil
import socket

import duckdb
import pytest
from studies import BROKEN, NAMES, batch, query, state

from calib.file import CalibrationFile, write_calibration
from smoother import __version__
from smoother.calibration import ArmCalibration, Length
from smoother.cli.run import run
from smoother.study.inputs import file_hash


def test_a_study_and_what_is_done_again(recordings, tmp_path, capsys):
    out = tmp_path / "out"
    again = [recordings, "-o", out, "--processes", 2]
    assert batch(*again, "--report", "--json", tmp_path / "study.json") == 1
    printed = capsys.readouterr()
    assert printed.err == "" and "4 recovered now" in printed.out and BROKEN in printed.out
    figures = json.loads((tmp_path / "study.json").read_text())
    assert (figures["recordings"], figures["done"], figures["failed"]) == (5, 4, 1)
    assert [row["recording"] for row in figures["rows"]] == sorted([*NAMES, BROKEN])
    assert figures["failures"][0]["recording"] == BROKEN
    check_rows(recordings, out, figures["rows"])
    check_page((out / "report.html").read_text(encoding="utf-8"))
    first, rows = state(out), query(out)
    assert set(first) == set(NAMES) and len(rows) == 5
    assert not list((out / ".unocclude").rglob("*.mcap*")), "nothing half-written is left"
    assert not list((out / ".unocclude" / "rows").iterdir())

    # the command `smooth` gives the same bytes, but for the motions that it draws
    one = tmp_path / "one.mcap"
    smooth = ["smooth", str(recordings / NAMES[0]), "-o", str(one), "--processes", "1", "--draws", "0"]
    assert run(smooth) == 0
    assert one.read_bytes() == first[NAMES[0]][1]

    # nothing is computed twice, the failure included
    capsys.readouterr()
    assert batch(*again) == 1
    assert "0 recovered now" in capsys.readouterr().out
    assert state(out) == first and query(out) == rows

    # a recording that was touched is the same by its content; one that was changed, and an output that is
    # gone, are computed again
    os.utime(recordings / NAMES[0], ns=(1, 1))
    (recordings / NAMES[1]).write_bytes((recordings / NAMES[2]).read_bytes())
    (out / NAMES[3]).unlink()
    (recordings / BROKEN).unlink()
    assert batch(*again) == 0
    second = state(out)
    assert {name for name in NAMES if second[name] != first[name]} == {NAMES[1], NAMES[3]}
    assert second[NAMES[3]][1] == first[NAMES[3]][1]
    assert len(query(out)) == 7


def check_rows(recordings, out, rows):
    for row in rows:
        assert row["version"] == __version__ and len(row["config_hash"]) == 64
        assert row["calibration_hash"] == "" and row["seconds"] > 0
        assert row["input_hash"] == file_hash(recordings / row["recording"])
        if row["recording"] == BROKEN:
            assert row["status"] == "failed" and "is not an MCAP file" in row["error"] and not row["retry"]
            continue
        assert row["output_hash"] == file_hash(out / row["output"])
        assert 5.5 < row["duration_s"] < 6.5 and row["gaps"] == 1 and 0.5 < row["occluded_s"] < 1.1
        assert 0.001 < row["sigma_max_m"] < 0.05 and abs(row["clock_offset_s"]) < 0.2
        assert row["notes"] == len(row["note_texts"])
    assert len({row["id"] for row in rows}) == len(rows)


def check_page(page):
    assert all(f'href="{name}"' in page for name in NAMES)
    assert "Recordings</h2>" in page and "is not an MCAP file" in page
    assert "4 of 5 recordings were recovered, 1 failed" in page


def test_other_settings_are_other_results(in_here, made, tmp_path):
    (tmp_path / "list.txt").write_text(f"{made / NAMES[0]}\n")
    (tmp_path / "c.toml").write_text("[windows]\nmargin_s = 1.0\n")
    (tmp_path / "processes.toml").write_text("[windows]\nprocesses = 7\n")
    arm = ArmCalibration(side="right", upper_arm=Length(0.31, 0.01))
    write_calibration(tmp_path / "arm.toml", CalibrationFile({"right": arm}))
    out, source = tmp_path / "out", tmp_path / "list.txt"
    for more, rows in (
        ([], 1),
        (["--config", tmp_path / "processes.toml"], 1),  # says nothing of the result
        (["--config", tmp_path / "c.toml"], 2),
        ([], 3),  # the output is that of the other settings by now
        ([], 3),
        (["--force"], 4),
        (["--calibration", tmp_path / "arm.toml"], 5),
    ):
        assert batch(source, "-o", out, "--processes", 1, *more) == 0
        assert len(query(out)) == rows
    latest = duckdb.sql(
        f"SELECT * FROM '{out}/results/*.parquet' QUALIFY row_number() OVER"
        " (PARTITION BY recording ORDER BY finished DESC) = 1"
    ).fetchall()
    assert len(latest) == 1
    assert len({row[0] for row in query(out, "config_hash")}) == 2
    assert len({row[0] for row in query(out, "calibration_hash")}) == 2


def test_wrong_use(made, tmp_path, capsys):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").touch()
    (tmp_path / "bad.toml").write_text("no calibration")
    for code, said, arguments in (
        (1, "not of a study", [made, "-o", tmp_path / "full"]),
        (1, "bad.toml", [made, "-o", tmp_path / "o", "--calibration", tmp_path / "bad.toml"]),
        (
            1,
            "nowhere: No such file or directory; name a folder",
            [tmp_path / "nowhere", "-o", tmp_path / "o"],
        ),
        (1, "is a file", [made, "-o", tmp_path / "bad.toml"]),
        (1, "no Dask scheduler responds", [made, "-o", tmp_path / "o2", "--scheduler", "nonsense"]),
        (2, "--processes", [made, "-o", tmp_path / "o", "--scheduler", "tcp://h:1", "--processes", 2]),
        (2, "--side", [made, "-o", tmp_path / "o", "--side", "up"]),
    ):
        assert batch(*arguments) == code
        err = capsys.readouterr().err
        assert said in err and err.count("\n") == 1
    assert not (tmp_path / "o").exists()
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.txt"]


def test_a_page_that_somebody_else_wrote_is_kept(in_here, recordings, tmp_path, capsys):
    for name in (*NAMES[1:], BROKEN):
        (recordings / name).unlink()
    page, figures = tmp_path / "mine.html", tmp_path / "mine.json"
    words = [recordings, "-o", tmp_path / "out", "--processes", 1, "--report", page, "--json", figures]
    for mine in (page, figures):
        mine.write_text("mine")
        assert batch(*words) == 1
        assert f"{mine} exists already" in capsys.readouterr().err and mine.read_text() == "mine"
        mine.unlink()
    assert batch(*words) == 0
    assert batch(*words) == 0, "what the study wrote itself is renewed"
    assert json.loads(figures.read_text())["done_before"] == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_what_is_no_file_stops_no_other(in_here, recordings, tmp_path, capsys):
    """With a page or figures to write, a pipe called x.mcap stopped the whole study."""
    folder = tmp_path / "study"
    folder.mkdir()
    shutil.copy(recordings / NAMES[0], folder / "a.mcap")
    shutil.copy(recordings / NAMES[0], folder / ".b.mcap")
    os.mkfifo(folder / "pipe.mcap")
    (folder / "device.mcap").symlink_to(os.devnull)
    (folder / "gone.mcap").symlink_to("nowhere")
    (folder / "loop.mcap").symlink_to("loop.mcap")
    (folder / "folder.mcap").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(folder / "socket.mcap"))
    figures = tmp_path / "study.json"
    again = ["-o", tmp_path / "out", "--processes", 1, "--report", "--json", figures]
    assert batch(f"{folder}/*.mcap", *again) == 1
    printed = capsys.readouterr()
    assert printed.err == "" and ".b.mcap" in printed.out
    rows = {row["recording"]: row for row in json.loads(figures.read_text())["rows"]}
    assert rows.pop("a.mcap")["status"] == "done"
    said = {
        "pipe.mcap": "is a pipe",
        "device.mcap": "a device",
        "socket.mcap": "a socket",
        "gone.mcap": "is a link to nowhere, which does not exist",
        "loop.mcap": "a link leads back to itself",
        "folder.mcap": "is a folder",
    }
    assert set(rows) == set(said)
    assert all(words in rows[name]["error"] for name, words in said.items())
