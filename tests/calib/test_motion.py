"""Calibration from the motion of simulated arms: what it finds, what it says, sigma of short recordings."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused

from calib import CalibrationFile, read_calibration, sigma_factor, write_calibration
from calib.file import sigma_factors_of
from calib.motion import (
    ArmEstimates,
    Evidence,
    beyond,
    calibrate_motion,
    forearm_frame,
    motion_answer,
    not_determined,
)
from calib.sigma_factor import hidden_gap_factors
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.cli.run import run
from smoother.config import Config
from smoother.io import write_recording
from smoother.recording import JOINTS, Recording
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.arm import SimulatedArm

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})


@pytest.fixture(scope="module")
def arm() -> SimulatedArm:
    return simulate_arm(ArmSimulation(repetitions=1), 3)


@pytest.fixture(scope="module")
def file(arm: SimulatedArm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "rec.mcap"
    write_recording(arm.recording, path)
    return path


def command(*arguments: object) -> int:
    return run(["calibrate", "motion", *map(str, arguments), "--processes", "1"])


def shifted(recording: Recording, seconds: float) -> Recording:
    """The same recording with the camera's stamps late."""
    return replace(recording, name="late", arm=replace(recording.arm, t_s=recording.arm.t_s + seconds))


@pytest.mark.slow
def test_mounting_over_two_recordings(arm: SimulatedArm):
    found = calibrate_motion([arm.recording, shifted(arm.recording, 0.05)], None, ONE_PROCESS)
    for joint, lever in found.calibration.lever_arms.items():
        assert np.linalg.norm(lever.position_m - arm.calibration.lever_arms[joint].position_m) < 0.008
    true, frame = forearm_frame(arm.calibration), found.frame
    assert true is not None and true.R_F_A is not None and frame is not None and frame.R_F_A is not None
    assert np.array_equal(found.calibration.R_F_A, frame.R_F_A)
    assert np.degrees(np.arccos(frame.direction @ true.direction)) < 2.0
    turn = frame.R_F_A @ true.R_F_A.T
    assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 6.0
    one, two = found.offsets
    assert abs(one.offset_s) < 0.003 and abs(two.offset_s + 0.05) < 0.003
    assert found.not_determined == ()
    assert found.evidence.visible_s > 20 and np.degrees(found.evidence.axial_rad) > 90


