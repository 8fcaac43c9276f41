"""`unocclude measures`: tables, files, and what people get wrong."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_arms import simulated, with_draws

import unocclude
from smoother.cli.run import run
from smoother.io import read_recovery, write_recovery
from smoother.recording import Recording
from smoother.result import Estimates
from smoother.simulation import ArmSimulation, simulate_arm, simulate_both_arms
from smoother.smoothing import smooth


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both arms of a person, recovered for some seconds, with draws; and the recording's file."""
    place = tmp_path_factory.mktemp("measures")
    config = ArmSimulation.preset("white", protocol="random", duration_s=8.0, occlusion_lengths_s=(0.8,))
    recordings: list[Recording] = [arm.recording for arm in simulate_both_arms(config, 3)]
    unocclude.write_recording(recordings, place / "both.mcap")
    recoveries = [smooth(replace(one, truth=None), processes=1, draws=20) for one in recordings]
    recoveries[0] = replace(recoveries[0], calibration=replace(recoveries[0].calibration, R_F_A=np.eye(3)))
    write_recovery(recoveries, place / "out.mcap", source=place / "both.mcap")
    return place


def sentence(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int) -> str:
    capsys.readouterr()
    assert run(arguments) == code
    said = capsys.readouterr().err.strip()
    assert said and "Traceback" not in said
    return said


