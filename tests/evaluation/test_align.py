"""Reading the truth at other times."""

from __future__ import annotations

import numpy as np
from arms import make_truth, path, turn
from scipy.spatial.transform import Rotation

from smoother.evaluation.metrics import linear_at, truth_at
from smoother.recording import Truth


def test_between_samples_the_truth_is_the_motion():
    t = np.arange(0, 5, 0.02)
    at = np.linspace(0.5, 4.5, 333)
    read = truth_at(make_truth(t), at)
    np.testing.assert_allclose(read.position, path(at), atol=1e-6)
    apart = Rotation.from_quat(read.quaternion, scalar_first=True).inv() * turn(at)
    assert np.degrees(apart.magnitude()).max() < 0.01
    assert read.score.all()


def test_nothing_beyond_the_ends_or_across_holes_or_nan():
    t = np.arange(0, 4, 0.02)
    truth = make_truth(t)
    keep = (t < 1.0) | (t > 1.15)  # a hole of more than 0.1 s
    position = truth.position[keep].copy()
    position[(t[keep] > 2.0) & (t[keep] < 2.5)] = np.nan
    holed = Truth(t[keep], position, truth.quaternion[keep], truth.score[keep])
    at = np.array([-0.01, 0.5, 1.05, 2.2, 3.0, 3.98, 4.0])
    read = truth_at(holed, at)
    assert np.isfinite(read.position).all(axis=1).tolist() == [False, True, False, False, True, True, False]
    # orientations were there while positions were not
    assert np.isfinite(read.quaternion).all(axis=1).tolist() == [False, True, False, True, True, True, False]


def test_short_hole_is_bridged():
    t = np.delete(np.arange(0, 1, 0.02), [20, 21, 22])
    read = truth_at(make_truth(t), np.array([0.42]))
    np.testing.assert_allclose(read.position, path(np.array([0.42])), atol=1e-5)


def test_score_needs_both_neighbours():
    t = np.arange(0, 1, 0.1)
    score = np.arange(10) < 5
    truth = Truth(t, path(t), turn(t).as_quat(scalar_first=True), score)
    assert truth_at(truth, np.array([0.35, 0.4, 0.45, 0.55])).score.tolist() == [True, True, False, False]


def test_stamps_through_a_text_file_still_match():
    t = np.arange(0, 1, 0.02)
    read = truth_at(make_truth(t), np.array([-4e-7, t[-1] + 4e-7]))
    assert np.isfinite(read.position).all()
    assert read.score.all()


def test_empty_unsorted_and_repeated_stamps():
    empty = Truth(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, bool))
    assert np.isnan(truth_at(empty, np.array([0.0])).position).all()
    t = np.array([0.0, 0.02, 0.02, 0.04, 0.06, 0.08])
    assert np.isfinite(truth_at(make_truth(t), np.array([0.03])).position).all()


def test_variances_stay_positive():
    t = np.arange(0, 1, 0.05)
    variance = np.where(np.arange(len(t)) % 7 == 0, 1.0, 1e-6)[:, None]
    assert (linear_at(t, variance, np.linspace(0, 0.9, 500)) > 0).all()
