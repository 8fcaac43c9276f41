"""The commands at work: simulate, info, smooth, validate, export, gaps, import, demo; files that were cut."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest
from commands import done

from smoother.io import read_recording

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """A folder with a simulated recording, its calibration, and what `smooth` makes of them."""
    folder = tmp_path_factory.mktemp("session")
    done(
        *("simulate", "arm", "--set", "repetitions=1", "--seed", "5", "--set", "imu_rate_hz=100"),
        *("-o", folder / "rec.mcap", "--calibration-out", folder / "cal.toml"),
    )
    done(
        *("smooth", folder / "rec.mcap", "-o", folder / "out.mcap", "--calibration", folder / "cal.toml"),
        *("--processes", 1, "--draws", 0),
    )
    return folder


def test_info_of_what_cannot_be_recovered(tmp_path, capsys):
    from mcap.writer import Writer

    with open(tmp_path / "empty.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel(
            "/chat", "json", writer.register_schema("text", "jsonschema", b"{}")
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    done("info", tmp_path / "empty.mcap")
    assert "cannot be recovered: " in capsys.readouterr().out


@pytest.mark.slow
def test_uncertain_answers_are_marked(session, tmp_path, capsys):
    done(
        *("smooth", session / "rec.mcap", "-o", tmp_path / "o.mcap", "--calibration", session / "cal.toml"),
        *("--max-sigma-m", 0.004, "--json", tmp_path / "s.json", "--draws", 0),
    )
    figures = json.loads((tmp_path / "s.json").read_text())
    assert figures["answered"] == figures["samples"]  # marked, not taken away
    assert 0 < figures["usable"] < figures["samples"]
    unsure = figures["samples"] - figures["usable"]
    assert (
        f"{unsure} of {figures['samples']} samples are less certain than 0.004 m" in capsys.readouterr().out
    )
    done("export", tmp_path / "o.mcap", "--format", "csv", "-o", tmp_path / "o.csv")
    with open(tmp_path / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["usable"] == "0" for row in rows) == unsure
    for row in rows:
        assert row["imu_x"]
        assert (max(float(row[f"sigma_{axis}"]) for axis in "xyz") <= 0.004) == (row["usable"] == "1")


def test_validate_with_poses_in_a_table(session, tmp_path):
    known = read_recording(session / "rec.mcap").truth
    truth = tmp_path / "truth.csv"
    rows = zip(known.t_s, known.position, known.quaternion, strict=True)
    lines = [",".join(f"{value:.9f}" for value in (t, *p, *q)) for t, p, q in rows]
    truth.write_text("\n".join(["t_s,x,y,z,qw,qx,qy,qz", *lines]))
    done("validate", session / "out.mcap", "--truth", truth, "--json", tmp_path / "v.json")
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["alignment"] == "none"
    assert figures["occluded"]["position_rms_m"] < 0.05
    assert figures["visible"]["orientation_rms_deg"] < 5


@pytest.mark.slow
def test_demo_as_a_user_runs_it(tmp_path, monkeypatch):
    command = [sys.executable, "-c", "from smoother.cli import main; main()", "demo", "--json", "d.json"]
    finished = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert finished.returncode == 0, finished.stderr
    assert f"recording: {DATA / 'demo.mcap'}" in finished.stdout
    report = Path(finished.stdout.strip().splitlines()[-1].removeprefix("report: "))
    assert report == (tmp_path / "out/demo/demo_report.html").resolve()
    assert report.stat().st_size > 10_000
    figures = json.loads((tmp_path / "d.json").read_text())
    assert figures["validation"]["occluded"]["position_rms_m"] < 0.04
    # a second time, over what the first one left; no figure holds a place of this machine
    report.unlink()
    monkeypatch.setattr("smoother.result.draws.USUAL_DRAWS", 0)
    done("demo", "-o", tmp_path / "out/demo", "--json", tmp_path / "again.json")
    assert report.is_file()
    text = (tmp_path / "again.json").read_text()
    assert json.loads(text)["report"] == "demo_report.html"
    assert str(tmp_path) not in text and str(DATA.parent) not in text
