"""`smooth` where the recording gives little: gaps at an end, an IMU that drops out, one joint, nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import OVER_CONFIDENT, answer, arm, blind, moving, point, recovered

from smoother.errors import SolveError
from smoother.evaluation.advice import advice
from smoother.evaluation.validate import sample_errors
from smoother.linalg import interpolate
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, JointState, Recording
from smoother.recovery.samples import LINEAR_RAD, widen_turns
from smoother.selfcal.excerpts import CONTEXT_S, WANTED, spread_excerpts
from smoother.simulation import SimulatedArm

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
        of_imu = f"The IMU paused (1 x) for {end_s - start_s:.1f} s"
        assert any(of_imu in sentence for sentence in advice(recovery, None))


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
