"""The commands on recordings with several arms or people: which IMU is on which."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from importers import select_recording

from smoother.errors import RecordingError
from smoother.io import open_recording, read_recovery
from smoother.io.recording.choose import match_file
from smoother.io.recording.streams import RecordingFile


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both arms, recovered, with a report and figures."""
    place = tmp_path_factory.mktemp("both")
    done(
        *("simulate", "arm", "-o", place / "both.mcap", "--arms", "both", "--set", "protocol=random"),
        *("--set", "duration_s=10", "--set", "occlusion_lengths_s=0.8", "--seed", "3"),
        *("--calibration-out", place / "cal.toml"),
    )
    done("smooth", place / "both.mcap", "-o", place / "out.mcap", "--processes", "1", "--draws", "0")
    return place


def figures(path: Path) -> dict:
    return json.loads(path.read_text())


def test_validate_takes_each_arms_own_truth(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ["validate", str(folder / "out.mcap"), "--truth", str(folder / "both.mcap"), "--force"]
    done(*both, "--json", folder / "v.json")
    assert "--- right arm ---" in capsys.readouterr().out
    done(*both, "--side", "right", "--json", folder / "right.json")
    made, right = figures(folder / "v.json"), figures(folder / "right.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"] and "arms" not in right
    assert made["arms"][1]["occluded"] == right["occluded"]
    for arm in made["arms"]:
        assert arm["occluded"]["position_rms_m"] < 0.02
    (folder / "truth.csv").write_text("t_s,x,y,z\n0,0,0,1\n1,0,0,1\n")
    said = refused(capsys, "validate", folder / "out.mcap", "--truth", folder / "truth.csv")
    assert "the truth of one arm" in said and "--side" in said


@pytest.mark.slow
def test_a_study_has_a_row_with_both_arms(folder: Path) -> None:
    (folder / "in").mkdir()
    (folder / "in" / "both.mcap").write_bytes((folder / "both.mcap").read_bytes())
    done("batch", folder / "in", "-o", folder / "study", "--processes", "1", "--json", folder / "b.json")
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
    done(
        *("smooth", folder / "both.mcap", "-o", folder / "with_cal.mcap", "--calibration", right_only),
        *("--processes", "1", "--draws", "0"),
    )
    assert "has no left arm: this one is found from the motion" in capsys.readouterr().out
    assert len(read_recovery(folder / "with_cal.mcap")) == 2


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, tuple[int | None, str]]]:
    """A recording of two people with four IMUs, and its truth."""
    folder = tmp_path_factory.mktemp("people")
    settings = "--seed 3 --set duration_s=12 --set imu_rate_hz=50 --set in_time=0 --set hanging=0"
    done("simulate", "people", "-o", folder / "p.mcap", "--json", folder / "p.json", *settings.split())
    figures = json.loads((folder / "p.json").read_text())
    return folder / "p.mcap", {row["imu"]: (row["body"], row["joint"]) for row in figures["truth"]}


def test_every_imu_is_named(people, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, truth = people
    done("match", recording, "--json", tmp_path / "m.json")
    rows = json.loads((tmp_path / "m.json").read_text())["matches"]
    assert {row["imu"]: (row["body"], row["joint"]) for row in rows} == truth
    assert all(0.95 < row["probability"] <= 1 for row in rows)
    assert {tuple(row)[:4] for row in rows} == {("imu", "body", "joint", "probability")}
    printed = capsys.readouterr().out
    assert all(imu in printed for imu in truth) and "3 of 4 IMUs are matched" in printed


def without(file: RecordingFile, **changes: object) -> RecordingFile:
    return replace(file, **changes)


def test_too_short_to_match(people) -> None:
    file = open_recording(people[0])
    short = [
        replace(arm, stamp_ns=arm.stamp_ns[:9], position=arm.position[:9], state=arm.state[:9])
        for arm in file.arms
    ]
    with pytest.raises(RecordingError, match=r"p\.mcap: .* too short to match"):
        match_file(without(file, arms=short))


def test_one_broken_sensor_does_not_keep_the_others(people) -> None:
    file, truth = open_recording(people[0]), people[1]
    broken = replace(file.imus[0], acc=np.full_like(file.imus[0].acc, np.nan))
    late = replace(file.imus[1], stamp_ns=file.imus[1].stamp_ns + 3_600_000_000_000)
    matches, notes = match_file(without(file, imus=[broken, late, *file.imus[2:]]))
    assert [match.is_sure for match in matches[:2]] == [False, False]
    assert all(truth[match.imu][1] == match.joint for match in matches[2:])
    assert any(note.startswith(f"{broken.topic} cannot be matched") for note in notes)
    assert any(late.topic in note and "no time in common" in note for note in notes)


@pytest.mark.slow
def test_a_name_that_contradicts_the_motion(people) -> None:
    file, truth = open_recording(people[0]), people[1]
    imu = next(k for k, one in enumerate(file.imus) if truth[one.topic][1].startswith("wrist"))
    side = truth[file.imus[imu].topic][1].removeprefix("wrist_")
    other = "left" if side == "right" else "right"
    for name, is_wrong in ((f"/imu/forearm_{side}", False), (f"/imu/forearm_{other}", True)):
        file.imus[imu] = replace(file.imus[imu], topic=name)
        matches, notes = match_file(file)
        assert matches[imu].joint == f"wrist_{side}"
        assert any(note.startswith(name) and "name contradicts" in note for note in notes) == is_wrong


def test_an_upper_arms_imu_is_not_taken_for_a_wrists(people) -> None:
    file, truth = open_recording(people[0]), people[1]
    upper = [imu for imu in file.imus if truth[imu.topic][1].startswith("upper_arm")]
    assert upper
    with pytest.raises(RecordingError, match=r"no IMU moves as a forearm .* as upper_arm_"):
        select_recording(without(file, imus=upper))


def test_one_pair_is_left_and_does_not_fit(people) -> None:
    """Beside a sure upper arm a sensor that lies still: it is not taken for want of another."""
    file, truth = open_recording(people[0]), people[1]
    upper = next(imu for imu in file.imus if truth[imu.topic][1].startswith("upper_arm"))
    table = next(imu for imu in file.imus if truth[imu.topic][1] == "none")
    body, joint = truth[upper.topic]
    side = joint.removeprefix("upper_arm_")
    with pytest.raises(RecordingError, match="choose with --imu"):
        select_recording(without(file, imus=[upper, table]), body=body, side=side)
