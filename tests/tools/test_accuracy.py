"""The tools that hold figures against truth, and that draw them: commands, tables, checks."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.matching import ImuMatch, Limb
from smoother.simulation import ArmSimulation, simulate_arm
from tools.accuracy.__main__ import main, option_parser
from tools.accuracy.measures import NEAR_DEG, Sample, accuracy_csv, coverage_table, hidden_extremes
from tools.accuracy.oracle import DIGITS, Run, differing, row_of
from tools.accuracy.pairing import Answer, answer_rows, crossed, known_clock_s, rows_of
from tools.accuracy.recordings import GapErrors
from tools.figures import curves
from tools.figures.curves import WITHOUT, tables

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


SHORT_S = 12.0


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulated recordings of twelve seconds."""
    monkeypatch.setattr(curves, "DURATION_S", SHORT_S)


def test_a_job_has_a_row_a_gap_and_method(short):
    rows = curves.run_job(curves.Job("realistic", "500", 0.5, ("graph", "hold")))
    assert {row["method"] for row in rows} == {"graph", "hold"}
    assert len(rows) % 2 == 0 and all(row["failure"] == "" and 0 < row["rms_m"] < 0.5 for row in rows)
    assert json.loads(json.dumps(rows)) == rows


def test_every_ingredient_can_be_taken_away(short):
    whole = curves.run_job(curves.Job("realistic", "500", 1.0, ("graph",)))
    without = curves.run_job(curves.Job("ingredients", "500", 1.0, tuple(WITHOUT)))
    assert {row["method"] for row in without} == set(WITHOUT)
    assert all(row["failure"] == "" for row in without)
    # the very gaps of the whole graph, so that they can stand side by side
    assert {row["start_s"] for row in without} == {row["start_s"] for row in whole}
    by_name = {name: max(row["rms_m"] for row in without if row["method"] == name) for name in WITHOUT}
    # three degrees of gravity are 0.5 m/s^2: over 1 s seen from both sides up to 6 cm
    assert by_name["gravity 3 degrees off"] > 1.5 * max(row["rms_m"] for row in whole)


def test_jobs_that_say_most_come_first():
    todo = list(curves.jobs(["realistic", "clean", "ingredients"], seeds=2))
    assert len({job.name for job in todo}) == len(todo)
    assert {job.length_s for job in todo if job.data == "realistic"} == set(curves.LENGTHS_S)
    lengths = [job.length_s for job in todo if job.data != "ingredients"]
    assert lengths == sorted(lengths, key=curves.LENGTHS_S.index)


def row(method: str, length_s: float, start_s: float, rms_m: float | None, recording: str = "a") -> dict:
    failure = "" if rms_m is not None else "no answer"
    figures = {"rms_m": rms_m, "nees": rms_m and 1.0, "samples": 10 if rms_m else 0}
    return (
        {"recording": recording, "method": method, "length_s": length_s, "start_s": start_s}
        | figures
        | {"failure": failure}
    )


