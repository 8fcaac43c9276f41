"""Agreement, lag, angles of truth and answer at other times; what is called a change; published examples."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from arms import make_joint_truth, make_recording, make_recovery, make_truth, path, turn
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration
from smoother.evaluation.metrics import truth_at
from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNCLEAR,
    UNKNOWN,
    PersonProgress,
    Series,
    SessionValue,
    change_between,
    reliability_of,
    together,
    without_like_movements,
)
from smoother.evaluation.reference import ReferenceAlignment
from smoother.evaluation.statistics import (
    agreement,
    detectable_change,
    icc_a1,
    mean_squares,
    memory,
    sem_agreement,
    unwound_deg,
)
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


class TestValidation:
    @pytest.fixture(scope="class")
    @staticmethod
    def found():
        recovery = make_recovery(make_recording(), error_m=0.004, sigma_m=0.004)
        recovery = replace(
            recovery, calibration=replace(recovery.calibration or ArmCalibration(), R_F_A=np.eye(3))
        )
        return validate(recovery, make_joint_truth(np.arange(0, 20, 0.01)))

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
        truth = make_joint_truth(np.arange(0, 20, 0.01))
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
        truth = make_joint_truth(t)
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


def test_score_needs_both_neighbours():
    t = np.arange(0, 1, 0.1)
    score = np.arange(10) < 5
    truth = Truth(t, path(t), turn(t).as_quat(scalar_first=True), score)
    assert truth_at(truth, np.array([0.35, 0.4, 0.45, 0.55])).score.tolist() == [True, True, False, False]


def test_holes_and_stamps_as_files_have_them():
    t = np.delete(np.arange(0, 1, 0.02), [20, 21, 22])  # a short hole is bridged
    read = truth_at(make_truth(t), np.array([0.42]))
    np.testing.assert_allclose(read.position, path(np.array([0.42])), atol=1e-5)
    read = truth_at(make_truth(t), np.array([-4e-7, t[-1] + 4e-7]))  # rounded in a text file
    assert np.isfinite(read.position).all() and read.score.all()
    empty = Truth(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, bool))
    assert np.isnan(truth_at(empty, np.array([0.0])).position).all()
    twice = np.array([0.0, 0.02, 0.02, 0.04, 0.06, 0.08])
    assert np.isfinite(truth_at(make_truth(twice), np.array([0.03])).position).all()


def value(
    number: float, sigma: float = 2.0, draws: int = 64, session: str = "1", **more: float
) -> SessionValue:
    low, high = number - 1.96 * sigma, number + 1.96 * sigma
    return SessionValue(session, 0.0, number, low, high, sigma, 0.2, draws, **more)


@pytest.mark.parametrize(
    ("first", "last", "mdc95", "word"),
    [
        (value(60), value(75), math.nan, MORE),
        (value(75), value(60), math.nan, LESS),
        (value(60), value(63), math.nan, UNCLEAR),
        (value(60), value(75), 20.0, UNCLEAR),  # larger than the interval, not than what can be detected
        (value(60), value(75), 5.0, MORE),
        (value(60), value(63), 10.0, UNCLEAR),
        (value(60, 20.0), value(75, 20.0), 5.0, UNKNOWN),  # five would matter, fifty would be seen
        (value(60), value(math.nan), math.nan, UNKNOWN),
        (value(60, math.nan, 0), value(75), math.nan, UNKNOWN),
    ],
)
def test_words(first: SessionValue, last: SessionValue, mdc95: float, word: str):
    change = change_between(first, last, mdc95)
    assert change.word == word
    assert change.limits or word in (MORE, LESS, UNCLEAR)
    if word in (MORE, LESS):
        assert change.low * change.high > 0 and change.detectable < abs(change.difference)


def test_no_draws_is_said():
    change = change_between(value(60, math.nan, 0), value(75), 5.0)
    assert math.isnan(change.p)
    # a measure without an interval does not show whether none or too few motions were drawn
    assert "without drawn motions, or they are too few (20 are needed, --draws 64)" in change.limits[0]
    change = change_between(value(60), SessionValue("4", 30.0, math.nan, note="no hand"), math.nan)
    assert change.limits == ("session 4 has no value (no hand)",)


def test_what_rests_on_recovered_samples_is_said():
    change = change_between(value(60), replace(value(61), recovered_share=0.7))
    assert change.limits == ("more than half of session 1 comes from recovered samples",)


@pytest.mark.slow
@pytest.mark.parametrize("draws", [6, 20, 64])
def test_false_alarms_are_one_in_twenty(draws: int):
    """Two sessions of an unchanged arm, each with the sigma that so many draws estimate."""
    rng = np.random.default_rng(draws)
    tries, alarms = 4000, 0
    for _ in range(tries):
        values = []
        for sigma in (2.0, 3.0):
            number = 60 + rng.normal(0, sigma)
            estimate = float(np.std(number + rng.normal(0, sigma, draws), ddof=1))
            values.append(SessionValue("s", 0.0, number, math.nan, math.nan, estimate, 0.1, draws))
        alarms += change_between(*values).word in (MORE, LESS)
    # Welch's approximation and 3 sigmas of a share of 0.05 over 4000
    assert alarms / tries == pytest.approx(0.05, abs=0.011)


def test_an_interval_to_one_side_counts_as_error():
    lopsided = SessionValue("1", 0.0, 60.0, 59.9, 72.0, 3.0, 0.1, 64)
    assert lopsided.spread == pytest.approx(12 / 1.96, rel=1e-3)
    assert change_between(lopsided, value(72)).word == UNCLEAR
    outside = change_between(SessionValue("1", 0.0, 60.0, 61.0, 66.0, 1.0, 0.1, 64), value(62))
    assert "session 1: the value lies outside its own interval" in outside.limits


def test_counts_on_which_all_draws_agree():
    def reached(number: float, draws: int = 64) -> SessionValue:
        return SessionValue("1", 0.0, number, number, number, 0.0, 0.1, draws)

    assert change_between(reached(0), reached(1)).word == MORE
    assert change_between(reached(1), reached(1)).word == UNCLEAR
    assert change_between(reached(0, 20), reached(1, 20)).word == UNCLEAR  # too few draws to be sure


@pytest.mark.parametrize(
    ("counts", "shares", "reason"),
    [
        (((5, 5, 5), (5, 5, 5)), (0.2, 0.2), ""),
        (((10, 10, 10), (9, 9, 10)), (0.2, 0.2), ""),
        (((11, 11, 13), (13, 12, 14)), (0.2, 0.2), r"11 \(11 to 13\) and 13 \(12 to 14\)"),
        (((3, 3, 3), (2, 2, 2)), (0.2, 0.2), "have 3 and 2 movements"),
        (((5, 4, 7), (5, 5, 5)), (0.2, 0.2), r"5 \(4 to 7\) and 5"),  # the same number, but found by luck
        (((5, math.nan, math.nan), (5, 5, 5)), (0.2, 0.2), ""),
        (((math.nan,) * 3, (2, 2, 2)), (0.2, 0.2), "not known"),
        ((None, (2, 2, 2)), (0.2, 0.2), "not known"),
        (((5, 5, 5), (5, 5, 5)), (0.0, 0.8), "0 % .* 80 %"),
    ],
)
def test_means_over_other_movements(
    counts: tuple[tuple[float, float, float] | None, ...], shares: tuple[float, float], reason: str
):
    first, last = (
        None if count is None else SessionValue("1", 0.0, *map(float, count), 0.0, 0.2, 64)
        for count in counts
    )
    sessions = (replace(value(v), recovered_share=share) for v, share in zip((60, 75), shares, strict=True))
    before = change_between(*sessions)
    change = without_like_movements(before, first, last)
    if not reason:
        assert change == before and change.word == MORE
    else:
        assert change.word == UNKNOWN and math.isnan(change.p) and math.isnan(change.difference)
        assert re.search(reason, change.limits[0])


def test_many_comparisons_together():
    changes = [replace(change_between(value(60), value(60)), p=p) for p in (0.01, math.nan, 0.04, 0.03)]
    # Holm's steps by hand: 3 x 0.01, then max(., 2 x 0.03), then max(., 1 x 0.04)
    assert together(changes) == pytest.approx([0.03, math.nan, 0.06, 0.06], nan_ok=True)


#: Bland and Altman, Lancet 1986, table 1: first readings, l/min, of a Wright and a mini Wright meter.
WRIGHT = np.array(
    [494, 395, 516, 434, 476, 557, 413, 442, 650, 433, 417, 656, 267, 478, 178, 423, 427], dtype=float
)
MINI = np.array(
    [512, 430, 520, 428, 500, 600, 364, 380, 658, 445, 432, 626, 260, 477, 259, 350, 451], dtype=float
)
#: Weir, J Strength Cond Res 2005, data set A: two trials of eight subjects.
WEIR_A = np.array(
    [[146, 140], [148, 152], [170, 152], [90, 99], [157, 145], [156, 153], [176, 167], [205, 218]],
    dtype=float,
)


def test_limits_of_agreement_of_the_published_example():
    found = agreement(WRIGHT, MINI)
    # the paper takes 2 standard deviations of 38.8 (-79.7 and 75.5), this 1.96
    assert found["bias"] == pytest.approx(-2.1, abs=0.05)
    assert found["limits_low"] == pytest.approx(-79.7 + 0.04 * 38.8, abs=0.1)
    assert found["limits_high"] == pytest.approx(75.5 - 0.04 * 38.8, abs=0.1)


def test_error_and_minimal_difference_of_weirs_example():
    sem = float(np.sqrt(mean_squares(WEIR_A)[2]))
    assert sem == pytest.approx(7.6, abs=0.05)  # page 236
    assert detectable_change(sem) == pytest.approx(21, abs=0.5)  # 7.6 x 1.96 x sqrt 2
    assert icc_a1(WEIR_A)[0] == pytest.approx(0.95, abs=0.005)  # page 234, ICC(2,1)


#: Shrout and Fleiss (1979), table 2: six targets by four judges.
RATINGS = np.array(
    [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float
)
FLEXION = "elbow_flexion_range_deg"


def test_the_example_of_shrout_and_fleiss():
    """Their table 4 has ICC(2,1) = 0.29."""
    assert round(icc_a1(RATINGS)[0], 2) == 0.29
    # intervals as R's psych::ICC prints them of the same table
    np.testing.assert_allclose(icc_a1(RATINGS)[1:], (0.019, 0.761), atol=6e-4)
    # mean squares of their table 3: between judges 32.49, error 1.02
    assert sem_agreement(RATINGS) == pytest.approx(np.sqrt((32.49 - 1.02) / 6 + 1.02), abs=0.01)


def progress_over(values: np.ndarray, sessions: tuple[str, ...]) -> list[PersonProgress]:
    persons = []
    for row, each in enumerate(values):
        found = tuple(SessionValue(name, 0.0, value) for name, value in zip(sessions, each, strict=True))
        series = Series(f"p{row}", "right", "", FLEXION, "elbow flexion", "deg", found)
        persons.append(PersonProgress(f"p{row}", sessions, (0.0,) * len(sessions), (series,)))
    return persons


def test_who_takes_part():
    assert sem_agreement(np.ones((3, 2))) == 0.0
    values = np.arange(8.0).reshape(4, 2)
    assert reliability_of(progress_over(values[:2], ("a", "b"))) == []  # two persons
    assert reliability_of(progress_over(values[:, :1], ("a",))) == []  # one session
    values[0, 1] = np.nan
    (one,) = reliability_of(progress_over(values, ("a", "b")))
    assert one["persons"] == 3
    assert one["sdc"] == detectable_change(one["sem_agreement"])
