"""The commands on recordings with IMUs on several arms."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import open_recording, read_recording, read_recovery, write_recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both arms, recovered, with a report and figures."""
    place = tmp_path_factory.mktemp("both")
    simulate = ["simulate", "arm", "-o", str(place / "both.mcap"), "--arms", "both", "--protocol", "random"]
    simulate += ["--duration-s", "10", "--occlusion-lengths-s", "0.8", "--seed", "3"]
    assert (
        run([*simulate, "--calibration-out", str(place / "cal.toml"), "--json", str(place / "sim.json")]) == 0
    )
    smooth = [
        "smooth",
        str(place / "both.mcap"),
        "-o",
        str(place / "out.mcap"),
        "--processes",
        "1",
        "--draws",
        "0",
    ]
    assert run([*smooth, "--json", str(place / "s.json"), "--report", str(place / "r.html")]) == 0
    return place


def figures(path: Path) -> dict:
    return json.loads(path.read_text())


def sentence(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int) -> str:
    capsys.readouterr()
    assert run(arguments) == code
    said = capsys.readouterr().err.strip()
    assert said.count("\n") == 0
    return said


def test_smooth_recovers_both(folder: Path) -> None:
    made = figures(folder / "s.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"]
    assert made["side"] == "left" and made["gaps"] == made["arms"][0]["gaps"]  # the first stands above
    assert made["trusted"] is True and all(arm["trusted"] for arm in made["arms"])
    assert made["verdict"].startswith("Left arm: Usable") and "Right arm: Usable" in made["verdict"]
    assert [one.side for one in read_recovery(folder / "out.mcap")] == ["left", "right"]


def test_one_page_has_both_arms(folder: Path) -> None:
    page = (folder / "r.html").read_text()
    assert page.count('<section id="arm-') == 2 and 'href="#arm-left"' in page
    ids = re.findall(r'<div class="plot" id="(figure-[^"]+)"', page)
    assert len(ids) == len(set(ids)) and {i.rpartition("-")[2] for i in ids} == {"left", "right"}
    assert page.count('<div class="space player">') == 1  # both move together
    assert "Left arm: The recording lasts" in page and "Right arm: The recording lasts" in page


