"""Sigma in gaps wider by a measured factor: what grows, what stays, what is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_results import recovery as made

from smoother.calibration import SigmaFactor, SigmaFactors
from smoother.recovery.self_check import RAMP_S, with_sigma_factors
from smoother.result import Draws

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