def test_summed_up_and_drawn(tmp_path: Path):
    pytest.importorskip("matplotlib")
    from tools.figures.curves import draw

    kept = tmp_path / "rows.jsonl"
    seen = [
        row(m, x, at, e * x)
        for x in (0.5, 2.0)
        for at in (1.0, 9.0)
        for m, e in (("graph", 0.01), ("hold", 0.2))
    ]
    entries = [
        {"job": "1", "data": "realistic", "rows": seen},
        {
            "job": "2",
            "data": "broad",
            "rows": [row("graph", 1.0, 2.0, None), {"recording": "b", "skipped": "short"}],
        },
        {"job": "3", "data": "ingredients", "rows": [row("no wrist", 2.0, 9.0, 0.05)]},
    ]
    kept.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    found = curves.summed_up(curves.read_rows(kept))
    first, second = found["realistic"]["lengths"]
    assert (first["length_s"], second["length_s"]) == (0.5, 2.0)
    assert first["methods"]["graph"]["median_m"] == 0.005 and first["methods"]["graph"]["gaps"] == 2
    assert second["methods"]["hold"]["samples_rms_m"] == 0.4
    assert found["broad"]["lengths"][0]["methods"]["graph"]["failed"] == 1
    # the graph is beside its ingredients in the gaps that they share alone
    (beside,) = found["ingredients"]["lengths"]
    assert beside["methods"]["graph"]["gaps"] == 1 and beside["methods"]["no wrist"]["median_m"] == 0.05
    lines = list(tables(found))
    assert "| graph | 0.50 / 0.50 (0.50 .. 0.50) | 2.00 / 2.00 (2.00 .. 2.00) |" in lines
    assert lines.index("| gap | 0.5 s | 2 s |") + 2 == lines.index(next(x for x in lines if "| graph" in x))
    draw(found, tmp_path / "curves.svg")
    drawn = (tmp_path / "curves.svg").read_text()
    assert "graph (unocclude)" in drawn and "without an answer" not in drawn and "no wrist" in drawn
    draw(found, tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_text() == drawn  # no date, no chance


def test_what_is_done_is_not_done_again(tmp_path: Path, capsys):
    kept = tmp_path / "rows.jsonl"
    todo = [curves.Job("realistic", "500", 0.5)]
    kept.write_text(json.dumps({"job": todo[0].name, "data": "realistic", "rows": []}) + "\n")
    curves.measure(todo, kept, processes=1)
    assert len(curves.read_rows(kept)) == 1 and capsys.readouterr().out == ""


def test_rows_count_what_they_say() -> None:
    limb = Limb(simulate_arm(ArmSimulation(protocol="hang", duration_s=2.0), 0).recording.arm, "wrist")
    sure, doubtful = (ImuMatch("/imu/a", limb, True, p, 0.0) for p in (0.99, 0.7))
    unknown = ImuMatch("/imu/a", None, False, 0.4, 0.0)
    rows = [
        Answer(sure, True, True),
        Answer(sure, False, True),
        Answer(doubtful, False, True),
        Answer(unknown, False, False),
    ]
    printed = "\n".join(answer_rows("Made", {"motion": rows}))
    assert re.search(r"motion +25\.0% +25\.0% +2 +50\.0% +1 +75\.0%$", printed, re.MULTILINE)
    assert "0.990: 0.500 of 2" in printed and "0.700: 0.000 of 1" in printed


def test_scenes_are_run(capsys: pytest.CaptureFixture[str]) -> None:
    main(["match", "scenes", "--seeds", "2", "--methods", "motion"])
    printed = capsys.readouterr().out
    assert "Scenes, seeds 0 to 1, 8 IMUs" in printed
    assert re.search(r"motion .* 0 +[\d.]+%$", printed, re.MULTILINE)  # none that is sure is wrong


def test_a_row_of_the_oracle_counts_what_is_not_answered():
    errors = np.array([[0.03, 1.0, 2.0, 3.0], [0.04, 9.0, 2.0, 3.0], [np.nan] * 4, [np.nan] * 4])
    row = row_of(
        [Run([errors], Counter(recordings=1, gaps=1)), Run([], Counter(recordings=1, refused=1))], 2.04
    )
    figures = [row[name] for name in ("rms cm", "max cm", "turn deg", "inside %", "turn inside %", "NEES")]
    assert figures == [3.54, 4.0, 2.0, 50.0, 100.0, 1.67]
    assert [row[name] for name in ("answered %", "recordings", "refused", "cpu s")] == [50.0, 2, 1, 2.0]
    assert row_of([Run([], Counter(recordings=1, refused=1))], 0.0)["rms cm"] is None


@pytest.mark.parametrize(
    ("change", "tolerance", "differs"),
    [
        ({}, 0.0, False),
        ({"rms cm": 1.01}, 0.0, True),
        ({"rms cm": 1.01}, 0.02, False),
        ({"rms cm": 0.97}, 0.02, True),
        ({"inside %": 93.1}, 0.02, False),  # of 100, not of 95
        ({"inside %": 92.9}, 0.02, True),
        ({"gaps trusted": 48}, 0.02, False),  # of all 100 gaps
        ({"gaps trusted": 47}, 0.02, True),
        ({"wrong": 51}, 0.02, True),  # never more
        ({"wrong": 49}, 0.02, False),
        ({"turn deg": None}, 0.02, True),
    ],
)
def test_tables_of_the_oracle_are_compared(change: dict[str, float | None], tolerance: float, differs: bool):
    old = dict.fromkeys(DIGITS, 50.0) | {"rms cm": 1.0, "inside %": 95.0, "gaps": 100.0}
    told = differing(old, old | change, tolerance)
    assert len(told) == differs and all(each.startswith((*change,)) for each in told)


def test_the_oracle_names_what_it_cannot_read(tmp_path: Path):
    with pytest.raises(SystemExit, match="there is no"):
        main(["oracle", "--against", str(tmp_path / "none.json")])