def test_everything_is_written_and_printed(folder: Path, capsys: pytest.CaptureFixture[str]):
    files = [str(folder / name) for name in ("m.csv", "m.json", "m.html")]
    arguments = ["measures", str(folder / "out.mcap"), "--csv", files[0], "--json", files[1]]
    assert run([*arguments, "--report", files[2]]) == 0
    said = capsys.readouterr().out
    assert "elbow flexion, range" in said and "Movements of the hand" in said and "--- left arm ---" in said
    assert "not measured: forearm pronation. How the IMU is turned" in said
    assert "Right arm against left" in said
    figures = json.loads((folder / "m.json").read_text())
    arms = {arm["side"]: arm for arm in figures["arms"]}
    assert arms.keys() == {"left", "right"}
    row = arms["right"]["measures"]["elbow_flexion_range_deg"]
    assert row["low"] < row["value"] < row["high"] and row["unit"] == "deg"
    assert 0.0 <= row["recovered_share"] <= 1.0
    assert "hand_path_length_m_symmetry_percent" in figures["symmetry"][0]["measures"]
    with open(folder / "m.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {one["side"] for one in rows} == {"left", "right", "both"}
    assert {one["scope"] for one in rows} >= {"session", "movement"}
    mine = [one for one in rows if (one["side"], one["key"], one["scope"]) == ("right", "sparc", "session")]
    assert float(mine[0]["value"]) == pytest.approx(arms["right"]["measures"]["sparc"]["value"], abs=1e-6)
    assert "<html" in (folder / "m.html").read_text()[:200]
    assert sentence(capsys, [*arguments], 1).count("exists already") == 1  # nothing is overwritten unasked


def test_the_same_from_python(folder: Path):
    rows = unocclude.measures(folder / "out.mcap", side="right")
    direct = unocclude.measure(next(one for one in read_recovery(folder / "out.mcap") if one.side == "right"))
    assert rows.by_key["sparc"] == direct.by_key["sparc"] and rows.n_draws == 20
    with pytest.raises(unocclude.UnoccludeError, match="several arms fit; name one by side and body"):
        unocclude.measures(folder / "out.mcap")
    with pytest.raises(unocclude.UnoccludeError, match="no arm fits"):
        unocclude.measures(folder / "out.mcap", side="right", body=4)


def test_settings_are_read_and_checked(folder: Path, capsys: pytest.CaptureFixture[str]):
    settings, out = folder / "s.toml", folder / "s.json"
    settings.write_text("[movements]\nstart_m_s = 50.0\n")
    base = ["measures", str(folder / "out.mcap"), "--side", "left", "--config", str(settings)]
    assert run([*base, "--json", str(out)]) == 0
    assert json.loads(out.read_text())["movements"] == []
    for text, words in (
        ("[movement]\nstart_m_s = 1\n", "there is no setting 'movement'"),
        ("[smoothing]\ncutoff_hz = -6\n", "smoothing.cutoff_hz"),
        ("[smoothing\n", "not a TOML file"),
    ):
        settings.write_text(text)
        said = sentence(capsys, base, 1)
        assert str(settings) in said and words in said


def test_wrong_files_and_options(folder: Path, capsys: pytest.CaptureFixture[str]):
    out = str(folder / "out.mcap")
    assert "no recovered arm for --body 7" in sentence(capsys, ["measures", out, "--body", "7"], 1)
    assert "smooth" in sentence(capsys, ["measures", str(folder / "both.mcap")], 1)  # not recovered yet
    assert "none.mcap" in sentence(capsys, ["measures", str(folder / "none.mcap")], 1)
    assert "page" in sentence(capsys, ["measures", out, "--report", str(folder / "m.pdf")], 2)
    assert "read by this command" in sentence(capsys, ["measures", out, "--csv", out, "--force"], 1)
    assert read_recovery(out)  # it is still there
    assert "--side is left or right" in sentence(capsys, ["measures", out, "--side", "up"], 2)


def test_what_is_not_to_be_trusted_is_said_first(capsys: pytest.CaptureFixture[str]):
    from smoother.cli.measures import print_arm
    from smoother.measures import measure

    doubtful = Estimates(trusted=False, reasons=("the sides are swapped",), cause="the sides are swapped")
    recovery = with_draws(simulated(0, protocol="random", duration_s=6.0), count=20)
    print_arm(measure(replace(recovery, estimates=doubtful)), [])
    said = capsys.readouterr().out.strip().splitlines()
    assert said[0].startswith("Not to be trusted: the sides are swapped.")
    assert "not to be trusted" in said[0].split(".", 1)[1]


def test_by_default_every_measure_has_its_interval_the_same_in_all_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Terminal, page, JSON and CSV, of a recording that was smoothed without an option."""
    demo, out = tmp_path / "a.mcap", tmp_path / "out.mcap"
    simulation = ArmSimulation.preset("white", protocol="random", duration_s=8.0, occlusion_lengths_s=(0.8,))
    unocclude.write_recording([simulate_arm(simulation, 3).recording], demo)
    usual = ["--processes", "1"]
    assert run(["smooth", str(demo), "-o", str(out), *usual]) == 0
    assert run(["smooth", str(demo), "-o", str(tmp_path / "bare.mcap"), "--draws", "0", *usual]) == 0
    [recovery], [bare] = read_recovery(out), read_recovery(tmp_path / "bare.mcap")
    assert recovery.draws is not None and len(recovery.draws) == 64 and bare.draws is None
    for name in ("position", "quaternion", "velocity", "pose_covariance"):
        np.testing.assert_array_equal(getattr(recovery, name), getattr(bare, name))
    files = [str(tmp_path / name) for name in ("m.csv", "m.json", "m.html")]
    capsys.readouterr()
    assert run(["measures", str(out), "--csv", files[0], "--json", files[1], "--report", files[2]]) == 0
    said = capsys.readouterr().out.splitlines()
    end = next(number for number, line in enumerate(said) if line.startswith("└"))
    rows = [line for line in said[:end] if line.startswith("│")]
    assert len(rows) > 40
    for line in rows:
        value, interval = (cell.strip() for cell in line.split("│")[2:4])
        assert interval != "-" and (" to " in interval or interval == value), line
    stated = json.loads(Path(files[1]).read_text())["measures"]
    flexion = stated["elbow_flexion_range_deg"]
    between = f"{flexion['low']:.1f} to {flexion['high']:.1f}°"
    assert any("elbow flexion, range" in line and between in line for line in rows)
    assert f"({between})" in Path(files[2]).read_text()
    with open(files[0], newline="") as file:
        row = next(row for row in csv.DictReader(file) if row["key"] == "elbow_flexion_range_deg")
    assert float(row["low"]) == pytest.approx(flexion["low"], abs=1e-6)


def test_without_draws_the_tables_have_no_intervals(capsys: pytest.CaptureFixture[str]):
    from smoother.cli.measures import print_arm
    from smoother.measures import measure

    print_arm(measure(simulated(0, protocol="random", duration_s=6.0)), [])
    said = capsys.readouterr().out
    assert "note: There are no intervals: smooth the recording with --draws 64 to have them." in said
    assert " to " not in next(line for line in said.splitlines() if "elbow flexion, range" in line)
