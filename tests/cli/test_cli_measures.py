"""`measures` and `progress`: tables, files, and what people get wrong."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from made_measures import made_measures, study_row, write_study
from measured_arms import simulated, with_draws

import smoother
from smoother.io import read_recovery, write_recovery
from smoother.recording import Recording
from smoother.result import Estimates
from smoother.simulation import ArmSimulation, simulate_both_arms
from smoother.smoothing import smooth


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both arms of a person, recovered for some seconds, with draws; and the recording's file."""
    place = tmp_path_factory.mktemp("measures")
    config = ArmSimulation.preset("white", protocol="random", duration_s=8.0, occlusion_lengths_s=(0.8,))
    recordings: list[Recording] = [arm.recording for arm in simulate_both_arms(config, 3)]
    smoother.write_recording(recordings, place / "both.mcap")
    recoveries = [smooth(replace(one, truth=None), processes=1, draws=20) for one in recordings]
    recoveries[0] = replace(recoveries[0], calibration=replace(recoveries[0].calibration, R_F_A=np.eye(3)))
    write_recovery(recoveries, place / "out.mcap", source=place / "both.mcap")
    return place


@pytest.mark.slow
def test_the_same_from_python(folder: Path):
    rows = smoother.measure(folder / "out.mcap", side="right")
    direct = smoother.measure(next(one for one in read_recovery(folder / "out.mcap") if one.side == "right"))
    assert rows.by_key["sparc"] == direct.by_key["sparc"] and rows.n_draws == 20
    with pytest.raises(smoother.UnoccludeError, match="several arms fit; name one by side and body"):
        smoother.measure(folder / "out.mcap")
    with pytest.raises(smoother.UnoccludeError, match="no arm fits"):
        smoother.measure(folder / "out.mcap", side="right", body=4)


@pytest.mark.slow
def test_settings_are_read_and_checked(folder: Path, capsys: pytest.CaptureFixture[str]):
    settings, out = folder / "s.toml", folder / "s.json"
    settings.write_text("[movements]\nstart_m_s = 50.0\n")
    base = ["measures", str(folder / "out.mcap"), "--side", "left", "--config", str(settings)]
    done(*base, "--json", out)
    assert json.loads(out.read_text())["movements"] == []
    for text, words in (
        ("[movement]\nstart_m_s = 1\n", "there is no setting 'movement'"),
        ("[smoothing]\ncutoff_hz = -6\n", "smoothing.cutoff_hz"),
        ("[smoothing\n", "not a TOML file"),
    ):
        settings.write_text(text)
        said = refused(capsys, *base)
        assert str(settings) in said and words in said


def test_what_is_not_to_be_trusted_is_said_first(capsys: pytest.CaptureFixture[str]):
    from smoother.cli.evaluation import print_arm
    from smoother.measures import measure

    doubtful = Estimates(trusted=False, reasons=("the sides are swapped",), cause="the sides are swapped")
    recovery = with_draws(simulated(0, protocol="random", duration_s=6.0), count=20)
    print_arm(measure(replace(recovery, estimates=doubtful)), [])
    said = capsys.readouterr().out.strip().splitlines()
    assert said[0].startswith("Not to be trusted: the sides are swapped.")
    assert "not to be trusted" in said[0].split(".", 1)[1]


FLEXION = "elbow_flexion_range_deg"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two persons with three sessions; the elbow of the first bends more each time."""
    rng = np.random.default_rng(3)
    rows = [
        study_row(
            f"{person}/s{n}.mcap",
            [made_measures(rng=rng, movements=0, change={FLEXION: gain * n})],
            recorded_day=50.0 + 7 * n,
        )
        for person, gain in (("p1", 15.0), ("=p2", 0.0))
        for n in range(3)
    ]
    return write_study(tmp_path_factory.mktemp("study") / "out", rows)


def test_what_changed_is_printed_and_written(study: Path, tmp_path: Path, capsys: Capture):
    done(
        *("progress", study, "--person", "p1", "--json", tmp_path / "p.json", "--csv", tmp_path / "p.csv"),
        *("--report", tmp_path / "p.html"),
    )
    printed = capsys.readouterr().out
    assert "clearly more" in printed and "no clear change" in printed
    assert "would be called clear by chance" in printed and "This is not a diagnosis" in printed
    (person,) = json.loads((tmp_path / "p.json").read_text())["persons"]
    assert person["days"] == [0, 7, 14] and person["clear"] >= 1
    flexion = next(each for each in person["measures"] if each["key"] == FLEXION)
    first, last = flexion["changes"]
    assert (first["to"], last["to"]) == ("s1", "s2") and last["word"] == "clearly more"
    assert last["low"] < last["difference"] < last["high"] and last["mdc95"] is None
    with open(tmp_path / "p.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["key"] == FLEXION]
    assert [row["session"] for row in rows] == ["s0", "s1", "s2"]
    assert rows[0]["change"] == "" and float(rows[2]["change"]) == pytest.approx(last["difference"], rel=1e-5)
    assert "p1" in (tmp_path / "p.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six persons with two sessions."""
    rng = np.random.default_rng(4)
    rows = [
        study_row(
            f"p{person}/s{session}.mcap",
            [made_measures(rng=rng, movements=0, change={FLEXION: 3.0 * person})],
        )
        | {"recorded_day": 7.0 * session}
        for person in range(6)
        for session in range(2)
    ]
    return write_study(tmp_path_factory.mktemp("repeated") / "out", rows)


def test_reliability_gives_the_detectable_change(repeated: Path, tmp_path: Path, capsys: Capture):
    done("progress", repeated, "--reliability", "--json", tmp_path / "r.json")
    assert "ICC(2,1)" in capsys.readouterr().out
    figures = json.loads((tmp_path / "r.json").read_text())
    flexion = next(each for each in figures["reliability"] if each["key"] == FLEXION)
    assert flexion["persons"] == 6 and flexion["icc_21_low"] < flexion["icc_21"] < flexion["icc_21_high"]
    done("progress", repeated, "--mdc", tmp_path / "r.json", "--json", tmp_path / "m.json")
    capsys.readouterr()
    person = json.loads((tmp_path / "m.json").read_text())["persons"][0]
    change = next(each for each in person["measures"] if each["key"] == FLEXION)["changes"][0]
    assert change["mdc95"] == pytest.approx(flexion["sdc"])
