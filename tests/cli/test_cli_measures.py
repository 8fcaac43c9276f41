"""`measures`, `progress`, `match`, `import strap` and recordings with several arms or people."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from importers import select_recording
from made_measures import made_measures, study_row, write_study
from mcap.reader import make_reader
from measured_arms import simulated, with_draws

import smoother
from smoother.errors import RecordingError
from smoother.io import open_recording, read_recording, read_recovery, write_recovery
from smoother.io.recording.choose import match_file
from smoother.io.recording.streams import RecordingFile
from smoother.recording import JointState, Recording
from smoother.result import Estimates
from smoother.simulation import ArmSimulation, simulate_arm, simulate_both_arms
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
def test_settings_are_read(folder: Path):
    settings, out = folder / "s.toml", folder / "s.json"
    settings.write_text("[movements]\nstart_m_s = 50.0\n")
    base = ["measures", str(folder / "out.mcap"), "--side", "left", "--config", str(settings)]
    done(*base, "--json", out)
    assert json.loads(out.read_text())["movements"] == []


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
    done("progress", study, "--csv", tmp_path / "all.csv")
    with open(tmp_path / "all.csv", encoding="utf-8", newline="") as file:
        assert {row["person"] for row in csv.DictReader(file)} == {"p1", "'=p2"}, "a name is no formula"


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


@pytest.fixture(scope="module")
def two_arms(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def test_validate_takes_each_arms_own_truth(two_arms: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = ["validate", str(two_arms / "out.mcap"), "--truth", str(two_arms / "both.mcap"), "--force"]
    done(*both, "--json", two_arms / "v.json")
    assert "--- right arm ---" in capsys.readouterr().out
    done(*both, "--side", "right", "--json", two_arms / "right.json")
    made, right = figures(two_arms / "v.json"), figures(two_arms / "right.json")
    assert [arm["side"] for arm in made["arms"]] == ["left", "right"] and "arms" not in right
    assert made["arms"][1]["occluded"] == right["occluded"]
    for arm in made["arms"]:
        assert arm["occluded"]["position_rms_m"] < 0.02
    (two_arms / "truth.csv").write_text("t_s,x,y,z\n0,0,0,1\n1,0,0,1\n")
    said = refused(capsys, "validate", two_arms / "out.mcap", "--truth", two_arms / "truth.csv")
    assert "the truth of one arm" in said and "--side" in said


@pytest.mark.slow
def test_a_study_has_a_row_with_both_arms(two_arms: Path) -> None:
    (two_arms / "in").mkdir()
    (two_arms / "in" / "both.mcap").write_bytes((two_arms / "both.mcap").read_bytes())
    done(
        "batch", two_arms / "in", "-o", two_arms / "study", "--processes", "1", "--json", two_arms / "b.json"
    )
    (row,) = figures(two_arms / "b.json")["rows"]
    arms = json.loads(row["arm_figures"])
    assert (row["side"], row["arms"]) == ("left, right", 2)
    assert row["gaps"] == sum(arm["gaps"] for arm in arms)
    assert row["sigma_max_m"] == max(arm["sigma_max_m"] for arm in arms)
    # a result of a study is what `smooth` writes
    assert (two_arms / "study" / "both.mcap").read_bytes() == (two_arms / "out.mcap").read_bytes()


def test_a_calibration_of_one_arm_leaves_the_other_to_its_motion(
    two_arms: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right_only = two_arms / "right.toml"
    text = (two_arms / "cal.toml").read_text()
    right_only.write_text("".join(re.findall(r"^\[arm\.right.*?(?=^\[arm\.left|\Z)", text, re.M | re.S)))
    done(
        *("smooth", two_arms / "both.mcap", "-o", two_arms / "with_cal.mcap", "--calibration", right_only),
        *("--processes", "1", "--draws", "0"),
    )
    assert "has no left arm: this one is found from the motion" in capsys.readouterr().out
    assert len(read_recovery(two_arms / "with_cal.mcap")) == 2


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


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory):
    """A recording with images and what the command made of it; the arm, and where its strap is."""
    folder = tmp_path_factory.mktemp("strap")
    made = ("--set", "duration_s=10", "--seed", 6, "-o", folder / "rec.mcap")
    done("simulate", "strap", *made)
    truth = tomllib.loads((folder / "rec_truth.toml").read_text())["strap"]
    done(
        *("import", "strap", folder / "rec.mcap", "-o", folder / "out.mcap", "--processes", 1),
        *("--radius-m", truth["radius_m"], "--json", folder / "s.json"),
    )
    return folder, simulate_arm(ArmSimulation(protocol="random", duration_s=10.0), 6), truth


@pytest.mark.slow
def test_the_strap_is_where_the_sensor_is(session):
    folder, simulated, _ = session
    arm, truth = read_recording(folder / "out.mcap").arm, simulated.recording.truth
    rows = arm.tracked("strap")
    assert rows.sum() > 30
    true = np.stack(
        [np.interp(arm.t_s[rows], truth.t_s, truth.position[:, axis]) for axis in range(3)], axis=1
    )
    error = np.linalg.norm(arm.joint("strap")[rows] - true, axis=1)
    # 5 mm of the core's place, and what the lever arms' direction (found from motion) does over 3.5 cm
    assert np.sqrt(np.mean(error**2)) < 0.012
    assert np.quantile(error, 0.95) < 0.02
    # nothing is found while the camera does not see the forearm
    hidden = simulated.occluded[np.searchsorted(simulated.recording.arm.t_s, arm.t_s - 1e-6)]
    assert not (rows & hidden).any()


def test_sigma_goes_with_the_strap(session):
    from smoother.io.wire.schemas import message_class

    folder, *_ = session
    seen = 0
    with open(folder / "out.mcap", "rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/skeleton"]):
            skeleton = message_class("unocclude.Skeleton").FromString(message.data)
            for joint in skeleton.joints:
                if joint.name.startswith("strap") and joint.state == JointState.TRACKED:
                    covariance = np.reshape(list(joint.position_covariance), (3, 3))
                    assert 0.001 < np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < 0.05
                    seen += 1
    assert seen > 30


@pytest.mark.slow
def test_other_joints_stay_and_images_stay_out(session):
    folder, *_ = session
    before, after = read_recording(folder / "rec.mcap"), read_recording(folder / "out.mcap")
    for joint in ("shoulder", "elbow", "wrist", "hand"):
        assert np.array_equal(before.arm.joint(joint), after.arm.joint(joint), equal_nan=True)
    assert np.array_equal(before.imu.acc, after.imu.acc)
    assert before.camera_frame == after.camera_frame
    with open(folder / "out.mcap", "rb") as stream:
        topics = {channel.topic for channel in make_reader(stream).get_summary().channels.values()}
    assert "/skeleton" in topics and not topics & {"/colour/image", "/depth/image"}


def test_what_is_said(session):
    folder, _, truth = session
    figures = json.loads((folder / "s.json").read_text())
    # the ends of the skeleton's forearm are known to a centimetre of 25
    assert figures["along"] == pytest.approx(truth["along"], abs=0.04)
    assert figures["images"] > 50 and figures["found"] == figures["reasons"]["found"]
    assert figures["reasons"]["elbow or wrist is not tracked"] > 0
    assert any("were left out" in note for note in figures["notes"])
    assert figures["colour_topic"] == "/colour/image" and figures["depth_topic"] == "/depth/image"


def test_a_depth_topic_that_is_not_there(session, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder, *_ = session
    output = ("--depth-topic", "nothing", "-o", tmp_path / "o.mcap", "--processes", 1)
    assert "has no depth images" in refused(capsys, "import", "strap", folder / "rec.mcap", *output)
    assert not (tmp_path / "o.mcap").exists()
