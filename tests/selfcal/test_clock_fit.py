"""The camera's clock against the IMU's: the offset's model, and offsets found in simulated recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, Scene, arm
from scipy.stats import multivariate_normal

from calib.motion.motion_calibration import MotionCalibration, calibrate_motion
from smoother.array_types import FloatArray
from smoother.measurements.clock import OFFSET_SIGMA_S, Clock
from smoother.measurements.timestamps import synthetic_stamps
from smoother.recording import Recording
from smoother.selfcal.clock_fit import SYNTHETIC_SIGMA_S, _likeliest, _local_level


class Dense:
    """A random walk from an uncertain level, seen with noise: the joint Gaussian of all its values."""

    def __init__(self, t: FloatArray, variance: FloatArray, walk: float) -> None:
        since = t - t[0]
        self.level = OFFSET_SIGMA_S**2 + walk**2 * np.minimum(since[:, None], since)
        self.seen = self.level + np.diag(variance)

    def loglik(self, x: FloatArray) -> float:
        return float(multivariate_normal(np.zeros(len(x)), self.seen).logpdf(x))

    def smoothed(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        gain = self.level @ np.linalg.inv(self.seen)
        return gain @ x, np.diag(self.level - gain @ self.level)


def observations(seed: int, walk: float, count: int = 40) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(t, x, variance): uneven times, noise from 2 to 20 ms."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.5, 4.0, count))
    variance = rng.uniform(0.002, 0.02, count) ** 2
    level = 0.05 + np.cumsum(walk * np.sqrt(np.diff(t, prepend=t[0])) * rng.normal(size=count))
    return t, level + np.sqrt(variance) * rng.normal(size=count), variance


@pytest.mark.parametrize("walk", [0.0, 0.001, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_the_local_level_is_the_dense_gaussian(seed: int, walk: float) -> None:
    t, x, variance = observations(seed, walk)
    loglik, level, sigma, local = _local_level(t, x, variance, walk)
    dense = Dense(t, variance, walk)
    mean, spread = dense.smoothed(x)
    assert loglik - dense.loglik(x) == pytest.approx(0.5 * len(t) * np.log(2 * np.pi), abs=1e-8)
    np.testing.assert_allclose(level, mean, atol=1e-10)
    if walk == 0.0:
        assert sigma**2 == pytest.approx(spread[0], rel=1e-9)
    # local is what the wandering leaves open beyond the mean's own sigma
    assert local**2 == pytest.approx(max(float(spread.mean()) - sigma**2, 0.0), abs=1e-12)


def test_likelihoods_order_the_walks_as_the_dense_ones_do() -> None:
    t, x, variance = observations(7, 0.01)
    walks = np.array([0.0, 0.001, 0.003, 0.01, 0.04])
    ours = [_local_level(t, x, variance, walk)[0] for walk in walks]
    dense = [Dense(t, variance, walk).loglik(x) for walk in walks]
    np.testing.assert_allclose(np.diff(ours), np.diff(dense), atol=1e-8)


@pytest.mark.parametrize(("made_up", "most"), [(False, 0), (True, 3)])
def test_a_constant_offset_gets_no_walk(made_up: bool, most: int) -> None:
    """Twenty draws of noise about a constant; made-up stamps are suspected sooner."""
    walks = [_likeliest(*observations(seed, 0.0), made_up)[1] for seed in range(20)]
    assert np.count_nonzero(walks) <= most
    assert max(walks) <= 0.001


def test_a_wandering_offset_gets_its_walk() -> None:
    found = [_likeliest(*observations(seed, 0.02, 80), True)[1] for seed in range(5)]
    assert set(found) <= {0.01, 0.02, 0.04}


def test_a_clock_is_linear_between_knots_and_held_beyond() -> None:
    clock = Clock(np.array([1.0, 3.0]), np.array([0.01, 0.03]), 0.001)
    np.testing.assert_allclose(clock.at(np.array([0.0, 1.0, 2.0, 5.0])), [0.01, 0.01, 0.02, 0.03])
    assert clock.mean_s == pytest.approx(0.02)
    assert clock.drift_s == pytest.approx(0.02)


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


def calibrated(*recordings: Recording) -> MotionCalibration:
    return calibrate_motion([replace(each, truth=None) for each in recordings], None, ALONE)


@pytest.mark.parametrize(("latency_s", "seed"), [(-0.2, 0), (0.0, 2), (0.12, 3)])
def test_a_constant_offset(latency_s: float, seed: int) -> None:
    """Nothing calibrated, white noise: rms 0.8 ms over seeds, as sigma states; and no drift invented."""
    made = arm(seed, repetitions=1, latency_s=latency_s)
    (clock,) = calibrated(made.recording).self_calibration.clocks
    assert clock.mean_s == pytest.approx(-latency_s, abs=0.002)
    assert clock.drift_s < 0.001
    assert abs(clock.mean_s + latency_s) < 4 * clock.sigma_s


@pytest.fixture(scope="module")
def fast_clock() -> tuple[Clock, FloatArray, FloatArray]:
    """300 ppm over five minutes: 9 cs, three frames. The clock, frame times, and its errors there, s."""
    made, skew = arm(1, protocol="random", duration_s=300.0), 300e-6
    tracks = made.recording.arm
    warped = replace(made.recording, arm=replace(tracks, t_s=tracks.t_s * (1.0 + skew)))
    (clock,) = calibrated(warped).self_calibration.clocks
    return clock, warped.arm.t_s, clock.at(warped.arm.t_s) + skew * tracks.t_s


def test_a_clock_that_runs_fast(fast_clock: tuple[Clock, FloatArray, FloatArray]) -> None:
    """It is followed, also beyond the blocks looked at: a constant would be 4.5 cs off at both ends."""
    clock, _, error = fast_clock
    assert clock.skew == pytest.approx(-300e-6, abs=10e-6)  # found: within 3e-6
    assert np.sqrt(np.mean(error**2)) < 0.002
    assert np.abs(error).max() < 0.004


def test_no_drift_is_invented(realistic_arms: list[Scene]) -> None:
    """Biases, correlated noise, wobble and jitter, and a camera that is late by a constant 20 ms."""
    for scene in realistic_arms:
        offset = scene.recovery.arm.t_s - scene.recording.arm.t_s
        assert np.ptp(offset) < 0.002
        assert offset.mean() == pytest.approx(-0.020, abs=0.003)


def test_two_recordings_of_one_person() -> None:
    """An offset each, one set of lever arms; the second look makes the arm no worse than the first."""
    one, two = (arm(0, repetitions=1, latency_s=latency) for latency in (0.06, -0.11))
    found = calibrated(one.recording, two.recording)
    for offset, latency in zip(found.offsets, (0.06, -0.11), strict=True):
        assert offset.offset_s == pytest.approx(-latency, abs=0.0015)
    for joint, lever in found.calibration.lever_arms.items():
        error = lever.position_m - one.calibration.lever_arms[joint].position_m
        assert np.linalg.norm(error) < 0.008
    assert found.calibration.upper_arm is not None
    assert one.calibration.upper_arm is not None
    assert found.calibration.upper_arm.value_m == pytest.approx(one.calibration.upper_arm.value_m, abs=0.008)


def test_made_up_stamps_are_as_uncertain_as_a_dropped_frame() -> None:
    """Frames lost and the rest spread evenly, as a published data set has it: the sigma says so."""
    made = arm(2, protocol="random", duration_s=40.0, dropped_frames=0.1)
    tracks = made.recording.arm
    spread = np.linspace(tracks.t_s[0], tracks.t_s[-1], len(tracks))
    assert synthetic_stamps(spread)
    (clock,) = calibrated(replace(made.recording, arm=replace(tracks, t_s=spread))).self_calibration.clocks
    error = spread + clock.at(spread) - tracks.t_s
    unmended = spread - tracks.t_s
    assert clock.local_sigma_s >= SYNTHETIC_SIGMA_S
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.sqrt(np.mean(unmended**2))
    assert np.sqrt(np.mean(error**2)) < 3 * clock.local_sigma_s