def test_validate_takes_each_arms_own_truth(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ["validate", str(folder / "out.mcap"), "--truth", str(folder / "both.mcap"), "--force"]
    assert run([*both, "--json", str(folder / "v.json")]) == 0
    assert "--- right arm ---" in capsys.readouterr().out
    assert run([*both, "--side", "right", "--json", str(folder / "right.json")]) == 0
    made, right = figures(folder / "v.json"), figures(folder / "right.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"] and "arms" not in right
    assert made["arms"][1]["occluded"] == right["occluded"]
    for arm in made["arms"]:
        assert arm["occluded"]["position_rms_m"] < 0.02
    (folder / "truth.csv").write_text("t_s,x,y,z\n0,0,0,1\n1,0,0,1\n")
    said = sentence(capsys, ["validate", str(folder / "out.mcap"), "--truth", str(folder / "truth.csv")], 1)
    assert "the truth of one arm" in said and "--side" in said


def test_export_writes_a_file_an_arm(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("csv", "trc", "c3d", "mot", "parquet"):
        arguments = ["export", str(folder / "out.mcap"), "--format", name, "-o", str(folder / f"e.{name}")]
        assert run(arguments) == 0
        assert (folder / f"e_left.{name}").exists() and (folder / f"e_right.{name}").exists()
    left, right = (
        list(csv.DictReader((folder / f"e_{side}.csv").read_text().splitlines()))
        for side in ("left", "right")
    )
    assert len(left) == len(right) and left[100]["imu_x"] != right[100]["imu_x"]
    said = sentence(
        capsys, ["export", str(folder / "out.mcap"), "--format", "csv", "-o", "x.csv", "--body", "4"], 1
    )
    assert "--body 4" in said and "left arm, right arm" in said


def test_info_and_check_speak_of_each_arm(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(folder / "both.mcap"), "--json", str(folder / "i.json")]) == 0
    said = capsys.readouterr().out
    assert "cannot be recovered" not in said and "ready for `unocclude smooth`" in said
    assert "left arm: taken" in said and "right arm: allows gaps of" in said
    about = figures(folder / "i.json")
    assert [(arm["side"], arm["imu"]) for arm in about["arms"]] == [
        ("left", "/imu/forearm_left"),
        ("right", "/imu/forearm_right"),
    ]
    assert about["side"] == "left" and about["ready"] is True and "smooth" not in about["missing"]
    assert run(["info", str(folder / "both.mcap"), "--side", "right"]) == 0
    assert "right arm: taken" not in (said := capsys.readouterr().out) and "right arm of /skeleton" in said
    with pytest.raises(RecordingError, match=r"one arm is wanted here; choose with --side\.$"):
        read_recording(folder / "both.mcap")
    check = ["check", str(folder / "both.mcap"), "--json", str(folder / "ch.json"), "--processes", "1"]
    assert run(check) == 0
    said = capsys.readouterr().out
    assert "--- left arm ---" in said and "--- right arm ---" in said
    checked = figures(folder / "ch.json")
    assert [arm["side"] for arm in checked["arms"]] == ["left", "right"] and checked["trusted"] is True
    assert all(arm["allows"]["longest_gap_s"] != 0 for arm in checked["arms"])


def test_gaps_have_a_table_an_arm(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["gaps", str(folder / "both.mcap"), "--lengths", "0.5", "--gaps-per-run", "1"]
    arguments += ["--methods", "pchip", "--calibration", str(folder / "cal.toml")]
    assert run([*arguments, "--json", str(folder / "g.json")]) == 0
    said = capsys.readouterr().out
    assert "(left arm)" in said and "(right arm)" in said and "(all arms together)" in said
    made = figures(folder / "g.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"]
    assert len(made["rows"]) == sum(len(arm["rows"]) for arm in made["arms"])


def test_compare_takes_every_arm(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["compare", str(folder / "both.mcap"), "--methods", "graph,pchip"]
    assert run([*arguments, "--json", str(folder / "c.json"), "--report", str(folder / "c.html")]) == 0
    made = figures(folder / "c.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"]
    page = (folder / "c.html").read_text()
    ids = re.findall(r'<div class="plot" id="(figure-[^"]+)"', page)
    assert ids and len(ids) == len(set(ids)) and "<h1>Left arm</h1>" in page


def test_calibrate_motion_fills_both_arms(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["calibrate", "motion", str(folder / "both.mcap"), "-o", str(folder / "motion.toml")]
    assert run([*arguments, "--json", str(folder / "m.json"), "--processes", "1"]) == 0
    text = (folder / "motion.toml").read_text()
    assert "[arm.left.lever_arm.wrist]" in text and "[arm.right.lever_arm.wrist]" in text
    assert [arm["side"] for arm in figures(folder / "m.json")["arms"]] == ["left", "right"]


def test_a_study_has_a_row_with_both_arms(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "in").mkdir()
    (folder / "in" / "both.mcap").write_bytes((folder / "both.mcap").read_bytes())
    arguments = ["batch", str(folder / "in"), "-o", str(folder / "study"), "--processes", "1"]
    assert run([*arguments, "--json", str(folder / "b.json")]) == 0
    said = capsys.readouterr().out
    assert "both.mcap (left arm)" in said and "both.mcap (right arm)" in said
    (row,) = figures(folder / "b.json")["rows"]
    arms = json.loads(row["arm_figures"])
    assert (row["side"], row["arms"]) == ("left, right", 2)
    assert row["gaps"] == sum(arm["gaps"] for arm in arms)
    assert row["sigma_max_m"] == max(arm["sigma_max_m"] for arm in arms)
    # a result of a study is what `smooth` writes
    assert (folder / "study" / "both.mcap").read_bytes() == (folder / "out.mcap").read_bytes()


def test_a_calibration_of_one_arm_leaves_the_other_to_its_motion(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right_only = folder / "right.toml"
    text = (folder / "cal.toml").read_text()
    right_only.write_text("".join(re.findall(r"^\[arm\.right.*?(?=^\[arm\.left|\Z)", text, re.M | re.S)))
    arguments = ["smooth", str(folder / "both.mcap"), "-o", str(folder / "with_cal.mcap")]
    assert run([*arguments, "--calibration", str(right_only), "--processes", "1", "--draws", "0"]) == 0
    assert "has no left arm: this one is found from the motion" in capsys.readouterr().out
    assert len(read_recovery(folder / "with_cal.mcap")) == 2


def test_what_a_person_gets_wrong(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = open_recording(folder / "both.mcap")
    file.imus = [imu for imu in file.imus if "right" in imu.topic]
    write_recording(file, folder / "right.mcap", force=True)
    out = str(folder / "never.mcap")
    said = sentence(capsys, ["smooth", str(folder / "right.mcap"), "-o", out, "--side", "left"], 1)
    assert "no IMU is on an arm" in said and "--side" in said
    both = ["simulate", "arm", "-o", out, "--arms", "both"]
    assert "one arm" in sentence(capsys, [*both, "--mocap"], 2)
    assert "--arms is one or both" in sentence(capsys, [*both[:-1], "three"], 2)
    assert not (folder / "never.mcap").exists()
