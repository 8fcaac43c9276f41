"""The commands at work: simulate, info, smooth, validate, export, gaps, import, demo."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from smoother.cli.run import run

DATA = Path(__file__).parents[2] / "data"


def done(arguments: list[object], *more: object) -> None:
    assert run([str(argument) for argument in (*arguments, *more)]) == 0


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """A folder with a simulated recording, its calibration, and what `smooth` makes of them."""
    folder = tmp_path_factory.mktemp("session")
    done(
        ["simulate", "arm", "--repetitions", "1", "--seed", "5", "--imu-rate-hz", "100"],
        *("-o", folder / "rec.mcap", "--calibration-out", folder / "cal.toml", "--json", folder / "sim.json"),
    )
    done(
        ["smooth", folder / "rec.mcap", "-o", folder / "out.mcap", "--calibration", folder / "cal.toml"],
        *("--report", folder / "out.html", "--json", folder / "smooth.json", "--processes", 1, "--draws", 0),
    )
    return folder


def test_simulate(session):
    figures = json.loads((session / "sim.json").read_text())
    assert figures["config"]["imu_rate_hz"] == 100
    assert figures["seed"] == 5
    assert "clock_offset_s" in figures["parameters"]


def test_same_seed_same_file(session, tmp_path):
    done(
        [
            "simulate",
            "arm",
            "-o",
            tmp_path / "again.mcap",
            "--repetitions",
            1,
            "--seed",
            5,
            "--imu-rate-hz",
            100,
        ]
    )
    assert (tmp_path / "again.mcap").read_bytes() == (session / "rec.mcap").read_bytes()


def test_info(session, tmp_path, capsys):
    done(["info", session / "rec.mcap", "--json", tmp_path / "i.json"])
    assert "/skeleton" in capsys.readouterr().out
    figures = json.loads((tmp_path / "i.json").read_text())
    assert figures["imu_rate_hz"] == pytest.approx(100, abs=1)
    assert figures["gaps"] >= 1
    assert {topic["name"] for topic in figures["topics"]} >= {"/skeleton"}


def test_info_says_first_what_counts(session, capsys):
    done(["info", session / "rec.mcap"])
    said = capsys.readouterr().out.rstrip().splitlines()[-2:]
    assert said[0] == "ready for `unocclude smooth`"
    assert said[1].startswith("not in the file, not needed to recover: magnetometer (")
    done(["info", session / "out.mcap"])
    assert "contains a result: use validate or export" in capsys.readouterr().out


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
    done(["info", tmp_path / "empty.mcap"])
    assert "cannot be recovered: " in capsys.readouterr().out


def test_smooth(session):
    figures = json.loads((session / "smooth.json").read_text())
    assert figures["method"] == "graph"
    assert figures["answered"] > 0.9 * figures["samples"]
    assert figures["gaps"]
    assert {"start_s", "length_s", "sigma_max_m"} <= set(figures["gaps"][0])
    assert "processes" not in figures["config"]["windows"]  # the answer is the same on any number
    page = (session / "out.html").read_text(encoding="utf-8")
    assert "Recovered arm motion" in page


def test_smooth_again_needs_force(session, capsys):
    before = (session / "out.mcap").read_bytes()
    assert run(["smooth", str(session / "rec.mcap"), "-o", str(session / "out.mcap")]) == 1
    assert "--force" in capsys.readouterr().err
    assert (session / "out.mcap").read_bytes() == before


def test_uncertain_answers_are_marked(session, tmp_path, capsys):
    done(
        ["smooth", session / "rec.mcap", "-o", tmp_path / "o.mcap", "--calibration", session / "cal.toml"],
        *("--max-sigma-m", 0.004, "--json", tmp_path / "s.json", "--draws", 0),
    )
    figures = json.loads((tmp_path / "s.json").read_text())
    assert figures["answered"] == figures["samples"]  # marked, not taken away
    assert 0 < figures["usable"] < figures["samples"]
    unsure = figures["samples"] - figures["usable"]
    assert (
        f"{unsure} of {figures['samples']} samples are less certain than 0.004 m" in capsys.readouterr().out
    )
    done(["export", tmp_path / "o.mcap", "--format", "csv", "-o", tmp_path / "o.csv"])
    with open(tmp_path / "o.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert sum(row["usable"] == "0" for row in rows) == unsure
    for row in rows:
        assert row["imu_x"]
        assert (max(float(row[f"sigma_{axis}"]) for axis in "xyz") <= 0.004) == (row["usable"] == "1")


@pytest.mark.parametrize("source", ["mcap", "csv"])
def test_validate(session, tmp_path, capsys, source):
    truth = session / "rec.mcap"
    if source == "csv":
        from smoother.io import read_recording

        known = read_recording(truth).truth
        truth = tmp_path / "truth.csv"
        rows = zip(known.t_s, known.position, known.quaternion, strict=True)
        lines = [",".join(f"{value:.9f}" for value in (t, *p, *q)) for t, p, q in rows]
        truth.write_text("\n".join(["t_s,x,y,z,qw,qx,qy,qz", *lines]))
    done(["validate", session / "out.mcap", "--truth", truth, "--json", tmp_path / "v.json"])
    assert "occluded" in capsys.readouterr().out
    figures = json.loads((tmp_path / "v.json").read_text())
    assert figures["alignment"] == "none"
    for part in (figures[name] for name in ("all", "occluded", "visible")):
        keys = {
            "position_rms_m",
            "position_max_m",
            "orientation_rms_deg",
            "orientation_max_deg",
            "nees",
            "samples",
        }
        assert keys <= set(part)
    assert figures["occluded"]["position_rms_m"] < 0.05
    assert figures["visible"]["orientation_rms_deg"] < 5


def test_validate_against_another_time(session, tmp_path, capsys):
    truth = tmp_path / "late.csv"
    truth.write_text("t_s,x,y,z\n1000.00,0,0,2\n1000.05,0,0,2\n")
    assert run(["validate", str(session / "out.mcap"), "--truth", str(truth)]) == 1
    assert "do not overlap in time" in capsys.readouterr().err


def test_export_csv(session, tmp_path):
    done(
        [
            "export",
            session / "out.mcap",
            "--format",
            "csv",
            "-o",
            tmp_path / "o.csv",
            "--json",
            tmp_path / "e.json",
        ]
    )
    with open(tmp_path / "o.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert ",".join(rows[0]).startswith(
        "t_s,occluded,imu_x,imu_y,imu_z,imu_qw,imu_qx,imu_qy,imu_qz,elbow_x,elbow_y,elbow_z,wrist_x,wrist_y,wrist_z,shoulder_x,shoulder_y,shoulder_z,sigma_x,sigma_y,sigma_z,sigma_deg"
    )
    figures = json.loads((tmp_path / "e.json").read_text())
    assert figures["files"][0]["rows"] == len(rows) - 1


def test_gaps(session, tmp_path, capsys):
    arguments = ["gaps", session / "rec.mcap", "--calibration", session / "cal.toml", "--lengths", "0.5,1"]
    arguments += ["--seed", 2, "--gaps-per-run", 2, "--json", tmp_path / "g.json"]
    done(arguments)
    assert "Error in hidden gaps against the truth" in capsys.readouterr().out
    figures = json.loads((tmp_path / "g.json").read_text())
    assert [entry["length_s"] for entry in figures["lengths"]] == [0.5, 1.0]
    graph = figures["lengths"][0]["methods"]["graph"]
    assert {"rms_m", "median_m", "p95_m", "max_m", "nees", "gaps", "samples"} <= set(graph)
    assert 0 < graph["rms_m"] < 0.05


def test_import_csv(tmp_path, capsys):
    folder = tmp_path / "plain"
    folder.mkdir()
    (folder / "recording.toml").write_text(
        '[camera]\nframe = "kinect"\nskeleton = "s.csv"\n[imu.forearm_right]\nfile = "i.csv"\n'
    )
    frames = [f"{k / 30:.4f},wrist_right,0,{k / 300:.4f},2,tracked" for k in range(60)]
    frames += [f"{k / 30:.4f},elbow_right,0,{k / 300 - 0.2:.4f},2,tracked" for k in range(60)]
    (folder / "s.csv").write_text("\n".join(["t_s,joint,x,y,z,state", *frames]))
    samples = [f"{k / 50:.4f},0,9.81,0,0,0,0" for k in range(100)]
    (folder / "i.csv").write_text("\n".join(["t_s,ax,ay,az,gx,gy,gz", *samples]))
    done(["import", "csv", folder, "-o", tmp_path / "r.mcap", "--json", tmp_path / "r.json"])
    assert "/imu/forearm_right" in capsys.readouterr().out
    assert json.loads((tmp_path / "r.json").read_text())["side"] == "right"
    (folder / "i.csv").write_text("t_s,ax\n0,1\n")
    assert run(["import", "csv", str(folder), "-o", str(tmp_path / "q.mcap")]) == 1
    assert not (tmp_path / "q.mcap").exists()


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
    monkeypatch.setattr("smoother.cli.methods.usual_draws", lambda _: 0)
    done(["demo", "-o", tmp_path / "out/demo", "--json", tmp_path / "again.json"])
    assert report.is_file()
    text = (tmp_path / "again.json").read_text()
    assert json.loads(text)["report"] == "demo_report.html"
    assert str(tmp_path) not in text and str(DATA.parent) not in text
