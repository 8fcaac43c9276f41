"""What a recording allows, in a line, before anything is solved."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.run import run
from smoother.io import write_recording
from smoother.measurements.allowance import allowance
from smoother.recording import FOREARM_JOINTS, Recording
from smoother.simulation import ArmSimulation, PointSimulation, simulate_arm, simulate_point


@cache
def arm() -> Recording:
    settings = ArmSimulation.preset("realistic", protocol="random", duration_s=30.0)
    return replace(simulate_arm(settings, 1).recording, truth=None)


def slower(recording: Recording, every: int) -> Recording:
    return replace(recording, imu=recording.imu.select(slice(None, None, every)))


def test_a_sound_recording_is_ready():
    found = allowance(arm())
    assert found.ready and found.undetermined == ()
    assert found.within_m == 0.02 and found.longest_s is not None and 3.0 < found.longest_s < 8.0
    assert found.sentence.startswith("allows gaps of some seconds within 2 cm (rule of thumb")


def test_a_slow_imu_allows_less_and_then_nothing():
    usual, slow, still_slower = (allowance(slower(arm(), every)) for every in (1, 3, 8))
    assert slow.ready and slow.longest_s < usual.longest_s
    assert any("slow" in sentence for sentence in slow.undetermined)
    assert not still_slower.ready and "samples per second" in still_slower.sentence


def test_without_a_shoulder_gaps_are_shorter():
    tracks = arm().arm
    without = replace(arm(), arm=tracks.hide(np.ones(len(tracks), bool), ("shoulder",)))
    assert allowance(without).longest_s < allowance(arm()).longest_s


def test_a_point_is_no_arm():
    found = allowance(simulate_point(PointSimulation(duration_s=20.0), 1).recording)
    assert found.ready and not any("roll" in sentence for sentence in found.undetermined)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: replace(r, imu=replace(r.imu, gyro=0.01 * r.imu.gyro)), "hardly turns"),
        (lambda r: replace(r, imu=replace(r.imu, gyro=r.imu.gyro * [1.0, 0.0, 0.0])), "the roll"),
        (
            lambda r: replace(r, arm=r.arm.hide(np.ones(len(r.arm), bool), ("elbow", "hand", "strap"))),
            "without elbow and wrist",
        ),
        (lambda r: replace(r, arm=r.arm.hide(r.arm.t_s > r.arm.t_s[0] + 3.0)), "in view for 3 s"),
    ],
)
def test_what_nothing_determines(change, words: str):
    found = allowance(change(arm()))
    assert any(words in sentence and "nothing determines" in sentence for sentence in found.undetermined)
    assert found.longest_s is None or found.within_m > 0.02 or found.longest_s < allowance(arm()).longest_s


def test_nothing_tracked_and_no_common_time():
    tracks = arm().arm
    nothing = allowance(replace(arm(), arm=tracks.hide(np.ones(len(tracks), bool), FOREARM_JOINTS)))
    assert "never tracked" in nothing.sentence and not nothing.ready
    apart = allowance(replace(arm(), arm=replace(tracks, t_s=tracks.t_s + 1000.0)))
    assert "in common" in apart.sentence and not apart.ready


def test_info_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_recording(arm(), tmp_path / "good.mcap")
    write_recording(slower(arm(), 100), tmp_path / "slow.mcap")
    for name, ready in (("good", True), ("slow", False)):
        assert (
            run(["info", str(tmp_path / f"{name}.mcap"), "--json", str(tmp_path / "i.json"), "--force"]) == 0
        )
        values, printed = json.loads((tmp_path / "i.json").read_text()), capsys.readouterr().out
        assert values["ready"] is ready and values["allows"] in printed
        assert ("not ready for `unocclude smooth`" in printed) is not ready


def test_one_camera_without_depth_is_not_enough_and_two_are() -> None:
    settings = {"protocol": "random", "duration_s": 20.0, "rgb": "all", "cameras": (75.0,)}
    recording = simulate_arm(ArmSimulation.preset("realistic", **settings), 5).recording
    both, alone = allowance(recording), allowance(replace(recording, cameras=()))
    assert both.ready
    assert not alone.ready
    assert "one camera without depth do not show how far away the arm is" in alone.sentence
