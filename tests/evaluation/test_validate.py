"""Validation and comparison against a truth; metrics against slow implementations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arms import LEVERS, make_joint_truth, make_recording, make_recovery, make_truth, path, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from smoother.errors import RecordingError, SolveError
from smoother.evaluation import metrics
from smoother.evaluation.compare import compare
from smoother.evaluation.metrics import lag_s
from smoother.evaluation.mocap.motion import _exchanged
from smoother.evaluation.reference import read_truth, truth_notes
from smoother.evaluation.validate import validate
from smoother.recording import Recording, Truth
from smoother.result import Recovery

KEYS = {"nees", "samples", "position_rms_m", "position_max_m", "orientation_rms_deg", "orientation_max_deg"}


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
    blank = replace(recovery, pose_covariance=np.full_like(recovery.pose_covariance, np.nan))
    without = validate(blank, truth).to_dict()["all"]
    assert without["nees"] is None and without["coverage_95"] is None
    assert without["position_rms_m"] == figures["all"]["position_rms_m"]


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


def test_unanswered_samples_are_counted(recovery):
    position = recovery.position.copy()
    position[100:200] = np.nan
    found = validate(replace(recovery, position=position), make_truth(np.arange(0, 20, 0.01)))
    assert found.all.unanswered == 100
    assert any("no result" in note for note in found.notes)


def test_errors_are_sentences(recovery):
    with pytest.raises(RecordingError, match=r"100\.000 to 119\.990 s, the result covers 0\.000 to 19"):
        validate(recovery, make_truth(np.arange(100, 120, 0.01)))
    with pytest.raises(RecordingError, match=r"a sample every 0\.1 s"):
        validate(recovery, make_truth(np.arange(0.003, 20, 0.5)))
    t = np.arange(0, 20, 0.01)
    blank = Truth(t, np.full((len(t), 3), np.nan), np.full((len(t), 4), np.nan), np.ones(len(t), bool))
    with pytest.raises(RecordingError, match="has 0 positions to score"):
        validate(recovery, blank)
    with pytest.raises(RecordingError, match="has 0 positions to score"):
        validate(recovery, replace(make_truth(t), score=np.zeros(len(t), bool)))


def random_quaternions(count: int, seed: int) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_quat(scalar_first=True)


def turned_deg(answer: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return np.degrees(np.linalg.norm(metrics.rotation_error(answer, reference), axis=1))


def test_orientation_error_is_the_published_measure():
    measured, gold = random_quaternions(50, 1), random_quaternions(50, 2)
    got = turned_deg(measured, gold)
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
    assert turned_deg(q, -2 * turned)[0] == pytest.approx(math.degrees(1e-9), rel=1e-3)
    assert turned_deg(q, -q)[0] < 1e-9
    assert np.isnan(turned_deg(q, np.zeros((1, 4)))[0])
    assert np.isnan(turned_deg(q, np.full((1, 4), np.nan))[0])


def test_squared_sigmas_without_a_usable_covariance_are_nan():
    covariance = np.array([np.zeros((3, 3)), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.eye(3)])
    squared = metrics.squared_sigmas(np.ones((4, 3)), covariance)
    assert np.isnan(squared[:3]).all()
    assert squared[3] == pytest.approx(3.0)


def test_summaries_leave_nan_out_and_say_none_for_nothing():
    values = np.array([3.0, np.nan, 4.0])
    assert metrics.rms(values) == pytest.approx(math.sqrt(12.5))
    assert metrics.percentile(values, 50) == 3.5
    nothing = np.full(3, np.nan)
    for summary in (metrics.rms, metrics.nees, metrics.coverage_95):
        assert summary(nothing) is None
    assert metrics.percentile(nothing, 95) is None
    assert metrics.Errors.of_positions(np.full((3, 3), np.nan), nothing).figures().samples == 0


@pytest.fixture(scope="module")
def exact():
    return make_recovery(make_recording(6.0))


def write(path, truth, header="t_s,x,y,z,qw,qx,qy,qz", shift=0.0, orientation=True):
    lines = [header]
    for t, p, q in zip(truth.t_s, truth.position, truth.quaternion, strict=True):
        cells = [t + shift, *p, *q] if orientation else [t + shift, *p]
        lines.append(",".join(f"{cell:.9f}" for cell in cells))
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("header", ["t_s,x,y,z", "t_s, x, y, z, qw, qx, qy, qz"])
def test_orientation_missing_or_empty(tmp_path, exact, header):
    truth = make_truth(np.arange(0, 6, 0.01))
    path = write(tmp_path / "truth.csv", truth, header, orientation=False)
    if "qw" in header:
        text = path.read_text().splitlines()
        path.write_text("\ufeff" + "\r\n".join([text[0]] + [line + ",,,," for line in text[1:]]))
    found = validate(exact, read_truth(path, exact))
    assert found.all.orientation_rms_deg is None
    assert found.all.position_rms_m < 1e-5


def test_unix_times_and_relative_times(tmp_path, exact):
    truth = make_truth(np.arange(0, 6, 0.01))
    unix = replace(exact, origin_ns=1_700_000_000_000_000_000)
    path = write(tmp_path / "unix.csv", truth, shift=1.7e9)
    assert validate(unix, read_truth(path, unix)).all.position_rms_m < 1e-4
    path = write(tmp_path / "relative.csv", truth)
    assert validate(unix, read_truth(path, unix)).all.position_rms_m < 1e-5


T = np.arange(0, 60.0, 0.01)


def warped(t: np.ndarray) -> np.ndarray:
    """Movements that each begin up to a second earlier or later, so that no two have one rhythm."""
    return t + 1.0 * np.sin(1.7 * t)


def truth_of(t: np.ndarray, at: np.ndarray) -> Truth:
    quaternion = turn(at).as_quat(scalar_first=True)
    return Truth(t, path(at), quaternion, np.ones(len(t), dtype=bool))


@pytest.fixture(scope="module")
def truth() -> Truth:
    return truth_of(T, warped(T))


@pytest.fixture(scope="module")
def answer(truth):
    answer = make_recovery(make_recording(60.0, truth=False))
    at = warped(answer.t_s)
    noise = np.random.default_rng(0).normal(size=(len(at), 3)) * 0.004
    return replace(answer, position=path(at) + noise, quaternion=turn(at).as_quat(scalar_first=True))


def test_a_right_truth_needs_no_word(answer, truth):
    assert truth_notes(answer, truth) == []
    late = replace(truth, t_s=truth.t_s + 0.2)  # a lag that is stated as one
    assert truth_notes(answer, late) == []
    rest, level = np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0])
    still = replace(answer, position=0 * answer.position + rest, quaternion=0 * answer.quaternion + level)
    assert truth_notes(still, replace(truth, position=0 * truth.position + rest)) == []


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "millimetres"), (100.0, "centimetres")])
def test_another_unit(answer, truth, factor, unit):
    wrong = replace(truth, position=factor * truth.position)
    for aligned in (False, True):
        (note,) = truth_notes(answer, wrong, aligned)
        assert f"they look like {unit}; metres are needed" in note


def test_another_recording_or_clock(answer, truth):
    for wrong in (truth_of(T, T * 1.3), replace(truth, t_s=truth.t_s + 1.5)):
        (note,) = truth_notes(answer, wrong)
        assert "of another recording, or its clock differs; try --align" in note
        without = replace(wrong, quaternion=np.full_like(wrong.quaternion, np.nan))
        assert "another recording" in truth_notes(answer, without)[0]
    assert truth_notes(answer, truth_of(T, T * 1.3), aligned=True) == []


def test_another_order_of_the_quaternion(answer, truth):
    tilted = Rotation.from_euler("xyz", [0.4, 1.9, 0.8])
    mine = Rotation.from_quat(answer.quaternion, scalar_first=True) * tilted
    other = Rotation.from_quat(truth.quaternion, scalar_first=True) * tilted
    answer = replace(answer, quaternion=mine.as_quat(scalar_first=True))
    assert truth_notes(answer, replace(truth, quaternion=other.as_quat(scalar_first=True))) == []
    (note,) = truth_notes(answer, replace(truth, quaternion=other.as_quat(scalar_first=False)))
    assert "fits as qx, qy, qz, qw" in note


def test_other_axes(answer, truth):
    turned = Rotation.from_quat(truth.quaternion, scalar_first=True) * Rotation.from_euler("z", 90, True)
    (note,) = truth_notes(answer, replace(truth, quaternion=turned.as_quat(scalar_first=True)))
    assert "90 degrees (median) off by a constant turn: is the order qw, qx, qy, qz" in note
    (note,) = truth_notes(answer, replace(truth, position=truth.position + np.array([1.0, 0, 0])))
    assert "is 1.00 m (median) from it" in note and "--align" in note


def test_the_notes_stand_among_those_of_validate_and_compare(answer, truth):
    wrong = replace(truth, position=1000 * truth.position)
    assert any("millimetres" in note for note in validate(answer, wrong).to_dict()["notes"])
    recording = make_recording(60.0, truth=False)
    comparison = compare(recording, answer, wrong, {"graph": lambda _: answer})
    assert sum("millimetres" in note for note in comparison.to_dict()["notes"]) == 1


def test_markers_of_elbow_and_wrist_exchanged():
    """An elbow that bends between a still shoulder and a forearm of 25 cm."""
    bend = 1.0 + 0.8 * np.sin(T)
    elbow = np.tile([0.0, -0.3, 2.0], (len(T), 1))
    along = np.column_stack([np.sin(bend), -np.cos(bend), 0 * T])
    joints = {"shoulder": elbow + np.array([0, 0.3, 0]), "elbow": elbow, "wrist": elbow + 0.25 * along}
    swapped = {**joints, "elbow": joints["wrist"], "wrist": joints["elbow"]}
    hand = {"hand": elbow + 0.33 * along}
    assert _exchanged(joints) == _exchanged(joints | hand) == []
    (note,) = _exchanged(swapped)
    assert "exchanged" in note and "the upper arm's length changes by" in note
    (note,) = _exchanged({**swapped, **hand})
    assert "the hand is 8 cm from the elbow and 33 cm from the wrist" in note
    assert _exchanged({"wrist": joints["elbow"]}) == []


GAPS = ((4.0, 5.5), (9.0, 11.0), (15.0, 16.0))
LATE_S = 0.030


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Three gaps; the camera is 30 ms late (its clock shows more than the IMU's)."""
    made = make_recording(20.0, offset_s=-LATE_S, noise_m=0.004)
    t = made.arm.t_s
    hidden = np.any([(t > start) & (t < end) for start, end in GAPS], axis=0)
    return replace(made, arm=made.arm.hide(hidden), truth=None)


