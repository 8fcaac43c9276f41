"""Agreement, lag, angles of truth and answer at other times, table I."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, make_truth, path, turn
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration
from smoother.evaluation.metrics import truth_at
from smoother.evaluation.reference import ReferenceAlignment
from smoother.evaluation.statistics import agreement, icc_a1, memory, unwound_deg
from smoother.evaluation.validate import validate
from smoother.recording import Truth


def test_an_offset_costs_agreement_though_not_correlation():
    x = np.random.default_rng(1).normal(size=400) * 10
    found = agreement(x + 5.0, x)
    assert found["bias"] == pytest.approx(5)
    assert found["rmse"] == pytest.approx(5)
    assert found["limits_low"] == pytest.approx(5, abs=1e-9)
    assert found["icc"] == pytest.approx(1 - 12.5 / (x.var(ddof=1) + 12.5), abs=0.005)


def test_neighbours_in_time_widen_the_interval():
    rng = np.random.default_rng(3)
    white = rng.normal(size=4000)
    slow = np.convolve(white, np.ones(80) / np.sqrt(80), mode="same")
    assert memory(white) == pytest.approx(1, abs=0.2)
    assert memory(slow) == pytest.approx(80, rel=0.3)  # a boxcar's autocorrelation is a triangle
    noise = 0.5 * rng.normal(size=4000)
    quick, lazy = agreement(white + noise, white), agreement(slow + noise, slow)
    assert lazy["independent"] < quick["independent"] / 40
    assert lazy["icc_high"] - lazy["icc_low"] > 3 * (quick["icc_high"] - quick["icc_low"])


def test_angles_are_compared_the_short_way_round():
    true = np.array([170.0, 175.0, -179.0, -170.0] * 5)
    answer = np.array([172.0, -178.0, -175.0, -171.0] * 5)
    found = agreement(answer, true, degrees=True)
    assert found["bias"] == pytest.approx((2 + 7 + 4 - 1) / 4)
    assert np.ptp(unwound_deg(answer, true)[1]) < 30


def test_little_to_compare_is_none():
    found = agreement(np.array([1.0, np.nan]), np.array([1.0, 2.0]))
    assert found["rmse"] is None
    assert found["samples"] == 1
    assert icc_a1(np.ones((5, 2)))[0] is None


def _with_joints(t):
    truth = make_truth(t)
    joints = {name: path(t) + turn(t).apply(lever) for name, lever in LEVERS.items()}
    return replace(truth, joints={**joints, "shoulder": np.tile([0.0, 0.3, 2.1], (len(t), 1))})


class TestValidation:
    @pytest.fixture(scope="class")
    @staticmethod
    def found():
        recovery = make_recovery(make_recording(), error_m=0.004, sigma_m=0.004)
        recovery = replace(
            recovery, calibration=replace(recovery.calibration or ArmCalibration(), R_F_A=np.eye(3))
        )
        return validate(recovery, _with_joints(np.arange(0, 20, 0.01)))

    def test_joints_have_figures_of_their_own(self, found):
        points = found.to_dict()["points"]
        assert set(points) == {"shoulder", "elbow", "wrist", "hand"}
        for name in ("elbow", "wrist", "hand"):
            assert points[name]["all"]["position_rms_m"] == pytest.approx(0.004 * np.sqrt(3), rel=0.05)
            assert points[name]["all"]["nees"] == pytest.approx(1, abs=0.1)
            assert points[name]["occluded"]["position_rms_m"] is None
        assert points["shoulder"]["all"]["position_rms_m"] < 1e-9

    def test_angles_agree_and_the_lag_is_nil(self, found):
        angles = found.angles["all"]
        assert {"elbow_flexion", "pronation", "shoulder_elevation"} <= set(angles)
        assert "carrying" not in angles  # no epicondyles
        for name in ("elbow_flexion", "shoulder_elevation"):
            assert angles[name]["rmse"] < 2
            assert abs(angles[name]["bias"]) < 0.3
            assert angles[name]["icc"] > 0.98
        assert found.lag_s == pytest.approx(0, abs=1e-3)

    def test_bias_and_orientation_sigma(self):
        recovery = make_recovery(make_recording(), error_m=0.001)
        shifted = replace(recovery, position=recovery.position + np.array([0.01, -0.02, 0.03]))
        figures = validate(shifted, make_truth(np.arange(0, 20, 0.01))).all
        assert figures.position_bias_m == pytest.approx([0.01, -0.02, 0.03], abs=2e-4)
        assert figures.orientation_bias_deg == pytest.approx([0, 0, 0], abs=1e-3)
        assert figures.orientation_coverage_95 == 1.0

    def test_gap_by_gap(self):
        recording = make_recording()
        hidden = (recording.arm.t_s > 5) & (recording.arm.t_s < 6)
        recording = replace(recording, arm=recording.arm.hide(hidden))
        recovery = make_recovery(recording, error_m=0.01)
        found = validate(recovery, make_truth(np.arange(0, 20, 0.01)))
        ((gap, figures),) = found.gaps
        assert gap.start_s < 5.04
        assert figures.position_rms_m == pytest.approx(found.occluded.position_rms_m)
        assert found.to_dict()["gaps"][0]["start_s"] == gap.start_s

    def test_a_truth_of_joints_alone_will_do(self):
        truth = _with_joints(np.arange(0, 20, 0.01))
        bare = replace(
            truth,
            position=np.full_like(truth.position, np.nan),
            quaternion=np.full_like(truth.quaternion, np.nan),
        )
        found = validate(make_recovery(make_recording(), error_m=0.004), bare)
        assert found.all.position_rms_m is None
        assert found.points["wrist"]["all"].position_rms_m > 0.005
        assert any("joints are compared" in note for note in found.notes)

    def test_epicondyles_tell_the_truths_carrying_angle(self):
        t = np.arange(0, 20, 0.01)
        truth = _with_joints(t)
        up = truth.joints["shoulder"] - truth.joints["elbow"]
        along = truth.joints["elbow"] - truth.joints["wrist"]
        axis = np.cross(up, along)
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        # the humerus turned by 10 degrees about its own length
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        tilted = np.cos(np.radians(10)) * axis + np.sin(np.radians(10)) * np.cross(up, axis)
        expected = np.degrees(np.median(np.arcsin((along * tilted).sum(axis=1))))
        landmarks = {
            "medial_epicondyle": truth.joints["elbow"] - 0.04 * tilted,
            "lateral_epicondyle": truth.joints["elbow"] + 0.04 * tilted,
        }
        found = validate(make_recovery(make_recording()), truth, ReferenceAlignment(landmarks=landmarks))
        assert abs(expected) > 1
        assert found.carrying_truth_deg == pytest.approx(expected, abs=0.05)
        assert "carrying" not in found.angles["all"]


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
