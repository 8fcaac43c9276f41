"""Validation against a truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, make_truth
from scipy.spatial.transform import Rotation

from smoother.errors import RecordingError
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
