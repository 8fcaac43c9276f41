"""Visible stretches that are hidden, recovered and compared; sigma in gaps wider by a measured factor."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from made_results import recovery as made
from scenes import ALONE

from smoother import smooth
from smoother.calibration import SigmaFactor, SigmaFactors
from smoother.recovery.self_check import RAMP_S, HiddenStretch, summary, with_sigma_factors
from smoother.result import Draws, Recovery
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
    """The stretches are in visible time: no gap of the result is one of them."""
    made = simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=30.0), 5)
    tracked = made.recording.arm.forearm_tracked
    hidden_s = float((~tracked).sum()) / 30.0
    assert sum(gap.length_s for gap in recovery.gaps) < hidden_s + 0.15 * len(recovery.gaps) + 0.5


FACTORS = SigmaFactors((SigmaFactor(0.1, 1.5, 24), SigmaFactor(4.0, 2.5, 31)))


def test_positions_in_gaps_grow_and_the_rest_stays():
    before, after = made(), with_sigma_factors(made(), FACTORS)
    assert before.gaps and before.occluded.any()
    grown = np.sqrt(
        np.einsum("nii->ni", after.pose_covariance) / np.einsum("nii->ni", before.pose_covariance)
    )
    known, inside = np.isfinite(before.pose_covariance).all(axis=(1, 2)), np.zeros(len(before), bool)
    for gap in before.gaps:
        rows = (before.t_s >= gap.start_s) & (before.t_s <= gap.end_s) & before.occluded & known
        np.testing.assert_allclose(grown[rows, :3], FACTORS.at(gap.length_s), rtol=1e-4)
        inside |= rows
    np.testing.assert_allclose(grown[~inside & known], 1.0)
    np.testing.assert_allclose(grown[known, 3:], 1.0)
    for joint, covariance in after.joint_covariance.items():
        ratio = np.sqrt(covariance[inside, 0, 0] / before.joint_covariance[joint][inside, 0, 0])
        finite = ratio[np.isfinite(ratio)]
        assert (finite == 1.0).all() if joint == "shoulder" else (finite > 1.4).all()
    answered = np.isfinite(after.pose_covariance).all(axis=(1, 2))
    assert (np.linalg.eigvalsh(after.pose_covariance[answered]) > 0).all()


def test_drawn_motions_grow_as_much_and_do_not_jump():
    recovery = made()
    t = recovery.t_s[::4].copy()
    ones = np.ones((2, len(t), 3), np.float32)
    joints = {"elbow": ones.copy(), "shoulder": ones.copy()}
    drawn = replace(recovery, draws=Draws(t, 0, ones.copy(), ones.copy(), joints))
    draws = with_sigma_factors(drawn, FACTORS).draws
    assert draws is not None
    for gap in recovery.gaps:
        inside = (t >= gap.start_s) & (t <= gap.end_s)
        np.testing.assert_allclose(draws.position[:, inside], FACTORS.at(gap.length_s), rtol=1e-4)
    away = np.min([np.maximum(gap.start_s - t, t - gap.end_s) for gap in recovery.gaps], axis=0)
    np.testing.assert_array_equal(draws.position[:, away > RAMP_S], 1.0)
    assert np.abs(np.diff(draws.position, axis=1)).max() < 0.3  # of a factor of 2, over 0.3 s
    np.testing.assert_array_equal(draws.joints["elbow"], draws.position)
    assert (draws.joints["shoulder"] == 1.0).all() and (draws.rotation == 1.0).all()


def test_it_is_said():
    after = with_sigma_factors(made(), FACTORS)
    assert len(after.estimates.sigma_factors) == len(after.gaps)
    assert "sigma of positions in gaps was multiplied by" in after.notes[-1]
    assert "24 or more" in after.notes[-1]
    short = SigmaFactors((SigmaFactor(0.01, 1.2, 24),))
    assert "was hidden" in with_sigma_factors(made(), short).notes[-1]


def test_nothing_is_done_without_factors():
    recovery = made()
    assert with_sigma_factors(recovery, None) is recovery


@pytest.mark.parametrize(("length_s", "factor"), [(0.05, 1.5), (2.05, 2.0), (9.0, 2.5)])
def test_between_the_lengths_and_beyond(length_s: float, factor: float):
    assert FACTORS.at(length_s) == pytest.approx(factor)
