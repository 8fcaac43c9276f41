"""Clocks far apart, drifting, wandering, unclear or measured: the answer follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, arm

from smoother import Recovery, smooth
from smoother.array_types import FloatArray
from smoother.errors import SolveError
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock, constant_clock
from smoother.recording import Recording
from smoother.selfcal.clock_fit import ClockScore, refined_clock
from smoother.selfcal.pairing import coarse_clock, coarse_offset, synchronise_coarsely
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


def simulated(duration_s: float) -> SimulatedArm:
    often = {"occlusion_lengths_s": (2.0,), "occlusion_every_s": 10.0}
    return arm(4, protocol="random", duration_s=duration_s, imu_rate_hz=80.0, **often)


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
    """1200 ppm over 330 s: 0.4 s, as 20 of them are in 6 hours; and 1 s to begin with."""
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
    recording = simulated(12.0).recording
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


def apart(preset: str, duration_s: float, seed: int, offset_s: float) -> tuple[Recording, float]:
    """A recording whose camera is early by so much more, and its true offset."""
    made = simulate_arm(ArmSimulation.preset(preset, protocol="random", duration_s=duration_s), seed)
    arm = replace(made.recording.arm, t_s=made.recording.arm.t_s - offset_s)
    return replace(made.recording, arm=arm, truth=None), offset_s + made.parameters["clock_offset_s"]


@pytest.mark.parametrize(
    ("preset", "duration_s", "offset_s"),
    [
        ("white", 24.0, 0.6),
        ("realistic", 32.0, -1.4),
        ("azure", 24.0, 0.6),
        ("azure", 45.0, 6.0),
        ("realistic", 60.0, -12.0),
    ],
)
def test_irregular_motion_tells(preset: str, duration_s: float, offset_s: float) -> None:
    for seed in (0, 1):
        recording, true_s = apart(preset, duration_s, seed, offset_s)
        # the fine search reaches 0.4 s; what is left here is what smoothed speeds on a 50 Hz grid are good to
        assert coarse_offset(recording, 0.4) == pytest.approx(true_s, abs=0.1)


def test_a_measured_clock_is_not_looked_for() -> None:
    recording, true_s = apart("realistic", 24.0, 2, 3.0)
    measured = Clock(np.array([10.0]), np.array([true_s]), 0.001, skew=1e-4)
    moved, clock = synchronise_coarsely(recording, None, measured)
    assert clock is measured
    t = recording.arm.t_s
    np.testing.assert_allclose(moved.arm.t_s, t + true_s + 1e-4 * (t - 10.0), atol=1e-12)


def test_a_measured_clock_is_a_prior() -> None:
    recording, true_s = apart("realistic", 24.0, 2, 3.0)
    free = smooth(recording, None, ALONE)
    given = smooth(recording, None, ALONE, clock=constant_clock(true_s, 0.001))
    assert abs(given.clock_offset_s - true_s) < 0.002  # the joints' lag is a ms or two
    assert given.clock_offset_sigma_s < min(0.001, free.clock_offset_sigma_s)
    weak = smooth(recording, None, ALONE, clock=constant_clock(true_s + 0.05, 0.15))
    assert weak.clock_offset_s == pytest.approx(free.clock_offset_s, abs=0.003)


def test_prior_and_motion_weigh_as_their_information() -> None:
    """One window says 20 ms with 5 ms; the prior says zero with its own sigma."""
    information = np.full(1, 1.0 / 0.005**2)
    score = ClockScore(np.ones(1), 0.02 * information, information, np.zeros(1, int))
    for prior_s in (0.005, 0.15):
        clock = refined_clock(constant_clock(0.0, prior_s), score, False)
        share = prior_s**2 / (prior_s**2 + 0.005**2)
        assert clock.mean_s == pytest.approx(0.02 * share, rel=1e-6)
        assert clock.sigma_s == pytest.approx(np.sqrt(share) * 0.005, rel=1e-6)
        assert clock.prior_sigma_s == prior_s


@pytest.mark.parametrize(("seconds", "seed"), [(12.0, 31), (20.0, 1)])
def test_speeds_that_agree_by_chance(seconds: float, seed: int) -> None:
    """A second off the two speeds agree clearly, but not the directions in which the forearm turns."""
    settings = ArmSimulation.preset(
        "realistic", protocol="random", duration_s=seconds, occlusion_lengths_s=(1.0,), occlusion_every_s=6.0
    )
    recording = simulate_arm(settings, seed).recording
    assert coarse_offset(recording, LARGEST_OFFSET_S) == 0.0
    late = replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s - 2.0))
    assert coarse_offset(late, LARGEST_OFFSET_S) == pytest.approx(2.0, abs=0.1)
