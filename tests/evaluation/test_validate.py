"""Validation against a truth; the metrics against slow, independent implementations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, make_truth
from scipy import stats
from scipy.spatial.transform import Rotation

from smoother.errors import RecordingError
from smoother.evaluation import metrics
from smoother.evaluation.validate import validate
from smoother.recording import Truth
from smoother.result import Recovery

KEYS = {
    "position_rms_m",
    "position_max_m",
    "orientation_rms_deg",
    "orientation_max_deg",
    "nees",
    "samples",
}


@pytest.fixture
def recovery() -> Recovery:
    return make_recovery(make_recording(), error_m=0.01, sigma_m=0.01)


def test_keys_and_an_honest_result(recovery):
    truth = make_truth(np.arange(0, 20, 0.01))
    figures = validate(recovery, truth).to_dict()
    assert set(figures) >= {"all", "occluded", "visible"}
    for part in ("all", "occluded", "visible"):
        assert set(figures[part]) >= KEYS
    assert figures["all"]["position_rms_m"] == pytest.approx(0.01 * np.sqrt(3), rel=0.05)
    assert figures["all"]["nees"] == pytest.approx(1.0, abs=0.1)
    assert figures["all"]["coverage_95"] == pytest.approx(0.95, abs=0.02)
    assert figures["all"]["orientation_rms_deg"] < 0.01
    assert figures["occluded"]["position_rms_m"] is None  # nothing was hidden
    assert figures["occluded"]["samples"] == 0
    assert figures["visible"]["samples"] == figures["all"]["samples"]


def test_slow_implementation(recovery):
    t = np.arange(3.001, 12.0, 0.017)
    occluded = (recovery.t_s > 5) & (recovery.t_s < 7)
    turned = Rotation.from_quat(recovery.quaternion, scalar_first=True) * Rotation.from_rotvec([0, 0.1, 0])
    recovery = replace(recovery, occluded=occluded, quaternion=turned.as_quat(scalar_first=True))
    truth = make_truth(t)
    got = validate(recovery, truth).to_dict()["occluded"]
    errors, squares = [], []
    for k in np.flatnonzero(occluded):
        at = recovery.t_s[k]
        reference = make_truth(np.array([at])).position[0]
        error = recovery.position[k] - reference
        errors.append(np.sqrt(error @ error))
        squares.append(error @ np.linalg.inv(recovery.pose_covariance[k, :3, :3]) @ error)
    assert got["samples"] == len(errors)
    assert got["position_rms_m"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-3)
    assert got["position_max_m"] == pytest.approx(max(errors), rel=1e-2)
    assert got["nees"] == pytest.approx(np.mean(squares) / 3, rel=1e-2)
    assert got["orientation_rms_deg"] == pytest.approx(np.degrees(0.1), rel=1e-3)


def test_score_is_respected(recovery):
    truth = make_truth(np.arange(0, 20, 0.01))
    half = replace(truth, score=truth.t_s < 10)
    assert validate(recovery, half).all.samples == pytest.approx(len(recovery) / 2, abs=2)


def test_truth_without_orientation_says_so(recovery):
    truth = make_truth(np.arange(0, 20, 0.01))
    bare = replace(truth, quaternion=np.full_like(truth.quaternion, np.nan))
    found = validate(recovery, bare)
    assert found.all.orientation_rms_deg is None
    assert any("orientation" in note for note in found.notes)


def test_no_covariance_no_nees(recovery):
    blank = replace(recovery, pose_covariance=np.full_like(recovery.pose_covariance, np.nan))
    found = validate(blank, make_truth(np.arange(0, 20, 0.01)))
    assert found.all.nees is None
    assert found.all.coverage_95 is None
    assert found.all.position_rms_m is not None


def test_unanswered_samples_are_counted(recovery):
    position = recovery.position.copy()
    position[100:200] = np.nan
    found = validate(replace(recovery, position=position), make_truth(np.arange(0, 20, 0.01)))
    assert found.all.unanswered == 100
    assert any("no answer" in note for note in found.notes)


def test_errors_are_sentences(recovery):
    with pytest.raises(RecordingError, match="do not overlap in time"):
        validate(recovery, make_truth(np.arange(100, 120, 0.01)))
    with pytest.raises(RecordingError, match=r"more than 0\.1 s apart"):
        validate(recovery, make_truth(np.arange(0.003, 20, 0.5)))
    t = np.arange(0, 20, 0.01)
    blank = Truth(t, np.full((len(t), 3), np.nan), np.full((len(t), 4), np.nan), np.ones(len(t), bool))
    with pytest.raises(RecordingError, match="no finite position"):
        validate(recovery, blank)
    with pytest.raises(RecordingError, match="to be scored"):
        validate(recovery, replace(make_truth(t), score=np.zeros(len(t), bool)))


def test_joints_that_the_truth_has_are_compared(recovery):
    t = np.arange(0, 20, 0.01)
    truth = make_truth(t)
    wrist = np.column_stack([np.interp(t, recovery.t_s, column) for column in recovery.joints["wrist"].T])
    found = validate(
        recovery, replace(truth, joints={"wrist": wrist + np.array([0.03, 0, 0]), "nose": wrist})
    )
    assert found.all.joint_rms_m == {"wrist": pytest.approx(0.03, rel=0.2)}
    assert found.to_dict()["all"]["joint_rms_m"]["wrist"] == found.all.joint_rms_m["wrist"]


def random_quaternions(count: int, seed: int) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_quat(scalar_first=True)


def test_orientation_error_is_the_published_measure():
    measured, gold = random_quaternions(50, 1), random_quaternions(50, 2)
    got = metrics.orientation_error_deg(measured, gold)
    for index in range(50):
        a = Rotation.from_quat(measured[index], scalar_first=True)
        b = Rotation.from_quat(gold[index], scalar_first=True)
        real = (a.inv() * b).as_quat(scalar_first=True)[0]
        published = math.acos(max(-1.0, min(1.0, real))) * 360 / math.pi
        published = min(published, 360 - published)
        assert got[index] == pytest.approx(published, abs=1e-6)
        assert got[index] == pytest.approx(math.degrees((a.inv() * b).magnitude()), abs=1e-9)


def test_orientation_error_keeps_tiny_angles_and_ignores_sign_and_norm():
    q = random_quaternions(1, 3)
    turned = (Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec([1e-9, 0, 0])).as_quat(
        scalar_first=True
    )
    assert metrics.orientation_error_deg(q, -2 * turned)[0] == pytest.approx(math.degrees(1e-9), rel=1e-3)
    assert metrics.orientation_error_deg(q, -q)[0] == 0.0
    assert np.isnan(metrics.orientation_error_deg(q, np.zeros((1, 4)))[0])
    assert np.isnan(metrics.orientation_error_deg(q, np.full((1, 4), np.nan))[0])


def test_position_error_row_by_row():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 20, 3))
    slow = [math.dist(x, y) for x, y in zip(a, b, strict=True)]
    np.testing.assert_allclose(metrics.position_error(a, b), slow)


def test_squared_sigmas_against_the_inverse():
    rng = np.random.default_rng(1)
    error = rng.normal(size=(30, 3))
    root = rng.normal(size=(30, 3, 3))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(3)
    slow = [float(e @ np.linalg.inv(P) @ e) for e, P in zip(error, covariance, strict=True)]
    np.testing.assert_allclose(metrics.squared_sigmas(error, covariance), slow, rtol=1e-8)


def test_squared_sigmas_without_a_usable_covariance_are_nan():
    covariance = np.array([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.eye(3)])
    squared = metrics.squared_sigmas(np.ones((4, 3)), covariance)
    assert np.isnan(squared[:3]).all()
    assert squared[3] == pytest.approx(3.0)


def test_nees_and_coverage_of_honest_errors():
    rng = np.random.default_rng(2)
    root = np.array([[0.02, 0, 0], [0.01, 0.03, 0], [0.0, -0.02, 0.01]])
    error = rng.normal(size=(40_000, 3)) @ root.T
    squared = metrics.squared_sigmas(error, np.repeat((root @ root.T)[None], len(error), axis=0))
    assert metrics.nees(squared) == pytest.approx(1.0, abs=0.02)
    assert metrics.coverage_95(squared) == pytest.approx(0.95, abs=0.005)
    overconfident = metrics.squared_sigmas(2 * error, np.repeat((root @ root.T)[None], len(error), axis=0))
    assert metrics.nees(overconfident) == pytest.approx(4.0, abs=0.1)


def test_chi_square_constant():
    assert pytest.approx(stats.chi2(3).ppf(0.95)) == metrics.CHI2_95_3


def test_summaries_leave_nan_out_and_say_none_for_nothing():
    values = np.array([3.0, np.nan, 4.0])
    assert metrics.rms(values) == pytest.approx(math.sqrt(12.5))
    assert metrics.maximum(values) == 4.0
    assert metrics.percentile(values, 50) == 3.5
    nothing = np.full(3, np.nan)
    for summary in (metrics.rms, metrics.maximum, metrics.nees, metrics.coverage_95):
        assert summary(nothing) is None
    assert metrics.percentile(nothing, 95) is None
    assert metrics.summarise(nothing, nothing, nothing).samples == 0
