"""Calibration from the motion of simulated arms, as a function and as a command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import CalibrationFile, read_calibration, write_calibration
from calib.forearm.forearm_frame import forearm_frame
from calib.motion.motion_calibration import calibrate_motion
from smoother.calibration import ArmCalibration, Length
from smoother.cli.run import run
from smoother.config import Config
from smoother.io import write_recording
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, PointSimulation, simulate_arm, simulate_point
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


def test_a_recording_without_motion():
    still = simulate_arm(ArmSimulation(protocol="hang", still_all=True, duration_s=12), 1).recording
    found = calibrate_motion([still], None, ONE_PROCESS)
    text = "\n".join(found.not_determined)
    assert "the forearm hardly moved while it was visible (0 degrees/s on average)" in text
    assert "is known only roughly in the IMU's axes" in text
    assert "the clock offset is known to" in text
    assert found.calibration.R_F_A is None


def test_what_is_known_is_kept(arm: SimulatedArm):
    known = ArmCalibration("right", upper_arm=Length(0.25, 0.0005), R_F_A=np.eye(3))
    found = calibrate_motion([arm.recording], known, ONE_PROCESS)
    assert found.calibration.upper_arm is not None
    assert found.calibration.upper_arm.value_m == pytest.approx(0.25, abs=0.005)
    assert np.array_equal(found.calibration.R_F_A, np.eye(3))


def test_the_command(arm: SimulatedArm, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    cal = tmp_path / "cal.toml"
    # what is there already stays, without --force
    write_calibration(
        cal, CalibrationFile(arms={"left": ArmCalibration("left", upper_arm=Length(0.2, 0.01))})
    )
    assert command(file, "-o", cal, "--json", tmp_path / "figures.json") == 0
    out = capsys.readouterr().out
    assert "Lever arms" in out and "never carried over" in out and "R_F_A: direction to" in out
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
    assert command(file, "-o", cal, "--known", cal) == 0
    assert command(file, "-o", cal, "--json", tmp_path / "figures.json") == 1
    assert "--force" in capsys.readouterr().err


def test_refusals(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    strap = tmp_path / "strap.mcap"
    write_recording(simulate_point(PointSimulation(duration_s=10), 1).recording, strap)
    bad = tmp_path / "bad.toml"
    bad.write_text("x = 1\n")
    cases = [
        ((strap, "-o", tmp_path / "c.toml"), 1, "there is no lever arm to find"),
        ((file, file, "-o", tmp_path / "c.toml"), 2, "is named twice"),
        ((file, "-o", file), 1, "is read by this command"),
        ((file, "-o", bad), 1, "is not a calibration"),
        ((tmp_path / "none.mcap", "-o", tmp_path / "c.toml"), 1, "none.mcap"),
    ]
    for arguments, code, sentence in cases:
        assert command(*arguments) == code
        error = capsys.readouterr().err
        assert sentence in error and error.count("\n") == 1, error
    assert not (tmp_path / "c.toml").exists()
    assert bad.read_text() == "x = 1\n"


def test_recordings_of_two_mountings_are_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Halves of one recording belong together; another person's does not."""
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=40.0)
    first, other = simulate_arm(settings, 0).recording, simulate_arm(settings, 1).recording
    middle_s = float(np.mean(first.imu.t_s[[0, -1]]))
    for name, recording in (
        (
            "a",
            replace(
                first,
                imu=first.imu.select(first.imu.t_s < middle_s),
                arm=first.arm.select(first.arm.t_s < middle_s),
            ),
        ),
        (
            "b",
            replace(
                first,
                imu=first.imu.select(first.imu.t_s >= middle_s),
                arm=first.arm.select(first.arm.t_s >= middle_s),
            ),
        ),
        ("c", other),
    ):
        write_recording(replace(recording, truth=None), tmp_path / f"{name}.mcap")
    files = [tmp_path / f"{name}.mcap" for name in "abc"]
    assert command(*files[:2], "-o", tmp_path / "same.toml") == 0
    capsys.readouterr()
    assert command(*files, "-o", tmp_path / "mixed.toml") == 1
    said = capsys.readouterr().err
    assert "2 mountings or persons" in said and "a.mcap, b.mcap; c.mcap" in said
    assert not (tmp_path / "mixed.toml").exists()
