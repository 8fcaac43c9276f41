"""`smooth` and `smooth_arms`: definitions, several arms, and recordings that give little."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import ALONE, OVER_CONFIDENT, Scene, answer, arm, blind, moving, point, recovered

import smoother
from smoother import Recoveries, smooth_arms, write_recovery
from smoother.errors import RecordingError, SolveError
from smoother.evaluation.validate import sample_errors
from smoother.linalg import interpolate
from smoother.measurements.segment import Timeline
from smoother.measurements.visibility import find_gaps, occluded_at
from smoother.recording import FOREARM_JOINTS, JOINTS, JointState, Recording
from smoother.recovery.samples import LINEAR_RAD, widen_turns
from smoother.result.draws import USUAL_DRAWS
from smoother.selfcal.excerpts import CONTEXT_S, WANTED, spread_excerpts
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_both_arms
from smoother.smoothing import smooth

FOREARM = [JOINTS.index(joint) for joint in FOREARM_JOINTS]


def test_gaps_and_the_occluded_column_are_those_of_the_streams(
    white_arms: list[Scene], white_point: Scene
) -> None:
    for scene in (*white_arms, white_point):
        recovery = scene.recovery
        np.testing.assert_array_equal(recovery.occluded, occluded_at(recovery.t_s, recovery.gaps))
        used, t = recovery.residuals.used[:, FOREARM], recovery.t_s
        needed = min(2, len(set(scene.recording.arm.present) & set(FOREARM_JOINTS)))
        seen = used.sum(axis=1) >= needed
        assert recovery.gaps == find_gaps(recovery.residuals.t_s, seen, t[0], t[-1])
        tracked = scene.recording.arm.state == JointState.TRACKED
        # white noise: hardly a tracked sample may be set aside (4 sigmas of three axes: 1 in 1000)
        assert not (recovery.residuals.used & ~tracked).any()
        assert recovery.residuals.used.sum() > 0.99 * tracked.sum()
        np.testing.assert_array_equal(recovery.t_s, scene.recording.imu.t_s)  # the IMU's own stamps
        np.testing.assert_allclose(np.linalg.norm(recovery.quaternion, axis=1), 1.0, atol=1e-9)
    for scene in white_arms:
        recovery, hidden = scene.recovery, scene.recording.arm.t_s[scene.made.occluded]
        assert len(recovery.gaps) == 4
        inside = [((hidden > gap.start_s) & (hidden < gap.end_s)) for gap in recovery.gaps]
        assert np.any(inside, axis=0).mean() > 0.99
        assert all(a.end_s < b.start_s for a, b in itertools.pairwise(recovery.gaps))
    arrays = recovery.to_arrays()
    assert {"t_s", "occluded", "imu", "imu_quaternion", "sigma", "sigma_deg", "elbow", "wrist"} <= set(arrays)
    assert all(len(values) == len(recovery) for values in arrays.values())


def test_progress_is_told() -> None:
    made, heard = point(2, duration_s=6.0, occlusion_lengths_s=()), []
    smooth(made.recording, None, ALONE, lambda *told: heard.append(told))
    fractions, texts = zip(*heard, strict=True)
    assert len(heard) >= 3 and all(texts)
    assert (np.diff(fractions) >= 0).all() and fractions[0] >= 0 and fractions[-1] == 1.0


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    both = simulate_both_arms(ArmSimulation(protocol="random", duration_s=10, occlusion_lengths_s=(0.8,)), 3)
    return [one.recording for one in both]


@pytest.fixture(scope="module")
def recovered_arms(recordings: list[Recording]) -> Recoveries:
    return smooth_arms(recordings, processes=1, draws=3, seed=5)


def test_each_arm_is_what_smooth_gives(
    recordings: list[Recording], recovered_arms: Recoveries, tmp_path: Path
) -> None:
    """Motions that were drawn beside it change nothing of the answer; each arm has its own."""
    assert recovered_arms.tags == ["right", "left"]
    write_recovery(smooth(recordings[1]), tmp_path / "alone.mcap")
    write_recovery(replace(recovered_arms["left"], draws=None), tmp_path / "together.mcap")
    assert (tmp_path / "alone.mcap").read_bytes() == (tmp_path / "together.mcap").read_bytes()
    for recording, recovery in zip(recordings, recovered_arms, strict=True):
        error = np.linalg.norm(recovery.position - recording.truth.position, axis=1)
        # 0.8 s gaps with white noise end in some millimetres; the other arm is decimetres away
        assert recovery.occluded.any() and error.max() < 0.04
    left, right = (recovered_arms[side].draws for side in ("left", "right"))
    assert len(left) == len(right) == 3 and left.seed == right.seed == 5
    count = min(len(left.t_s), len(right.t_s))
    a, b = left.position[:, :count].ravel(), right.position[:, :count].ravel()
    # the same numbers would give much the same errors in arms that move alike
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.5
    for function in (smooth_arms, smoother.smooth):
        assert inspect.signature(function).parameters["draws"].default == USUAL_DRAWS


@pytest.mark.slow
def test_side_by_side_gives_the_same(
    recordings: list[Recording], recovered_arms: Recoveries, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smoother.runtime.pool.WORTH_FRAMES", 10)
    seen: list[float] = []
    beside = smooth_arms(
        recordings, progress=lambda share, _: seen.append(share), processes=2, draws=3, seed=5
    )
    assert seen == [0.5, 1.0]
    for one, other in zip(recovered_arms, beside, strict=True):
        np.testing.assert_array_equal(one.pose_covariance, other.pose_covariance)
        np.testing.assert_array_equal(one.draws.joints["elbow"], other.draws.joints["elbow"])


def test_an_arm_that_cannot_be_solved_is_left_out(
    recordings: list[Recording], recovered_arms: Recoveries
) -> None:
    right, left = recordings
    state = np.full_like(left.arm.state, JointState.NOT_TRACKED)
    blind = replace(left, arm=replace(left.arm, state=state))
    found = smooth_arms([right, blind], processes=1, draws=0)
    assert found.tags == ["right"] and len(found.left_out) == 1
    assert "The left arm was left out" in found.left_out[0] and found.left_out[0] in found[0].notes
    np.testing.assert_array_equal(found["right"].position, recovered_arms["right"].position)
    with pytest.raises(SolveError, match="never tracked"):
        smooth_arms([blind], processes=1)
    with pytest.raises(RecordingError, match="at least one recording"):
        smooth_arms([])


OPEN_S = 2.0


@pytest.mark.parametrize("make", [arm, point])
def test_open_gaps_are_marked_and_sigma_covers_their_error(make: Callable[[int], SimulatedArm]) -> None:
    """The camera comes 2 s late and goes 2 s early: the farther out, the less sure."""
    made = make(1)
    t = made.recording.arm.t_s
    hidden = (t < t[0] + OPEN_S) | (t > t[-1] - OPEN_S)
    scene = recovered(made, replace(made.recording, arm=made.recording.arm.hide(hidden)))
    recovery, errors = scene.recovery, sample_errors(scene.recovery, scene.recording.truth)
    gaps, t, sigma = recovery.gaps, recovery.t_s, recovery.sigma_m.max(axis=1)
    opened = [(gap.open_start, gap.open_end) for gap in gaps]
    assert opened == [(True, False)] + [(False, False)] * (len(gaps) - 2) + [(False, True)]
    assert recovery.occluded[(t < gaps[0].end_s) | (t > gaps[-1].start_s)].all()
    for gap, border, outwards in ((gaps[0], gaps[0].end_s, -1), (gaps[-1], gaps[-1].start_s, 1)):
        along = np.interp(border + outwards * np.arange(0.0, OPEN_S - 0.1, 0.25), t, sigma)
        assert (np.diff(along) > 0).all() and along[-1] > 5 * along[0]
        inside = (t >= gap.start_s) & (t <= gap.end_s)
        assert np.mean(errors.squared_sigmas[inside]) / 3 < OVER_CONFIDENT
        # free integration from one side: 2 s cost up to 12 cm here, 17 to 33 on real data
        assert errors.distance_m[inside].max() < 0.30
    assert np.nanmax(errors.distance_m[(t > gaps[0].end_s) & (t < gaps[-1].start_s)]) < 0.02


def kept(recording: Recording, lost: np.ndarray) -> Recording:
    return replace(recording, imu=recording.imu.select(~lost))


@pytest.mark.slow
@pytest.mark.parametrize("in_gap", [False, True])
def test_a_pause_of_the_imu_splits_the_recording(in_gap: bool) -> None:
    """In visible time both sides are answered as well as ever; in a gap it leaves two open ones."""
    made = arm(1)
    t, gap = made.recording.imu.t_s, recovered(made).recovery.gaps[0]
    middle_s, half_s = (0.5 * (gap.start_s + gap.end_s), 0.2) if in_gap else (9.5, 0.5)
    scene = recovered(made, kept(made.recording, np.abs(t - middle_s) <= half_s))
    recovery = scene.recovery
    assert recovery.answered.all() and len(recovery) == (np.abs(t - middle_s) > half_s).sum()
    assert scene.validation.all.nees < OVER_CONFIDENT
    for each in recovery.gaps:  # none is said to reach over the pause
        assert each.end_s <= middle_s - half_s + 0.01 or each.start_s >= middle_s + half_s - 0.01
    opened = [(each.open_start, each.open_end) for each in recovery.gaps[:2]]
    assert opened == ([(False, True), (True, False)] if in_gap else [(False, False)] * 2)
    assert in_gap or scene.validation.occluded.position_max_m < 0.016


@pytest.mark.slow
def test_a_sensor_that_drops_out_again_and_again() -> None:
    """Its own place on the arm is hardly known, which sigma and verdict say; the joints are right."""
    made = moving(1, "white")
    scene = blind(made, kept(made.recording, np.mod(made.recording.imu.t_s, 1.0) <= 0.15))
    recovery, truth = scene.recovery, scene.recording.truth
    assert scene.validation.all.nees < 2.0
    assert any("drops out every" in caution for caution in recovery.estimates.cautions)
    off = recovery.joints["wrist"] - interpolate(truth.t_s, truth.joints["wrist"], recovery.t_s)
    # 8 mm of noise on the camera's joints; the sum over three axes
    assert np.sqrt(np.nanmean(np.sum(off[~recovery.occluded] ** 2, axis=1))) < 0.012


@pytest.mark.slow
def test_a_pause_within_a_gap_has_its_caution() -> None:
    recording = moving(0, "white").recording
    t, frames = recording.imu.t_s, recording.arm.t_s
    recording = replace(recording, arm=recording.arm.hide((frames > 12.0) & (frames < 16.0)))
    # the frames within the pause, thirty a second; it begins before the gap, what is unseen does not
    for start_s, end_s, words in ((12.9, 14.5, ("(12.9 to", "(13.0 to")), (11.0, 17.0, ("(12.0 to",))):
        recovery = answer(kept(recording, (t >= start_s) & (t <= end_s)))
        cautions = recovery.estimates.cautions
        (said,) = (text for text in cautions if "paused while the arm was hidden" in text)
        assert any(word in said for word in words)


@pytest.mark.slow
def test_short_segments_that_show_one_joint_only() -> None:
    """No elbow is ever seen: gravity alone says how the IMU is turned there."""
    made = moving(0, "white")
    recording, t, t_imu = made.recording, made.recording.arm.t_s, made.recording.imu.t_s
    no_elbow = recording.arm.hide((t > 12.0) & (t < 16.0), ("elbow",))
    lost = np.any([(t_imu > at) & (t_imu < at + 0.2) for at in (12.9, 15.1)], axis=0)
    scene = blind(made, kept(replace(recording, arm=no_elbow), lost))
    assert scene.recovery.estimates.trusted and scene.validation.all.position_max_m < 0.03


def test_a_wrist_that_is_hardly_seen() -> None:
    """Elbow and wrist come together in a few frames: no direction of the forearm, and no error."""
    recording = moving(0, "white", 20.0).recording
    rarely = recording.arm.hide(recording.arm.t_s > recording.arm.t_s[0] + 0.3, ("wrist",))
    assert answer(replace(recording, arm=rarely)).answered.mean() > 0.9


@pytest.mark.slow
def test_a_joint_that_the_excerpts_did_not_see_takes_no_part() -> None:
    """Where its place on the arm is unknown its samples must not pull the IMU to themselves."""
    recording = moving(0, "white", 180.0).recording
    hand, t = JOINTS.index("hand"), recording.arm.t_s
    nowhere = replace(recording, arm=recording.arm.hide(np.ones(len(t), bool), ("hand",)))
    excerpts = spread_excerpts(nowhere, Timeline.of(nowhere), WANTED, CONTEXT_S)
    inside = np.any([(t > each.start_s - 1.5) & (t < each.end_s + 1.5) for each in excerpts], axis=0)
    elsewhere = replace(recording, arm=recording.arm.hide(inside, ("hand",)))
    assert (elsewhere.arm.state[:, hand] == JointState.TRACKED).sum() > 500
    without, with_it = answer(nowhere), answer(elsewhere)
    assert np.isnan(with_it.joints["hand"]).all() and not with_it.residuals.used[:, hand].any()
    # a thousandth of the 8 cm that lie between hand and IMU is left for other excerpts
    assert np.nanmax(np.linalg.norm(with_it.position - without.position, axis=1)) < 0.002


@pytest.mark.parametrize("sentence", ["never tracked", "overlap"])
def test_nothing_seen_and_clocks_that_never_meet_are_one_sentence(sentence: str) -> None:
    recording = point(0, duration_s=5.0, occlusion_lengths_s=()).recording
    if sentence == "overlap":
        recording = replace(recording, imu=replace(recording.imu, t_s=recording.imu.t_s + 1000.0))
    else:
        state = np.full_like(recording.arm.state, JointState.INFERRED)
        recording = replace(recording, arm=replace(recording.arm, state=state))
    with pytest.raises(SolveError, match=sentence):
        answer(recording)


def test_small_angles_keep_their_sigma_and_large_ones_take_positions_along() -> None:
    root = np.random.default_rng(0).normal(size=(6, 6)) * np.repeat([0.01, 0.005], 3)[:, None]
    np.testing.assert_allclose(widen_turns((root @ root.T)[None])[0], root @ root.T, rtol=0.05)
    # a heading alone, that a lever arm of 4 cm takes along
    along = np.array([0.04, 0.0, 0.0, 0.0, 0.0, 1.0])
    found = widen_turns((LINEAR_RAD**2 * np.outer(along, along) + 1e-8 * np.eye(6))[None])[0]
    assert found[5, 5] == pytest.approx(4 * LINEAR_RAD**2, rel=1e-3)
    assert found[0, 0] == pytest.approx(4 * LINEAR_RAD**2 * 0.04**2, rel=1e-3)
    assert np.linalg.eigvalsh(found).min() > 0
