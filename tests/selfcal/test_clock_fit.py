"""The camera's clock against the IMU's: offsets, far apart, drifting, wandering, unclear or measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, Scene, answer, moving

from smoother import Recovery
from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration
from smoother.evaluation.validate import validate
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock, constant_clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import split_into_segments
from smoother.measurements.timestamps import synthetic_stamps
from smoother.recording import Recording
from smoother.runtime.pool import Pool
from smoother.selfcal.clock_fit import SYNTHETIC_SIGMA_S
from smoother.selfcal.pairing import coarse_offset, find_pairing, pair
from smoother.selfcal.rounds import self_calibrate
from smoother.simulation import SimulatedArm


def test_a_clock_is_linear_between_knots_and_held_beyond_and_one_goes_after_another() -> None:
    clock = Clock(np.array([1.0, 3.0]), np.array([0.01, 0.03]), 0.001)
    np.testing.assert_allclose(clock.at(np.array([0.0, 1.0, 2.0, 5.0])), [0.01, 0.01, 0.02, 0.03])
    assert (clock.mean_s, clock.drift_s) == (pytest.approx(0.02), pytest.approx(0.02))
    coarse = Clock(np.array([0.0, 100.0]), np.array([1.0, 1.5]), 0.1, skew=0.005)
    fine = Clock(np.array([20.0, 80.0]), np.array([0.01, 0.02]), 0.001, skew=1e-4)
    t = np.linspace(0.0, 100.0, 11)
    two_steps = t + coarse.at(t) + fine.at(t + coarse.at(t))
    np.testing.assert_allclose(t + fine.after(coarse).at(t), two_steps, atol=1e-4)
    assert fine.after(None) is fine


def even(rate_hz: float) -> FloatArray:
    return 5.0 + np.arange(100) / rate_hz


@pytest.mark.parametrize(
    ("stamps", "made_up"),
    [
        (even(30.0), False),  # a camera may well be that even
        (even(29.97), False),
        (even(26.3), True),  # no camera runs at that rate
        (np.round(even(26.3), 3), False),  # real stamps in whole milliseconds are not even
        (even(26.3) + 0.001 * np.random.default_rng(0).normal(size=100), False),
        (np.delete(even(30.0), [20, 50, 51]), False),
        (even(26.3)[:8], False),  # too few to tell
    ],
    ids=["30", "29.97", "26.3", "ms", "jitter", "dropped", "few"],
)
def test_stamps_that_somebody_made_up(stamps: FloatArray, made_up: bool) -> None:
    assert synthetic_stamps(stamps) is made_up


def found_clock(recording: Recording) -> Clock:
    """The clock of a recording's excerpts."""
    recording, coarse, _ = pair(recording)
    segments = [reject_by_camera(segment) for segment in split_into_segments(recording, 0)]
    (clock,) = self_calibrate(segments, ArmCalibration(), ALONE, Pool(1, 0)).clocks
    return clock.after(coarse)


@pytest.mark.slow
def test_a_clock_that_runs_fast() -> None:
    """300 ppm over five minutes: 9 cs, three frames; followed also beyond the blocks looked at.

    A constant would be 4.5 cs off at both ends.
    """
    made, skew = moving(1, "white", 300.0), 300e-6
    t = made.recording.arm.t_s
    clock = found_clock(later(made, -skew * t))
    error = clock.at(t * (1.0 + skew)) + skew * t
    assert clock.skew == pytest.approx(-300e-6, abs=10e-6)  # found: within 3e-6
    assert np.sqrt(np.mean(error**2)) < 0.002
    assert np.abs(error).max() < 0.004


@pytest.mark.slow
def test_no_drift_is_invented(realistic_arms: list[Scene]) -> None:
    """Biases, correlated noise, wobble and jitter, and a camera that is late by a constant 20 ms."""
    for scene in realistic_arms:
        offset = scene.recovery.arm.t_s - scene.recording.arm.t_s
        assert np.ptp(offset) < 0.002
        assert offset.mean() == pytest.approx(-0.020, abs=0.003)


def test_made_up_stamps_are_as_uncertain_as_a_dropped_frame() -> None:
    """Frames lost and the rest spread evenly, as a published data set has it: the sigma says so."""
    made = moving(2, "white", 40.0, dropped_frames=0.1)
    t = made.recording.arm.t_s
    spread = np.linspace(t[0], t[-1], len(t))
    assert synthetic_stamps(spread)
    clock = found_clock(later(made, t - spread))
    left, unmended = (float(np.sqrt(np.mean(x**2))) for x in (spread + clock.at(spread) - t, spread - t))
    assert clock.local_sigma_s >= SYNTHETIC_SIGMA_S
    assert left < 0.7 * unmended and left < 3 * clock.local_sigma_s


