"""Clocks far apart, drifting apart and wandering: the answer follows, and the clock is stated as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother import Config, Recovery, smooth
from smoother.array_types import FloatArray
from smoother.config import Windows
from smoother.errors import SolveError
from smoother.measurements.clock import Clock
from smoother.recording import Recording
from smoother.selfcal.pairing import coarse_clock, synchronise_coarsely
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

ALONE = Config(windows=Windows(processes=1))


def simulated(duration_s: float) -> SimulatedArm:
    return simulate_arm(
        ArmSimulation.preset(
            "white",
            protocol="random",
            duration_s=duration_s,
            imu_rate_hz=80.0,
            occlusion_lengths_s=(2.0,),
            occlusion_every_s=10.0,
        ),
        seed=4,
    )


@pytest.fixture(scope="module")
def short() -> SimulatedArm:
    return simulated(60.0)


@pytest.fixture(scope="module")
def long() -> SimulatedArm:
    return simulated(330.0)


def later(made: SimulatedArm, offset_s: FloatArray) -> Recording:
    """The camera's stamps are early by so much, (F,)."""
    arm = made.recording.arm
    return replace(made.recording, arm=replace(arm, t_s=arm.t_s - offset_s), truth=None)


def in_gaps_m(made: SimulatedArm, recovery: Recovery) -> float:
    truth = made.recording.truth
    assert truth is not None
    error = np.linalg.norm(recovery.position - truth.position, axis=1)[recovery.occluded]
    return float(np.sqrt(np.mean(error**2)))


@pytest.mark.parametrize("offset_s", [2.5, -7.0])
def test_seconds_apart(short: SimulatedArm, offset_s: float) -> None:
    recovery = smooth(later(short, np.full(len(short.recording.arm), offset_s)), None, ALONE)
    assert recovery.clock_offset_s == pytest.approx(offset_s, abs=0.003)
    assert in_gaps_m(short, recovery) < 0.01
    assert any("apart" in note for note in recovery.notes)


def test_within_reach_nothing_is_moved(short: SimulatedArm, long: SimulatedArm) -> None:
    for made in (short, long):
        recording, coarse = synchronise_coarsely(later(made, np.full(len(made.recording.arm), 0.1)))
        assert coarse is None
        np.testing.assert_array_equal(recording.arm.t_s, made.recording.arm.t_s - 0.1)


def test_clocks_that_drift_far_apart(long: SimulatedArm) -> None:
    """1200 parts in a million over 330 s: 0.4 s, as 20 of them are in 6 hours; and 1 s to begin with."""
    t = long.recording.arm.t_s
    offset = 1.0 + 1.2e-3 * t
    coarse = coarse_clock(later(long, offset))
    assert coarse is not None
    assert coarse.skew == pytest.approx(1.2e-3, abs=2e-4)
    recovery = smooth(later(long, offset), None, ALONE)
    moved = recovery.arm.t_s - (t - offset)
    assert np.abs(moved - offset).max() < 0.003
    assert in_gaps_m(long, recovery) < 0.01


def test_clocks_minutes_apart(long: SimulatedArm) -> None:
    """Farther than the context of the blocks: more of the IMU is looked at."""
    coarse = coarse_clock(later(long, np.full(len(long.recording.arm), 75.0)))
    assert coarse is not None
    assert coarse.mean_s == pytest.approx(75.0, abs=0.1)


def test_an_imu_of_something_else_is_said() -> None:
    """The IMU's samples run backwards: nothing fits. It is refused, or said to be worth nothing."""
    recording = simulated(20.0).recording
    imu = recording.imu
    wrong = replace(recording, imu=replace(imu, acc=imu.acc[::-1], gyro=imu.gyro[::-1]), truth=None)
    try:
        notes = smooth(wrong, None, ALONE).notes
    except SolveError as error:
        notes = (str(error),)
    assert any("not to be trusted" in note or "not determined" in note for note in notes), notes


def test_a_clock_that_wanders_between_the_blocks(long: SimulatedArm) -> None:
    """Ten milliseconds to and fro, which the few blocks of the self-calibration cannot see."""
    t = long.recording.arm.t_s
    offset = 0.02 + 0.01 * np.sin(2 * np.pi * t / 330.0)
    recovery = smooth(later(long, offset), None, ALONE)
    error = recovery.arm.t_s - (t - offset) - offset
    assert np.sqrt(np.mean(error**2)) < 0.003  # a line leaves 4.5 ms
    assert in_gaps_m(long, recovery) < 0.01


def test_one_clock_after_another() -> None:
    coarse = Clock(np.array([0.0, 100.0]), np.array([1.0, 1.5]), 0.1, skew=0.005)
    fine = Clock(np.array([20.0, 80.0]), np.array([0.01, 0.02]), 0.001, skew=1e-4)
    t = np.linspace(0.0, 100.0, 11)
    two_steps = t + coarse.at(t) + fine.at(t + coarse.at(t))
    np.testing.assert_allclose(t + fine.after(coarse).at(t), two_steps, atol=1e-4)
    assert fine.after(None) is fine
