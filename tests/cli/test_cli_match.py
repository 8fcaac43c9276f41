"""`unocclude match` and `simulate people`: files, JSON, what is said; `smooth` on sensors without names."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import open_recording, select_recording, write_recording
from smoother.io.recording.select import match_file
from smoother.io.recording.streams import RecordingFile
from smoother.io.recording.write import as_file
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, tuple[int | None, str]]]:
    """A recording of two people with four IMUs, and its truth."""
    folder = tmp_path_factory.mktemp("people")
    settings = "--seed 3 --duration-s 12 --imu-rate-hz 50 --in-time 0 --hanging 0"
    files = [str(folder / "p.mcap"), "--json", str(folder / "p.json")]
    assert run(["simulate", "people", "-o", *files, *settings.split()]) == 0
    figures = json.loads((folder / "p.json").read_text())
    return folder / "p.mcap", {row["imu"]: (row["body"], row["joint"]) for row in figures["truth"]}


def test_every_imu_is_named(people, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, truth = people
    assert run(["match", str(recording), "--json", str(tmp_path / "m.json")]) == 0
    rows = json.loads((tmp_path / "m.json").read_text())["matches"]
    assert {row["imu"]: (row["body"], row["joint"]) for row in rows} == truth
    assert all(0.95 < row["probability"] <= 1 for row in rows)
    assert {tuple(row)[:4] for row in rows} == {("imu", "body", "joint", "probability")}
    printed = capsys.readouterr().out
    assert all(imu in printed for imu in truth) and "3 of 4 IMUs are matched" in printed


def test_every_method_in_one_table(people, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, truth = people
    command = ["match", str(recording), "--method", "all", "--json", str(tmp_path / "m.json")]
    assert run([*command, "--clocks-apart-s", "1"]) == 0
    figures = json.loads((tmp_path / "m.json").read_text())
    assert set(figures["methods"]) >= {"motion", "joint-likelihood", "shakeid", "acceleration-distance"}
    assert figures["matches"] == figures["methods"]["motion"]
    assert {row["imu"] for found in figures["methods"].values() for row in found} == set(truth)
    assert "Every method" in capsys.readouterr().out


def test_what_is_asked_wrongly(people, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording, _ = people
    assert run(["match", str(recording), "--method", "best"]) != 0
    assert "--method is motion, magnitudes" in capsys.readouterr().err
    assert run(["match", str(tmp_path / "no.mcap")]) != 0
    assert "no.mcap" in capsys.readouterr().err
    assert run(["match", str(recording), "--skeleton", "/other"]) != 0
    assert "no skeleton fits --skeleton /other; it has /skeleton" in capsys.readouterr().err
    assert run(["match", str(recording), "--json", str(recording)]) != 0
    assert "read by this command" in capsys.readouterr().err
    assert run(["simulate", "people", "-o", str(tmp_path / "x.mcap"), "--sensors", "24"]) != 0
    assert "places for IMUs" in capsys.readouterr().err
    assert not (tmp_path / "x.mcap").exists()


def without(file: RecordingFile, **changes: object) -> RecordingFile:
    return replace(file, **changes)


def test_files_that_cannot_be_matched(people) -> None:
    file = open_recording(people[0])
    with pytest.raises(RecordingError, match="has no IMU to match"):
        match_file(without(file, imus=[]))
    with pytest.raises(RecordingError, match="shows no arm"):
        match_file(without(file, arms=[]))
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


def test_a_file_without_axes_is_matched_all_the_same(people) -> None:
    file, truth = open_recording(people[0]), people[1]
    matches, _ = match_file(without(file, camera_frame=None))
    assert all(truth[match.imu][1] == match.joint for match in matches)


def test_smooth_takes_the_imu_that_is_on_the_arm(people) -> None:
    """Names say nothing, two arms move, an upper arm and the table have sensors too."""
    recording, truth = people
    file = open_recording(recording)
    body = next(body for body, joint in truth.values() if joint.startswith("wrist"))
    for imu, (whose, joint) in truth.items():
        if whose == body and joint.startswith("wrist"):
            side = joint.removeprefix("wrist_")
            taken = select_recording(file, body=body, side=side)
            assert taken.imu.name == imu and taken.side == side
            assert any(f"IMU {imu}" in note and "probability" in note for note in taken.notes)


def test_an_upper_arms_imu_is_not_taken_for_a_wrists(people) -> None:
    file, truth = open_recording(people[0]), people[1]
    upper = [imu for imu in file.imus if truth[imu.topic][1].startswith("upper_arm")]
    assert upper
    with pytest.raises(RecordingError, match=r"no IMU moves as a forearm .* as upper_arm_"):
        select_recording(without(file, imus=upper))


def test_the_other_forearms_are_named_too(people) -> None:
    """Two wrists have an IMU: one is taken or the user is asked, and either way both are named."""
    file, truth = open_recording(people[0]), people[1]
    wrists = [imu.topic for imu in file.imus if truth[imu.topic][1].startswith("wrist")]
    assert len(wrists) == 2
    try:
        said = " ".join(select_recording(file).notes)
    except RecordingError as error:
        said = str(error)
    assert all(topic in said for topic in wrists)


def test_one_pair_is_left_and_does_not_fit(people) -> None:
    """Beside a sure upper arm a sensor that lies still: it is not taken for want of another."""
    file, truth = open_recording(people[0]), people[1]
    upper = next(imu for imu in file.imus if truth[imu.topic][1].startswith("upper_arm"))
    table = next(imu for imu in file.imus if truth[imu.topic][1] == "none")
    body, joint = truth[upper.topic]
    side = joint.removeprefix("upper_arm_")
    with pytest.raises(RecordingError, match="choose with --imu"):
        select_recording(without(file, imus=[upper, table]), body=body, side=side)


def test_names_are_still_believed_first() -> None:
    """A single IMU that is named as this arm's is taken without a look at its motion."""
    made = simulate_arm(ArmSimulation(protocol="random", duration_s=5.0), 1).recording
    taken = select_recording(as_file(made))
    assert taken.notes == made.notes


def test_the_same_seed_gives_the_same_people(people, tmp_path: Path) -> None:
    settings = "--seed 3 --duration-s 12 --imu-rate-hz 50 --in-time 0 --hanging 0"
    assert run(["simulate", "people", "-o", str(tmp_path / "again.mcap"), *settings.split()]) == 0
    first, again = open_recording(people[0]), open_recording(tmp_path / "again.mcap")
    for one, other in zip(first.imus, again.imus, strict=True):
        np.testing.assert_array_equal(one.acc, other.acc)
    for arm, same in zip(first.arms, again.arms, strict=True):
        np.testing.assert_array_equal(arm.position, same.position)
    write_recording(again, tmp_path / "third.mcap")  # what was read can be written again