def with_gaps(duration_s: float) -> SimulatedArm:
    often = {"occlusion_lengths_s": (2.0,), "occlusion_every_s": 10.0}
    return moving(4, "white", duration_s, imu_rate_hz=80.0, **often)


@pytest.fixture
def short() -> SimulatedArm:
    return with_gaps(60.0)


@pytest.fixture
def long() -> SimulatedArm:
    return with_gaps(330.0)


def later(made: SimulatedArm, offset_s: FloatArray | float) -> Recording:
    """The camera's stamps are early by so much, (F,)."""
    arm = made.recording.arm
    return replace(made.recording, arm=replace(arm, t_s=arm.t_s - offset_s))


def rms_in_gaps_m(made: SimulatedArm, recovery: Recovery) -> float:
    return validate(recovery, made.recording.truth).occluded.position_rms_m


@pytest.mark.slow
@pytest.mark.parametrize("offset_s", [2.5, -7.0])
def test_seconds_apart(short: SimulatedArm, offset_s: float) -> None:
    recovery = answer(later(short, offset_s))
    assert recovery.clock_offset_s == pytest.approx(offset_s, abs=0.003)
    assert rms_in_gaps_m(short, recovery) < 0.01
    assert any("apart" in note for note in recovery.notes)


@pytest.mark.slow
def test_within_reach_nothing_is_moved_and_minutes_apart_more_is_looked_at(
    short: SimulatedArm, long: SimulatedArm
) -> None:
    for made in (short, long):
        recording, coarse, _ = pair(later(made, 0.1))
        assert coarse is None
        np.testing.assert_array_equal(recording.arm.t_s, made.recording.arm.t_s - 0.1)
    _, coarse = find_pairing(later(long, 75.0))  # farther than the context of the blocks
    assert coarse.mean_s == pytest.approx(75.0, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("offset", "most_s"),
    [
        # 1200 ppm over 330 s: 0.4 s, as 20 of them are in 6 hours; and 1 s to begin with
        (lambda t: 1.0 + 1.2e-3 * t, 0.003),
        # ten milliseconds to and fro, which the few blocks cannot see: a line leaves 4.5 ms rms
        (lambda t: 0.02 + 0.01 * np.sin(2 * np.pi * t / 330.0), 0.003),
    ],
    ids=["drifts far", "wanders between the blocks"],
)
def test_clocks_that_drift_and_wander(
    long: SimulatedArm, offset: Callable[[FloatArray], FloatArray], most_s: float
) -> None:
    offset_s = offset(long.recording.arm.t_s)
    recording = later(long, offset_s)
    if np.ptp(offset_s) > 0.1:
        assert find_pairing(recording)[1].skew == pytest.approx(1.2e-3, abs=2e-4)
    recovery = answer(recording)
    error = recovery.arm.t_s - recording.arm.t_s - offset_s
    assert np.sqrt(np.mean(error**2)) < most_s
    assert np.ptp(offset_s) < 0.1 or np.abs(error).max() < most_s
    assert rms_in_gaps_m(long, recovery) < 0.01


def apart(preset: str, duration_s: float, seed: int, offset_s: float) -> tuple[Recording, float]:
    """A recording whose camera is early by so much more, and its true offset."""
    made = moving(seed, preset, duration_s)
    return later(made, offset_s), offset_s + made.parameters["clock_offset_s"]


@pytest.mark.slow
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
    moved, clock, _ = pair(recording, None, measured)
    assert clock is measured
    t = recording.arm.t_s
    np.testing.assert_allclose(moved.arm.t_s, t + true_s + 1e-4 * (t - 10.0), atol=1e-12)


@pytest.mark.slow
def test_a_measured_clock_is_a_prior() -> None:
    recording, true_s = apart("realistic", 24.0, 2, 3.0)
    free = answer(recording)
    given = answer(recording, clock=constant_clock(true_s, 0.001))
    assert abs(given.clock_offset_s - true_s) < 0.002  # the joints' lag is a ms or two
    assert given.clock_offset_sigma_s < min(0.001, free.clock_offset_sigma_s)
    weak = answer(recording, clock=constant_clock(true_s + 0.05, 0.15))
    assert weak.clock_offset_s == pytest.approx(free.clock_offset_s, abs=0.003)


@pytest.mark.parametrize(("seconds", "seed"), [(12.0, 31), (20.0, 1)])
def test_speeds_that_agree_by_chance(seconds: float, seed: int) -> None:
    """A second off the two speeds agree clearly, but not the directions in which the forearm turns."""
    made = moving(seed, "realistic", seconds, occlusion_lengths_s=(1.0,), occlusion_every_s=6.0)
    assert coarse_offset(made.recording, LARGEST_OFFSET_S) == 0.0
    assert coarse_offset(later(made, 2.0), LARGEST_OFFSET_S) == pytest.approx(2.0, abs=0.1)
