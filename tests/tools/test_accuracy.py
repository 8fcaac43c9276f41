"""The tools that hold figures against truth: their commands, tables and checks, on samples that are known."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.simulation import ArmSimulation, simulate_arm
from tools.accuracy.__main__ import main, option_parser
from tools.accuracy.measures import NEAR_DEG, Sample, accuracy_csv, coverage_table, hidden_extremes
from tools.accuracy.pairing import crossed, known_clock_s, rows_of
from tools.accuracy.recordings import GapErrors

ROOT = Path(__file__).parents[2]


def test_a_gaps_errors_are_held_against_what_is_stated():
    gap = GapErrors(
        distance_m=np.array([0.03, 0.04, np.nan]),
        angle_deg=np.array([1.0, 1.0, 1.0]),
        variance_m2=np.array([1e-4, 1e-4, np.nan]),
        squared_sigmas=np.array([9.0, 16.0, np.nan]),
        turn_squared_sigmas=np.ones(3),
    )
    assert gap.rms_m == pytest.approx(np.sqrt(0.00125))
    assert gap.sigmas == pytest.approx(np.sqrt(12.5))
    assert "answered 67 %" in str(gap)


def test_the_table_of_long_gaps(capsys: pytest.CaptureFixture[str]):
    settings = "arm --preset azure --gap-s 3 4 --seeds 0:1 --each --set duration_s=30"
    main(settings.split())
    printed = capsys.readouterr().out
    tables = re.findall(r"^([34]) s, (\d) gaps: rms (\S+) cm  worst gap (\S+) cm", printed, re.MULTILINE)
    assert [length for length, *_ in tables] == ["3", "4"]
    for length, count, rms, worst in tables:
        gaps = re.findall(rf"\+ +{length}\.\d s: rms +(\S+) cm", printed)
        assert len(gaps) == int(count) > 0
        assert float(worst) == max(float(each) for each in gaps)
        assert min(float(each) for each in gaps) <= float(rms) <= float(worst)
    assert printed.count("largest rms / sigma of a gap") == 2
    assert len(re.findall(r"50 %: \d+ %   95 %: \d+ %", printed)) == 4  # position and orientation


def test_the_sum_over_simulated_arms(capsys: pytest.CaptureFixture[str]):
    main(["arm", "--preset", "white", "--seeds", "0:1", "--set", "repetitions=1"])
    printed = capsys.readouterr().out
    (seed,) = re.findall(r"occluded +(\S+) / +(\S+) cm", printed)
    assert re.findall(r"occluded: rms +(\S+) cm  max +(\S+) cm", printed) == [seed]
    assert "visible: rms" in printed and "inside the region that should hold" in printed


def test_short_gaps_with_one_imu_and_two(capsys: pytest.CaptureFixture[str]):
    settings = "short --presets white --seeds 0:1 --set duration_s=16"
    main(settings.split())
    printed = capsys.readouterr().out
    rows = re.findall(r"^  (\S+(?: s)?) +(\d+) +(\S+) +(\S+) +(\S+)   (\S+) (\S+)", printed, re.MULTILINE)
    (every,) = [row for row in rows if row[0] == "all"]
    assert int(every[1]) == sum(int(row[1]) for row in rows if row[0] != "all") > 0
    assert float(every[4]) == pytest.approx(float(every[3]) / float(every[2]), rel=0.01)
    for row in rows:
        assert ("two are worse" in printed) == any(float(row[4]) > 1.02 for row in rows)


def test_angles_relative_to_the_trunk(capsys: pytest.CaptureFixture[str]):
    settings = "trunk --preset white --seeds 1:2 --set duration_s=20"
    main(settings.split())
    printed = capsys.readouterr().out
    pattern = r"shoulder_(\w+)_trunk +rms +(\S+) deg, without the trunk's IMU +(\S+) deg"
    found = {kind: (float(a), float(b)) for kind, a, b in re.findall(pattern, printed)}
    assert set(found) == {"plane", "elevation", "rotation"}
    assert found["elevation"][0] < 0.8 * found["elevation"][1]


def test_every_command_of_the_documents_is_one_of_the_program():
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    found = [
        command
        for page in pages
        for command in re.findall(r"`python -m tools\.accuracy( [^`]*)`", page.read_text(encoding="utf-8"))
        if "NAME" not in command
    ]
    assert len(found) > 20
    for command in found:
        option_parser().parse_args(command.split())


def sample(value: float, truth: float, scope: str = "session", key: str = "hand_path_length_m") -> Sample:
    return Sample(key, scope, value, truth, 0.5, value - 0.95, value + 0.95)


def test_coverage_and_errors_are_counted_by_scope_and_key():
    samples = [sample(10.0, 10.5), sample(10.0, 8.5), sample(10.0, 10.0, "movement"), sample(np.nan, 1.0)]
    session, movement = coverage_table(samples)
    assert (session["cases"], session["coverage"], movement["coverage"]) == (2, 0.5, 1.0)
    assert session["rms"] == pytest.approx(np.sqrt((0.5**2 + 1.5**2) / 2)) and session["bias"] == 0.5
    assert session["width"] == pytest.approx(1.9)
    row = accuracy_csv({"azure": [session, movement]}).splitlines()[-1]
    assert row == "hand_path_length_m,50,2,100,1,1.1"


def test_zones_of_an_angle_count_together():
    keys = [f"elbow_flexion_zone_{low}_to_{low + 10}_percent" for low in (30, 40)]
    (row,) = coverage_table([sample(20.0, 20.0, key=key) for key in keys])
    assert (row["key"], row["cases"]) == ("elbow_flexion_zones_percent", 2)


def test_two_thirds_about_the_extremes_are_hidden():
    from smoother.joint_angles import arm_angles

    config = ArmSimulation.preset("white", protocol="random", occlusion_lengths_s=(), duration_s=20.0)
    simulated = simulate_arm(config, 1)
    arm, hidden = simulated.recording.arm, hidden_extremes(simulated).recording.arm
    lost = arm.tracked("wrist") & ~hidden.tracked("wrist")
    truth = simulated.recording.truth
    assert truth is not None
    flexion = arm_angles(truth.joints, len(truth.t_s))["elbow_flexion"]
    at = np.interp(arm.t_s, truth.t_s, flexion)
    near = (at >= flexion.max() - NEAR_DEG) | (at <= flexion.min() + NEAR_DEG)
    # the camera's stamps are those of the IMU in this preset: what is hidden lies about the extremes
    assert lost.sum() > 5 and near[lost].mean() > 0.9
    for extreme in (np.argmax(flexion), np.argmin(flexion)):
        assert lost[np.argmin(np.abs(arm.t_s - truth.t_s[extreme]))]


def test_both_ways_know_a_clock() -> None:
    made = simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=20.0), 4)
    recording = made.recording
    late = replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s - 3.0))
    assert known_clock_s(late) == pytest.approx(3.0 + made.parameters["clock_offset_s"], abs=0.1)


def test_a_table_of_right_and_wrong_pairs() -> None:
    config = ArmSimulation.preset("white", protocol="random", duration_s=30.0)
    simulated = [simulate_arm(config, seed) for seed in (5, 6)]
    pairs = [(replace(each.recording, truth=None), each.parameters["clock_offset_s"]) for each in simulated]
    right, wrong = rows_of("random", [*crossed(pairs)])
    assert "right    2: proved    2, accepted of one recorder    2" in right and "2 of 2" in right
    assert "wrong    2: proved    0, accepted of one recorder    0" in wrong
