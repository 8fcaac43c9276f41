"""Curves over a repetition: against every relabelling by hand, spm1d's figures, and shared errors."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.stats import ttest_1samp, ttest_ind

from smoother.evaluation.waveform_change import (
    CurveTest,
    SessionCurves,
    WaveformChange,
    of_group,
    one_sample,
    sentence,
    two_sessions,
)
from smoother.study.waveforms import shared_errors

NONE = np.empty((0, 51))


def curves(rng: np.random.Generator, count: int, bump: float = 0.0) -> np.ndarray:
    """Smooth noise about a repetition of an elbow; a bump at 60 %."""
    share = np.linspace(0, 1, 51)
    noise = rng.normal(size=(count, 6)) @ np.stack([np.cos(k * np.pi * share) for k in range(6)])
    return 60 + 40 * np.sin(np.pi * share) + 2.0 * noise + bump * np.exp(-((share - 0.6) ** 2) / 0.01)


def test_every_relabelling_by_hand():
    rng = np.random.default_rng(1)
    first, last = curves(rng, 4), curves(rng, 5, bump=12.0)
    found = two_sessions(SessionCurves(first, NONE), SessionCurves(last, NONE))
    both = np.concatenate([first, last])
    largest = []
    for chosen in combinations(range(9), 5):
        others = [each for each in range(9) if each not in chosen]
        largest.append(np.abs(ttest_ind(both[list(chosen)], both[others]).statistic).max())
    observed = ttest_ind(last, first).statistic
    np.testing.assert_allclose(found.statistic, observed, rtol=1e-9)
    assert found.is_exact and found.relabellings == 126
    assert found.p == pytest.approx(np.mean(np.array(largest) >= np.abs(observed).max() * (1 - 1e-9)))
    beyond = np.mean(np.array(largest) > found.threshold * (1 + 1e-9))
    assert beyond <= 0.05 < beyond + 2 / 126
    (stretch,) = found.stretches
    assert stretch.start_percent < 60 < stretch.end_percent and stretch.p == found.p
    assert stretch.difference == pytest.approx(np.abs(last.mean(0) - first.mean(0)).max())


def test_spm1d_finds_the_same():
    spm1d = pytest.importorskip("spm1d", reason="spm1d is not installed (a tool, not a dependency)")
    rng = np.random.default_rng(1)
    first, last = curves(rng, 5), curves(rng, 5, bump=12.0)
    found = two_sessions(SessionCurves(first, NONE), SessionCurves(last, NONE))
    theirs = spm1d.stats.nonparam.ttest2(last, first).inference(0.05, two_tailed=True, iterations=-1)
    np.testing.assert_allclose(found.statistic, theirs.z, rtol=1e-9)
    assert found.threshold == pytest.approx(theirs.zstar, rel=0.02)  # they interpolate between relabellings
    (cluster,), (stretch,) = theirs.clusters, found.stretches
    np.testing.assert_allclose(
        [2 * each for each in cluster.endpoints], [stretch.start_percent, stretch.end_percent], atol=2.0
    )


def test_signs_of_persons_by_hand():
    rng = np.random.default_rng(2)
    changes = curves(rng, 7) - curves(rng, 7) + 3.0
    found = one_sample(changes)
    np.testing.assert_allclose(found.statistic, ttest_1samp(changes, 0.0).statistic, rtol=1e-9)
    largest = [
        np.abs(ttest_1samp(changes * (1 - 2 * ((n >> np.arange(7)) & 1))[:, None], 0.0).statistic).max()
        for n in range(128)
    ]
    assert found.p == pytest.approx(np.mean(np.array(largest) >= np.abs(found.statistic).max() * (1 - 1e-9)))


def test_false_alarms_are_one_in_twenty():
    rng = np.random.default_rng(3)
    called = sum(
        two_sessions(SessionCurves(curves(rng, 6), NONE), SessionCurves(curves(rng, 6), NONE)).p < 0.05
        for _ in range(120)
    )
    assert called <= 13  # 6 expected; 13 or fewer in 99.6 of 100


def test_an_error_that_all_repetitions_share_is_no_change():
    """A calibration 4 degrees off in each session: without the draws every second pair would be called."""
    rng = np.random.default_rng(4)
    known, unknown = 0, 0
    error = 4.0 * np.ones((1, 51))
    for _ in range(30):
        first, last = (curves(rng, 6) + 4.0 * rng.normal() for _ in range(2))
        known += two_sessions(SessionCurves(first, error), SessionCurves(last, error)).p < 0.05
        unknown += two_sessions(SessionCurves(first, NONE), SessionCurves(last, NONE)).p < 0.05
    assert known <= 5 and unknown >= 12
    far = two_sessions(SessionCurves(first, error), SessionCurves(last + 60.0, error))
    assert far.p < 0.01 and not far.is_exact  # what no such error explains is found


def test_what_repetitions_share_is_told_from_what_they_do_not():
    rng = np.random.default_rng(6)
    shape = 1.0 + np.linspace(0, 1, 51)
    shared, single = rng.normal(size=(600, 1, 1)) * shape, rng.normal(size=(600, 5, 1))
    found = shared_errors(3.0 * shared + 2.0 * single * np.ones(51))
    np.testing.assert_allclose(np.sqrt((found**2).sum(axis=0)), 3.0 * shape, rtol=0.12)
    alone = shared_errors(2.0 * single * np.ones(51))
    assert np.sqrt((alone**2).sum(axis=0)).max() < 0.6 if len(alone) else True


def test_words_and_a_group():
    rng = np.random.default_rng(8)
    first, last = SessionCurves(curves(rng, 8), NONE), SessionCurves(curves(rng, 8, 15.0), NONE)
    change = WaveformChange("right", "", "elbow_flexion", "s1", "s2", first, last, two_sessions(first, last))
    assert "differs at" in sentence(change, "Curve") and "% (+1" in sentence(change, "Curve")
    same = CurveTest(np.zeros(51), 3.0, 0.4, (), 70, True)
    assert "no part" in sentence(WaveformChange(*["x"] * 5, first, first, same), "Curve")
    (together,) = of_group([change] * 7)
    assert together["persons"] == 7 and together["p"] == pytest.approx(2 / 128)
    assert of_group([change] * 5) == []
