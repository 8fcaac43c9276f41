"""Both arms in one program: one skeleton, a smoother an arm, one recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from live_engine import CameraEcho

import smoother.live.smoother
from smoother.cli.run import run
from smoother.io import read_recording

SIDES = ("right", "left")


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("both") / "both.mcap"
    made = [*("--arms", "both", "--set", "imus=wrist,upper-arm", "--set", "protocol=random")]
    assert run(["simulate", "arm", "-o", str(path), "--seed", "3", *made, "--set", "duration_s=6"]) == 0
    return path


@pytest.mark.slow
def test_one_recording_one_file_of_figures_and_every_line_names_its_arm(both, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(smoother.live.smoother, "LiveSmoother", CameraEcho)
    session, figures = tmp_path / "session.mcap", tmp_path / "session.json"
    arguments = ["--arms", "both", "--speed", "0", "--record", str(session), "--json", str(figures)]
    assert run(["live", "--replay", str(both), *arguments]) == 0
    said, errors = capsys.readouterr()
    assert not errors
    for side in SIDES:
        assert f"IMU /imu/upper_arm_{side} on the upper arm" in said
        assert f"s  {side} arm: calibrating" in said
        assert f"{side} arm, " in said
        played, kept = (read_recording(path, side=side) for path in (both, session))
        upper = [each.further_imus["upper_arm"] for each in (kept, played)]
        for own, names in (
            ((kept.imu, played.imu), ("acc", "t_s")),
            (upper, ("gyro",)),
            ((kept.arm, played.arm), ("t_s", "position", "state")),
        ):
            for name in names:
                np.testing.assert_array_equal(*(getattr(each, name) for each in own))
    arms = {each["side"]: each for each in json.loads(figures.read_text())["arms"]}
    assert list(arms) == list(SIDES)
    assert arms["left"]["skeleton"]["count"] == arms["right"]["skeleton"]["count"] > 100


def test_what_a_person_gets_wrong(both, capsys):
    def sentence(*arguments: str, code: int = 2) -> str:
        capsys.readouterr()
        assert run(["live", *arguments]) == code
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        return said

    played = ("--replay", str(both))
    assert "'three' is not one of 'one', 'both'" in sentence(*played, "--arms", "three")
    places = "of right, right-upper-arm, right-hand, left, left-upper-arm, left-hand"
    for imu in ("wrist", "up=wrist", "hand=a"):
        assert places in sentence("--arms", "both", "--imu", imu)
    assert "once for each place, of upper-arm, hand" in sentence("--imu", "a", "--imu", "b")
    assert "once for each place" in sentence("--imu", "hand=a", "--imu", "hand=b")
    assert "of upper-arm, hand" in sentence("--imu", "leg=a")
    assert "a further --imu is of a stream" in sentence(*played, "--imu", "hand=a")
    same = ("--imu", "right=/imu/forearm_left", "--imu", "left=/imu/forearm_left")
    said = sentence(*played, "--arms", "both", "--speed", "0", *same, code=1)
    assert "/imu/forearm_left" in said or "which IMU is on which arm" in said