def test_the_command(arm: SimulatedArm, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    cal = tmp_path / "cal.toml"
    # what is there already stays, without --force
    write_calibration(
        cal, CalibrationFile(arms={"left": ArmCalibration("left", upper_arm=Length(0.2, 0.01))})
    )
    done("calibrate", "motion", file, "-o", cal, "--json", tmp_path / "figures.json", "--processes", "1")
    out = capsys.readouterr().out
    assert "Lever arms" in out and "never carried over" in out and "roll sigma" in out
    held = read_calibration(cal)
    assert set(held.arms) == {"left", "right"}
    wrist = held.arms["right"].lever_arms["wrist"]
    true = arm.calibration.lever_arms["wrist"].position_m
    assert np.linalg.norm(wrist.position_m - true) < 0.005
    assert held.arms["right"].R_F_A is not None
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["lever_arms"]["wrist"]["position_m"] == pytest.approx(wrist.position_m.tolist())
    assert figures["lengths"]["forearm"]["sigma_m"] < 0.01
    assert figures["clock_offsets"][0]["recording"] == "rec.mcap"
    assert abs(figures["clock_offsets"][0]["offset_s"]) < 0.003
    assert figures["not_determined"] == []
    assert "clock" not in cal.read_text()
    # a second time it is merged again, and what it found may be given as known
    done("calibrate", "motion", file, "-o", cal, "--known", cal, "--processes", "1")
    said = refused(
        capsys,
        *("calibrate", "motion", file, "-o", cal, "--json", tmp_path / "figures.json", "--processes", "1"),
    )
    assert "--force" in said


FRAMES = dict.fromkeys(("shoulder", "elbow", "wrist", "hand", "strap", "upper_arm"), 500)
GOOD = Evidence(visible_s=25.0, frames=FRAMES, turning_rad_s=2.0, axial_rad=2.5)
NOTHING = ArmCalibration(side="right")


def an_arm(sigma_m: float = 0.003, distance_m: float = 0.035) -> ArmCalibration:
    """An IMU over the wrist; {A} has x away from the forearm, y along it."""
    levers = {
        "elbow": [-distance_m, -0.20, 0.0],
        "wrist": [-distance_m, 0.05, 0.0],
        "hand": [-0.03, 0.13, 0.0],
    }
    return ArmCalibration(
        "right",
        {joint: LeverArm(np.array(place), np.full(3, sigma_m)) for joint, place in levers.items()},
        Length(0.3, 0.003),
    )


def said(arm: ArmCalibration, evidence: Evidence = GOOD, known: ArmCalibration = NOTHING) -> str:
    return "\n".join(not_determined(arm, forearm_frame(arm), evidence, known))


WRIST_ALONE = replace(an_arm(), lever_arms={"wrist": an_arm().lever_arms["wrist"]}, upper_arm=None)
ONE_ROUGH_AXIS = an_arm()
ONE_ROUGH_AXIS.lever_arms["elbow"].sigma_m[2] = 0.02
ROLL = "roll is known to 20 degrees only"
HARDLY = "hardly moved while it was visible"
POINT = Evidence(20.0, {"strap": 500, "elbow": 0, "upper_arm": 0}, 2.0, float("nan"))


UNSEEN = {"frames": FRAMES | {"elbow": 0, "hand": 4, "upper_arm": 0}}
UNSEEN_SAYS = (
    "the elbow was tracked in 0",
    "the hand was tracked in 4",
    "need both elbow and wrist",
    "upper arm needs",
)
ROUGH_SAYS = (
    ROLL,
    "wrist is known only roughly in the IMU's axes: x to 12 mm, y to 12 mm, z to 12",
    "is left open",
)


@pytest.mark.parametrize(
    ("arm", "changes", "words"),
    [
        (an_arm(), {}, ()),
        (WRIST_ALONE, UNSEEN, UNSEEN_SAYS),
        (
            an_arm(0.012),
            {"axial_rad": np.radians(20)},
            (*ROUGH_SAYS, "turned by 20 degrees about its own axis"),
        ),
        (an_arm(0.012), {}, (ROLL,)),
        (an_arm(0.03), {}, ("R_F_A is left open",)),
        (an_arm(distance_m=0.006), {}, ("roll is not known", "found 6 mm from the line")),
        (ONE_ROUGH_AXIS, {}, ("the elbow is known only roughly in the IMU's axes: z to 20 mm",)),
        (
            an_arm(),
            {"visible_s": 4.0, "turning_rad_s": 0.05},
            ("visible for 4 s only", f"the forearm {HARDLY}"),
        ),
        (an_arm(), {"frames": FRAMES | {"upper_arm": 5}}, ("together in 5 frames only",)),
        (replace(an_arm(), upper_arm=Length(0.3, 0.04)), {}, ("length is known to 40 mm only",)),
        (NOTHING, vars(POINT), ()),
        (NOTHING, vars(POINT) | {"turning_rad_s": 0.01}, (f"the sensor {HARDLY}",)),
    ],
)
def test_what_is_not_determined_is_said(arm: ArmCalibration, changes: dict, words: tuple[str, ...]):
    text = said(arm, replace(GOOD, **changes))
    assert all(each in text for each in words) and bool(text) == bool(words)
    frame = forearm_frame(arm)
    is_open = "R_F_A" in text or "roll is not known" in text
    assert is_open == ((frame is None or frame.R_F_A is None) and arm is not NOTHING)


def test_what_is_given_is_not_called_open():
    arm = an_arm(sigma_m=0.03)
    evidence = replace(GOOD, frames=FRAMES | {"upper_arm": 0})
    assert said(arm, evidence, replace(arm, R_F_A=np.eye(3))) == ""


def test_errors_of_the_camera_are_no_fault_of_the_motion():
    arm = an_arm(sigma_m=0.012)
    (*said_then,) = not_determined(arm, forearm_frame(arm), GOOD, NOTHING, joint_bias_m=0.0119)
    assert said_then[0] == (
        "the camera places joints some 12 mm off (per axis), always in the same way: "
        "this limits the accuracy of lever arms and lengths"
    )
    text = "\n".join(said_then)
    assert "known only roughly" not in text
    assert "roll is known to 20 degrees only" in text
    # where the motion leaves more open than the camera does, that is said too
    rough = an_arm(sigma_m=0.0134)
    text = "\n".join(not_determined(rough, forearm_frame(rough), GOOD, NOTHING, joint_bias_m=0.006))
    assert "x to 13 mm" in text and "roll is known to" in text
    assert not list(not_determined(an_arm(), forearm_frame(an_arm()), GOOD, NOTHING, float("nan")))
    assert beyond(np.array([0.005, 0.003]), 0.004) == pytest.approx([0.003, 0.0])


FEW = 4


@pytest.fixture(scope="module")
def trials() -> list[Recording]:
    """Of 6 s each, from one session of one arm."""
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=25.0, occlusion_every_s=90.0)
    session = replace(simulate_arm(settings, 4).recording, truth=None)
    trials = []
    for k in range(FEW):
        of_arm, of_imu = (
            (t >= 6.0 * k - beside_s) & (t < 6.0 * (k + 1) + beside_s)
            for t, beside_s in ((session.arm.t_s, 0.0), (session.imu.t_s, 0.5))
        )
        arm, imu = session.arm.select(of_arm), session.imu.select(of_imu)
        trials.append(replace(session, name=f"trial {k}", arm=arm, imu=imu))
    return trials


