"""Stated uncertainty against actual error: shares, bins, residuals, and the factor sigma must grow by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery
from scipy.stats import chi2

from calib.sigma_factor import (
    ENOUGH_GAPS,
    factor_sentences,
    hierarchical_quantile,
    length_factors,
    needed_factors,
)
from smoother.array_types import FloatArray
from smoother.evaluation.summary import camera_consistency, consistency
from smoother.recording import JOINTS
from smoother.result import Estimates


def test_errors_with_their_covariances() -> None:
    """Counted one by one; what is not finite is left out."""
    rng = np.random.default_rng(2)
    error, A = 3 * rng.normal(size=(60, 3)), rng.normal(size=(60, 3, 5))
    C = A @ np.swapaxes(A, 1, 2)
    error[2], C[4] = np.nan, np.nan
    found = consistency(error, C)
    rows = [k for k in range(60) if k not in (2, 4)]
    squared = np.array([error[k] @ np.linalg.solve(C[k], error[k]) for k in rows])
    assert found["samples"] == 58
    assert found["inside_50"] == pytest.approx(np.mean(squared <= chi2.ppf(0.5, 3)))
    assert found["inside_95"] == pytest.approx(np.mean(squared <= chi2.ppf(0.95, 3)))
    assert found["stated_m"] == pytest.approx(np.sqrt(np.mean([np.trace(C[k]) / 3 for k in rows])))
    assert found["actual_m"] == pytest.approx(np.sqrt(np.mean([error[k] @ error[k] / 3 for k in rows])))
    assert consistency(error[2:3], C[2:3])["inside_95"] is None


def test_camera_residuals_hold_the_noise_and_no_constant_error() -> None:
    made = make_recovery(make_recording())  # its residuals are white, 8 mm
    kept = made.residuals
    assert kept is not None and camera_consistency(made) == {}
    residual = kept.residual.copy()
    residual[:, JOINTS.index("wrist")] += [0.02, 0.0, 0.0]
    noise = dict.fromkeys(("elbow", "wrist", "hand", "strap"), 0.008)
    figures = {"camera_sigma_m": noise, "joint_bias_m": {"wrist": [0.02, 0.0, 0.0]}}
    covariance = {name: value for name, value in made.joint_covariance.items() if name != "hand"}
    covariance["elbow"] = np.where(made.t_s[:, None, None] < 5.0, np.nan, covariance["elbow"])
    made = replace(
        made,
        residuals=replace(kept, residual=residual),
        estimates=Estimates.from_plain(figures),
        joint_covariance=covariance,
    )
    found = camera_consistency(made)
    assert set(found) == {"elbow", "wrist"}, "nothing is stated of the hand, no strap was seen"
    assert found["elbow"]["samples"] == pytest.approx(0.75 * found["wrist"]["samples"], rel=0.02)
    for each in found.values():
        assert each["inside_95"] == pytest.approx(0.95, abs=0.03)
    assert camera_consistency(replace(made, residuals=None)) == {}


def spread(rng: np.random.Generator, count: int) -> FloatArray:
    """Covariances (count, 3, 3) with axes of their own, m^2."""
    root = 0.02 * rng.normal(size=(count, 3, 3)) + 0.01 * np.eye(3)
    return root @ np.swapaxes(root, 1, 2)


def test_the_factor_puts_the_error_on_the_regions_border():
    rng = np.random.default_rng(1)
    stated, noise = spread(rng, 200), np.diag([4e-6, 9e-6, 1e-6])
    error = 0.05 * rng.normal(size=(200, 3))
    factors = needed_factors(error, stated, noise)
    for column, level in enumerate((0.5, 0.95)):
        for row in np.flatnonzero(factors[:, column] > 1e-6):
            total = factors[row, column] ** 2 * stated[row] + noise
            squared = error[row] @ np.linalg.solve(total, error[row])
            assert squared == pytest.approx(chi2.ppf(level, 3), rel=1e-6)
    assert (factors > 1e-6).any()


def test_samples_without_an_answer_need_no_factor():
    stated = np.tile(1e-4 * np.eye(3), (3, 1, 1))
    stated[1] = np.nan
    stated[2, 0, 0] = -1.0
    error = np.array([[np.nan, 0.0, 0.0], [0.01, 0.0, 0.0], [0.01, 0.0, 0.0]])
    assert np.isnan(needed_factors(error, stated, np.zeros((3, 3)))).all()


def test_too_few_gaps_have_no_quantile():
    values = [np.array([float(k)]) for k in range(18)]
    assert hierarchical_quantile(values, 0.95) == np.inf
    assert hierarchical_quantile([*values, np.array([18.0])], 0.95) == 18.0


def gaps_like(rng: np.random.Generator, count: int, scale: float) -> list[FloatArray]:
    """Squared sigmas over the limit in gaps whose samples share their error: heavy tails from gap to gap."""
    errors = []
    for _ in range(count):
        own, samples = scale * rng.standard_t(4, size=3), int(rng.integers(5, 60))
        errors.append(own + 0.2 * scale * rng.normal(size=(samples, 3)))
    ends = np.cumsum([len(error) for error in errors])
    factors = needed_factors(np.concatenate(errors), np.tile(np.eye(3), (ends[-1], 1, 1)), np.zeros((3, 3)))
    return np.split(factors, ends[:-1])


@pytest.mark.slow
@pytest.mark.parametrize("count", [ENOUGH_GAPS, 40])
def test_coverage_of_the_next_gap_on_exchangeable_gaps(count: int):
    """Over 120 studies a sample of the next gap lies inside in 95 of 100 (standard error 2)."""
    rng = np.random.default_rng(count)
    inside, wrong = [], []
    for _ in range(120):
        groups = gaps_like(rng, count + 1, 1.7)
        row = length_factors([(1.0, group) for group in groups[:-1]])[0]
        inside.append(np.mean(groups[-1][:, 1] <= row.factor_95))
        samples = np.concatenate([group[:, 1] for group in groups[:-1]])
        wrong.append(np.mean(groups[-1][:, 1] <= np.quantile(samples, 0.95)))
    assert 0.925 <= np.mean(inside) <= 0.99
    assert np.mean(wrong) < np.mean(inside)  # samples treated as if each stood for itself


def test_lengths_with_few_gaps_are_taken_together():
    rng = np.random.default_rng(2)
    gaps = [(0.5, group) for group in gaps_like(rng, 25, 1.0)]
    gaps += [(3.0, group) for group in gaps_like(rng, 4, 3.0)]
    short, long = length_factors(gaps)
    assert (short.count, short.pooled, long.count, long.pooled) == (25, False, 29, True)
    assert long.factor_95 > short.factor_95


def test_few_gaps_take_the_largest_and_say_what_it_holds():
    (row,) = length_factors([(1.0, group) for group in gaps_like(np.random.default_rng(3), 4, 2.0)])
    assert row.level == pytest.approx(0.8)
    assert np.isfinite(row.factor)
    assert any("4 gaps are too few" in sentence for sentence in factor_sentences([row]))


def test_below_one_only_on_firm_evidence():
    rng = np.random.default_rng(4)
    few = length_factors([(1.0, group) for group in gaps_like(rng, 30, 0.2)])[0]
    many = length_factors([(1.0, group) for group in gaps_like(rng, 200, 0.2)])[0]
    assert few.factor_95 < 1.0 and few.factor == 1.0
    assert many.factor_95 <= many.factor < 1.0


def test_gaps_without_an_answer_count_for_nothing():
    nothing = np.full((4, 2), np.nan)
    assert length_factors([(1.0, nothing)]) == ()
    assert factor_sentences(()) == []
    (row,) = length_factors([(1.0, nothing), *((1.0, g) for g in gaps_like(np.random.default_rng(5), 3, 1))])
    assert row.count == 3
