"""Visible stretches that are hidden, recovered and compared."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE

from smoother import smooth
from smoother.recovery.self_check import HiddenStretch, summary
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm


def stretch(nees: float, rms_m: float = 0.02, samples: int = 30) -> HiddenStretch:
    stated_m = rms_m / max(np.sqrt(nees), 1e-3)
    errors = (rms_m,) * samples
    return HiddenStretch(0.0, 1.0, samples, rms_m, stated_m, samples, nees, errors, 1.6 * stated_m)


def test_failed_stretches_are_counted_and_the_worst_is_kept() -> None:
    check = summary([stretch(1.0), stretch(0.8), HiddenStretch(3.0, 4.0), stretch(30.0, 0.2)])
    assert (check.stretches, check.unanswered, check.failed) == (4, 1, 2)
    assert check.worst_nees == 30.0
    assert check.sigma_factor == 1.0  # four say nothing of sigma


def test_an_over_confident_sigma_is_widened_by_what_is_no_chance() -> None:
    rng = np.random.default_rng(3)
    sound = [stretch(float(value)) for value in rng.chisquare(3, 12) / 3.0]
    assert summary(sound).sigma_factor == pytest.approx(1.0, abs=0.15)
    bold = [stretch(4.0 * float(value)) for value in rng.chisquare(3, 12) / 3.0]
    assert 1.3 < summary(bold).sigma_factor < 2.0


def test_the_95th_percentile_is_over_all_samples_and_so_is_what_was_stated_of_it() -> None:
    check = summary([stretch(1.0, 0.01, 60), stretch(1.0, 0.03, 30), HiddenStretch(3.0, 4.0)])
    assert check.error_95_m == pytest.approx(0.03)
    assert check.stated_95_m == pytest.approx(1.6 * np.sqrt((60 * 0.01**2 + 30 * 0.03**2) / 90))
    assert summary([stretch(1.0, 0.01, 97), stretch(1.0, 0.5, 3)]).error_95_m == pytest.approx(0.01)


def test_no_stretch_says_why() -> None:
    assert summary([]).note
    assert summary([]).stretches == 0


def test_a_large_error_within_its_sigma_is_no_contradiction() -> None:
    assert not stretch(1.0, 0.2).failed
    assert not stretch(20.0, 0.03).contradicted  # three centimetres: sigma is too small, nothing is wrong
    assert stretch(20.0, 0.2).contradicted


@pytest.fixture(scope="module")
def recovery() -> Recovery:
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    return smooth(replace(made.recording, truth=None), config=ALONE)


def test_a_simulated_arm_proves_itself(recovery: Recovery) -> None:
    """Other seeds: 5 or 6 stretches, rms 1.6 to 2.4 cm with the camera's noise, NEES 0.4 to 1.4."""
    check = recovery.estimates.self_check
    assert check is not None
    assert 3 <= check.stretches <= 6
    assert check.failed == 0
    assert check.rms_m < 0.035
    assert 0.85 <= check.inside_95 <= 1.0
    assert 0.2 < check.worst_nees < 3.0
    assert 0.4 <= check.length_s <= 4.0
    json.dumps(recovery.estimates.plain())


def test_the_self_check_is_the_same_on_two_processes(recovery: Recovery) -> None:
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    again = smooth(replace(made.recording, truth=None), processes=2)
    assert again.estimates.self_check == recovery.estimates.self_check


def test_no_answer_depends_on_what_is_hidden_as_a_test(recovery: Recovery) -> None:
    """The stretches lie in visible time: no gap of the result is one of them."""
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    tracked = made.recording.arm.forearm_tracked
    hidden_s = float((~tracked).sum()) / 30.0
    assert sum(gap.length_s for gap in recovery.gaps) < hidden_s + 0.15 * len(recovery.gaps) + 0.5