def displaced(recording: Recording, by_m: float) -> Recording:
    """The camera's forearm elsewhere for the 0.5 s in the middle, which the gaps will hide."""
    arm = recording.arm
    middle = np.abs(arm.t_s - 0.5 * (arm.t_s[0] + arm.t_s[-1])) <= 0.25
    position = np.array(arm.position)
    for joint in ("elbow", "wrist", "hand"):
        position[middle, JOINTS.index(joint), 0] += by_m
    return replace(recording, arm=replace(arm, position=position))


@pytest.fixture(scope="module")
def calibrated(trials: list[Recording]) -> ArmEstimates:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sigma_factor, "ENOUGH_GAPS", FEW)
        return calibrate_motion(trials)


@pytest.mark.slow
def test_errors_that_are_larger_than_stated_ask_for_more(
    trials: list[Recording], calibrated: ArmEstimates, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sigma_factor, "ENOUGH_GAPS", FEW)
    sound = calibrated.calibration.sigma_factors
    assert sound is not None and all(row.factor < 2.5 for row in sound.by_length)  # of four gaps each
    calibration = replace(calibrated.calibration, sigma_factors=None)
    wrong = hidden_gap_factors([displaced(one, 0.12) for one in trials], calibration, Config())
    assert wrong is not None and [row.length_s for row in wrong.by_length] == [0.5, 1.0]
    assert all(row.factor > 3.0 and row.gaps == FEW for row in wrong.by_length)


@pytest.mark.slow
def test_the_calibration_keeps_them(calibrated: ArmEstimates) -> None:
    factors = calibrated.calibration.sigma_factors
    assert factors is not None and factors.at(1.0) > 1.0
    assert {row.gaps for row in factors.by_length} == {FEW}
    kept = sigma_factors_of(motion_answer(calibrated).table)
    assert kept is not None and kept.at(1.0) == pytest.approx(factors.at(1.0), abs=1e-4)


@pytest.mark.slow
def test_recordings_of_two_mountings_are_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Halves of one recording belong together; another person's does not."""
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=40.0)
    first, other = simulate_arm(settings, 0).recording, simulate_arm(settings, 1).recording
    middle_s = float(np.mean(first.imu.t_s[[0, -1]]))
    for name, recording, low_s, high_s in (
        ("a", first, -np.inf, middle_s),
        ("b", first, middle_s, np.inf),
        ("c", other, -np.inf, np.inf),
    ):
        imu, arm = (
            part.select((part.t_s >= low_s) & (part.t_s < high_s)) for part in (recording.imu, recording.arm)
        )
        write_recording(replace(recording, imu=imu, arm=arm, truth=None), tmp_path / f"{name}.mcap")
    files = [tmp_path / f"{name}.mcap" for name in "abc"]
    done("calibrate", "motion", *files[:2], "-o", tmp_path / "same.toml", "--processes", "1")
    capsys.readouterr()
    assert command(*files, "-o", tmp_path / "mixed.toml") == 1
    said = capsys.readouterr().err
    assert "2 mountings or persons" in said and "a.mcap, b.mcap; c.mcap" in said
    assert not (tmp_path / "mixed.toml").exists()
