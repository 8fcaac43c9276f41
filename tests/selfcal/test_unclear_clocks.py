"""Clocks seconds apart where the speeds' correlation alone does not say so, and clocks that were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother import smooth
from smoother.config import Config
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock, constant_clock
from smoother.recording import Recording
from smoother.selfcal.clock_fit import ClockScore, refined_clock
from smoother.selfcal.pairing import coarse_offset, synchronise_coarsely
from smoother.simulation import ArmSimulation, simulate_arm

ALONE = Config.model_validate({"windows": {"processes": 1}})


def apart(preset: str, duration_s: float, seed: int, offset_s: float) -> tuple[Recording, float]:
    """A recording whose camera is early by so much more, and its true offset."""
    made = simulate_arm(ArmSimulation.preset(preset, protocol="random", duration_s=duration_s), seed)
    arm = replace(made.recording.arm, t_s=made.recording.arm.t_s - offset_s)
    return replace(made.recording, arm=arm, truth=None), offset_s + made.parameters["clock_offset_s"]


@pytest.mark.parametrize("preset", ["white", "realistic", "azure"])
@pytest.mark.parametrize(("duration_s", "offset_s"), [(24.0, 0.6), (32.0, -1.4), (45.0, 6.0), (60.0, -12.0)])
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