@pytest.fixture(scope="module")
def joint_truth() -> Truth:
    return make_joint_truth(np.arange(0.0, 20.0, 0.01))


def delayed(recovery: Recovery, late_s: float, only_in_gaps: bool = False) -> Recovery:
    """The recovery, late by so much."""
    t = recovery.t_s - late_s
    moved = path(t) + (recovery.position - path(recovery.t_s))
    if only_in_gaps:
        moved = np.where(recovery.occluded[:, None], moved, recovery.position)
    return replace(recovery, position=moved)


class TestCompare:
    @pytest.fixture(scope="class")
    @staticmethod
    def found(recording, joint_truth):
        def failing(_: Recording) -> Recovery:
            raise SolveError("it had no wish to")

        graph = make_recovery(recording, error_m=0.005, offset_s=-LATE_S)
        methods = {
            "broken": failing,
            "coarse": lambda r: make_recovery(r, error_m=0.05, offset_s=-LATE_S),
            "graph": lambda r: graph,
            "late": lambda r: delayed(graph, 0.040),
            "late in gaps": lambda r: delayed(graph, 0.025, only_in_gaps=True),
        }
        return compare(recording, graph, joint_truth, methods)

    def test_the_best_stands_first_and_a_failure_last(self, found):
        order = list(found.methods)
        known = [each for each in found.methods.values() if not isinstance(each, str)]
        errors = [each.figures_of(found.point, "occluded").position_rms_m for each in known]
        assert order[0] == "graph" and order[-1] == "broken"
        assert errors == sorted(errors)
        assert found.methods["broken"] == "it had no wish to"
        assert any("broken could not recover it" in note for note in found.of_graph.notes), "for the page"
        assert set(found.notes) <= set(found.of_graph.notes)
        # white noise of 5 mm per axis is 8.7 mm of distance; some 360 samples in the gaps
        assert errors[0] == pytest.approx(0.005 * np.sqrt(3), rel=0.1)

    def test_a_delay_is_found_to_a_few_milliseconds(self, found):
        known = {name: each for name, each in found.methods.items() if name != "broken"}
        lag = {name: (each.lag_s, each.lag_occluded_s) for name, each in known.items()}
        assert lag["graph"] == pytest.approx((0.0, 0.0), abs=0.002)
        assert lag["late"] == pytest.approx((0.040, 0.040), abs=0.002)
        assert lag["late in gaps"][1] == pytest.approx(0.025, abs=0.002)
        assert abs(lag["late in gaps"][0]) < 0.01

    def test_the_cameras_own_delay(self, found):
        assert set(found.camera_lag_s) == set(LEVERS)
        for lag in found.camera_lag_s.values():
            assert lag == pytest.approx(LATE_S, abs=0.002)
        plain = found.to_dict()["camera"]
        assert plain["latency_s"] == LATE_S and plain["clock_offset_sigma_s"] == 0.002
        assert "+30.0 +- 2.0 ms late" in found.camera_words

    def test_without_the_sensors_place_the_wrist_is_compared(self, recording, joint_truth):
        of_joints = replace(joint_truth, position=np.full_like(joint_truth.position, np.nan))
        graph = make_recovery(recording, error_m=0.005, offset_s=-LATE_S)
        found = compare(recording, graph, of_joints, {"graph": lambda r: graph})
        assert found.point == "wrist"
        (only,) = found.methods.values()
        assert only.figures_of("wrist", "all").position_rms_m == pytest.approx(0.0087, rel=0.1)
        assert only.lag_s == pytest.approx(0.0, abs=0.002)

    def test_a_truth_that_shares_nothing_is_refused(self, recording, joint_truth):
        graph = make_recovery(recording, offset_s=-LATE_S)
        shoulder = {"shoulder": np.tile([0.0, 0.3, 2.1], (len(joint_truth.t_s), 1))}
        blank = replace(joint_truth, position=np.full_like(joint_truth.position, np.nan), joints=shoulder)
        with pytest.raises(RecordingError, match="no position that the methods answer"):
            compare(recording, graph, blank, {"graph": lambda r: graph})


class TestLagLeft:
    t = np.arange(0.0, 20.0, 0.0125)

    @settings(max_examples=25, deadline=None)
    @given(late=st.floats(-0.3, 0.3))
    def test_between_samples(self, late):
        # straight lines between samples are off by 25 microns at most; the vertex of 2 ms steps by 0.1 ms
        found = lag_s(self.t[200:-200], path(self.t[200:-200] - late), path(self.t), self.t)
        assert found == pytest.approx(late, abs=3e-4)

    def test_shrunk_noisy_and_shifted_samples_keep_their_lag(self):
        rng = np.random.default_rng(3)
        samples = 0.7 * path(self.t - 0.05) + 0.1 + rng.normal(scale=0.02, size=(len(self.t), 3))
        assert lag_s(self.t, samples, path(self.t), self.t) == pytest.approx(0.05, abs=0.005)

    def test_nothing_where_nothing_can_be_told(self):
        known = path(self.t)
        assert lag_s(self.t, np.full_like(known, np.nan), known, self.t) is None
        assert lag_s(self.t, np.zeros_like(known), known, self.t) is None
        assert lag_s(self.t[:10], known[:10], known, self.t) is None
        assert lag_s(self.t, path(self.t - 1.2), known, self.t) is None  # beyond half a second
