"""Pairs are proved by their motion, wrong ones never; what has to be proved depends on the clocks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.io import read_recording, write_recording
from smoother.measurements.clock import constant_clock
from smoother.recording import CameraFrame, Recording
from smoother.result.verdict import Pairing
from smoother.selfcal.agreement import MotionAgreement, OffsetLine, agreement, chance
from smoother.selfcal.pairing import decided, doubtful, find_pairing, unproved
from smoother.simulation import ArmSimulation, simulate_arm


def made(seed: int, seconds: float = 30.0, preset: str = "realistic") -> Recording:
    config = ArmSimulation.preset(preset, protocol="random", duration_s=seconds)
    return replace(simulate_arm(config, seed).recording, truth=None)


@pytest.fixture(scope="module")
def right() -> Recording:
    return made(1)


@pytest.fixture(scope="module")
def other() -> Recording:
    return made(2)


def late(recording: Recording, seconds: float) -> Recording:
    return replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s - seconds))


@pytest.mark.parametrize("unrelated", [False, True])
def test_a_right_pair_proves_itself(right: Recording, unrelated: bool) -> None:
    pairing, clock = find_pairing(replace(right, clocks_unrelated=unrelated))
    assert pairing is not None and pairing.proved and pairing.chance < 1e-3
    assert clock is None  # the fine search reaches it
    assert not pairing.reason and not pairing.caution


def test_the_imu_of_another_session_is_not_trusted(right: Recording, other: Recording) -> None:
    wrong = replace(right, imu=other.imu)
    found = agreement(wrong)
    for unrelated, says in ((False, "check that skeleton and IMU"), (True, "unrelated")):
        pairing, _ = decided(found, replace(wrong, clocks_unrelated=unrelated))
        assert pairing is not None and not pairing.proved
        assert says in next(unproved(pairing))


def test_data_cannot_be_left_out_to_win(right: Recording, other: Recording) -> None:
    """Two seconds of the right motion at the end of another's: they alone would fit."""
    wrong = replace(right, imu=other.imu)
    n = round(2.0 * right.imu.rate_hz)
    imu = wrong.imu
    acc, gyro = imu.acc.copy(), imu.gyro.copy()
    acc[-n:], gyro[-n:] = right.imu.acc[:n], right.imu.gyro[:n]
    pairing, _ = find_pairing(replace(wrong, imu=replace(imu, acc=acc, gyro=gyro), clocks_unrelated=True))
    assert pairing is not None and not pairing.proved


def test_an_offset_of_seconds_is_found(right: Recording) -> None:
    near, _ = find_pairing(right)
    pairing, clock = find_pairing(late(right, 11.3))
    assert near is not None and pairing is not None and clock is not None
    assert pairing.proved
    assert clock.mean_s == pytest.approx(near.offset_s + 11.3, abs=0.02)


@pytest.mark.parametrize("change", ["mirrored", "down", "hand"])
def test_what_is_wrong_with_the_axes_is_no_wrong_pair(right: Recording, change: str) -> None:
    """A mirrored skeleton, or a wrong down, belongs to its IMU all the same: others name the mistake."""
    recording = right
    if change == "mirrored":
        recording = replace(right, arm=replace(right.arm, position=right.arm.position * [-1.0, 1.0, 1.0]))
    elif change == "down":
        recording = replace(right, camera_frame=CameraFrame.ZUP)
    else:  # a hand in place of the wrist
        joints = right.arm.position[:, [0, 1, 4, 2, 4]], right.arm.state[:, [0, 1, 4, 2, 4]]
        recording = replace(right, arm=replace(right.arm, position=joints[0], state=joints[1]))
    pairing, _ = find_pairing(recording)
    assert pairing is not None and pairing.proved


def test_what_the_user_states_is_used_and_contradicted_only_loudly(right: Recording) -> None:
    demanded = replace(right, clocks_unrelated=True)
    pairing, clock = find_pairing(demanded, None, constant_clock(0.0, 0.02))
    assert pairing is not None and pairing.proved and clock is None
    pairing, _ = find_pairing(late(demanded, 9.0), None, constant_clock(0.0, 0.02))
    assert pairing is not None and not pairing.proved
    assert "one given" in next(unproved(pairing))


def test_a_short_recording_of_one_recorder_is_a_caution() -> None:
    """Eight seconds of one pair prove little; nothing contradicts it."""
    line = OffsetLine(0.0, 0.0, 4.0, 0.2, 0.4)
    found = MotionAgreement(4.0, line, line, 2.0, 5.0, 0.1, True)
    recording = made(3, 8.0)
    together, _ = decided(found, recording)
    assert not list(unproved(together)) and "too short" in next(doubtful(together))
    apart, _ = decided(found, replace(recording, clocks_unrelated=True))
    assert "--clock-offset" in next(unproved(apart))


def test_without_a_forearm_there_is_nothing_to_prove(right: Recording) -> None:
    strap = right.arm.position[:, [4] * 5], np.zeros_like(right.arm.state)
    alone = replace(right, arm=replace(right.arm, position=strap[0], state=strap[1]))
    assert find_pairing(alone) == (None, None)
    pairing, _ = find_pairing(replace(alone, clocks_unrelated=True))
    assert pairing is not None and not pairing.proved and pairing.reason


def test_chance_is_a_tail() -> None:
    """Less with evidence, more with every offset tried, never less than what the same exercise explains."""
    evidence = np.linspace(0.0, 60.0, 61)
    tail = [chance(each, 0.9, 60.0, 1, True) for each in evidence]
    assert tail[0] == 1.0 and (np.diff(tail) <= 0).all()
    assert chance(15.0, 0.9, 600.0, 1, True) > chance(15.0, 0.9, 6.0, 1, True)
    assert chance(15.0, 0.9, 6.0, 1, False) > chance(15.0, 0.9, 6.0, 1, True)
    assert chance(1e3, 0.4, 6.0, 1, True) > 1e-3


def test_unrelated_clocks_stay_with_the_file(right: Recording, tmp_path: Path) -> None:
    for unrelated in (False, True):
        path = tmp_path / f"{unrelated}.mcap"
        write_recording(replace(right, clocks_unrelated=unrelated), path)
        assert read_recording(path, side="right").clocks_unrelated is unrelated


def test_a_pairing_as_plain_values() -> None:
    pairing = Pairing(False, 0.2, 4.0, 1.5, "a reason", "")
    assert Pairing.from_plain(pairing.plain()) == pairing
