"""`smooth` where the recording gives little: gaps at an end, rest, an IMU that drops out, nothing at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import OVER_CONFIDENT, Scene, answer, arm, assert_accurate, blind, moving, point, recovered

from smoother import Recovery
from smoother.errors import SolveError
from smoother.evaluation.advice import advice
from smoother.evaluation.validate import sample_errors
from smoother.linalg import interpolate
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, JointState
from smoother.recovery.samples import LINEAR_RAD, widen_turns
from smoother.selfcal.excerpts import CONTEXT_S, WANTED, spread_excerpts

OPEN_S = 2.0


@pytest.fixture(scope="module", params=["arm", "point"])
def open_ended(request: pytest.FixtureRequest) -> Scene:
    """The camera comes 2 s late and goes 2 s early."""
    made = arm(1) if request.param == "arm" else point(1)
    t = made.recording.arm.t_s
    hidden = (t < t[0] + OPEN_S) | (t > t[-1] - OPEN_S)
    return recovered(made, replace(made.recording, arm=made.recording.arm.hide(hidden)))


def test_open_gaps_are_marked_and_sigma_grows_away_from_the_camera(open_ended: Scene) -> None:
    """Every quarter of a second farther out is less sure, and the end far less than the border."""
    recovery = open_ended.recovery
    gaps, t, sigma = recovery.gaps, recovery.t_s, recovery.sigma_m.max(axis=1)
    assert [gap.open_start for gap in gaps] == [True] + [False] * (len(gaps) - 1)
    assert [gap.open_end for gap in gaps] == [False] * (len(gaps) - 1) + [True]
    assert recovery.occluded[(t < gaps[0].end_s) | (t > gaps[-1].start_s)].all()
    for border, outwards in ((gaps[0].end_s, -1), (gaps[-1].start_s, 1)):
        steps = border + outwards * np.arange(0.0, OPEN_S - 0.1, 0.25)
        along = np.interp(steps, t, sigma)
        assert (np.diff(along) > 0).all()
        assert along[-1] > 5 * along[0]


def test_sigma_covers_the_error_of_open_gaps_and_the_rest_does_not_suffer(open_ended: Scene) -> None:
    recovery, t = open_ended.recovery, open_ended.recovery.t_s
    errors = sample_errors(recovery, open_ended.recording.truth)
    first, last = recovery.gaps[0], recovery.gaps[-1]
    for gap in (first, last):
        inside = (t >= gap.start_s) & (t <= gap.end_s)
        assert np.isfinite(errors.distance_m[inside]).all()
        assert np.mean(errors.squared_sigmas[inside]) / 3 < OVER_CONFIDENT
        # free integration from one side: 2 s cost up to 12 cm here, 17 to 33 on real data
        assert errors.distance_m[inside].max() < 0.30
    assert np.nanmax(errors.distance_m[(t > first.end_s) & (t < last.start_s)]) < 0.02


@pytest.mark.slow
def test_a_pause_of_the_imu_splits_the_recording() -> None:
    """A second without IMU in visible time: both sides are answered as well as ever."""
    made = arm(1)
    imu = made.recording.imu
    kept = (imu.t_s < 9.0) | (imu.t_s > 10.0)
    scene = recovered(made, replace(made.recording, imu=imu.select(kept)))
    assert_accurate(scene)
    recovery = scene.recovery
    assert len(recovery) == kept.sum()
    assert np.isfinite(recovery.position).all()
    for gap in recovery.gaps:  # none is said to reach over the pause
        assert gap.end_s <= 9.01 or gap.start_s >= 9.99


@pytest.mark.slow
def test_a_pause_inside_a_gap_leaves_two_open_gaps() -> None:
    made = arm(1)
    first = recovered(made).recovery.gaps[0]
    middle, imu = 0.5 * (first.start_s + first.end_s), made.recording.imu
    kept = np.abs(imu.t_s - middle) > 0.2
    scene = recovered(made, replace(made.recording, imu=imu.select(kept)))
    before, after = scene.recovery.gaps[:2]
    assert (before.open_start, before.open_end) == (False, True)
    assert (after.open_start, after.open_end) == (True, False)
    assert before.end_s < middle < after.start_s
    assert np.isfinite(scene.recovery.position).all()
    assert scene.validation.all.nees < OVER_CONFIDENT


def test_small_angles_keep_their_sigma_and_large_ones_take_positions_along() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    shape = root @ root.T
    scale = np.diag([0.01] * 3 + [0.005] * 3)
    small = (scale @ shape @ scale)[None]
    np.testing.assert_allclose(widen_turns(small), small, rtol=0.05)
    # a heading alone, that a lever arm of 4 cm takes along
    lever = np.array([0.0, 0.04, 0.0])
    axis = np.array([0.0, 0.0, 1.0])
    along = np.concatenate([-np.cross(axis, lever), axis])
    wide = (LINEAR_RAD**2 * np.outer(along, along) + 1e-8 * np.eye(6))[None]
    found = widen_turns(wide)[0]
    assert found[5, 5] == pytest.approx(4 * LINEAR_RAD**2, rel=1e-3)
    assert found[0, 0] == pytest.approx(4 * LINEAR_RAD**2 * 0.04**2, rel=1e-3)
    assert np.linalg.eigvalsh(found).min() > 0


@pytest.mark.slow
def test_a_recording_that_starts_late_and_drops_frames() -> None:
    """Stamps far from zero and a tenth of the frames lost, jitter on the rest."""
    made = arm(0, dropped_frames=0.1, frame_jitter_s=0.002)
    streams = {name: getattr(made.recording, name) for name in ("imu", "arm", "truth")}
    later = {name: replace(stream, t_s=stream.t_s + 5000.0) for name, stream in streams.items()}
    assert_accurate(recovered(made, replace(made.recording, **later)))


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


@pytest.mark.slow
def test_a_sensor_that_drops_out_again_and_again() -> None:
    """Its own place on the arm is hardly known, which sigma and verdict say; the joints are right."""
    made = moving(1, "white")
    kept = made.recording.imu.select(np.mod(made.recording.imu.t_s, 1.0) > 0.15)
    scene = blind(made, replace(made.recording, imu=kept))
    recovery, truth = scene.recovery, scene.recording.truth
    assert scene.validation.all.nees < 2.0
    assert any("drops out every" in caution for caution in recovery.estimates.cautions)
    off = recovery.joints["wrist"] - interpolate(truth.t_s, truth.joints["wrist"], recovery.t_s)
    # 8 mm of noise on the camera's joints; the sum over three axes
    assert np.sqrt(np.nanmean(np.sum(off[~recovery.occluded] ** 2, axis=1))) < 0.012


@pytest.mark.slow
def test_a_pause_within_a_gap_has_its_caution() -> None:
    recording = moving(0, "white").recording
    hidden = recording.arm.hide((recording.arm.t_s > 12.0) & (recording.arm.t_s < 16.0))

    def paused(start_s: float, end_s: float) -> tuple[Recovery, str]:
        t = recording.imu.t_s
        recovery = answer(
            replace(recording, arm=hidden, imu=recording.imu.select((t < start_s) | (t > end_s)))
        )
        cautions = recovery.estimates.cautions
        (said,) = (text for text in cautions if "paused while the arm was hidden" in text)
        return recovery, said

    recovery, said = paused(12.9, 14.5)
    assert "(12.9 to" in said or "(13.0 to" in said  # the frames within the pause, thirty a second
    assert any("The IMU paused (1 x) for 1.6 s" in sentence for sentence in advice(recovery, None))
    # the pause begins before the gap, what is unseen does not
    assert "(12.0 to" in paused(11.0, 17.0)[1]


@pytest.mark.slow
def test_short_segments_that_show_one_joint_only() -> None:
    """Between two pauses the elbow is never seen: gravity alone says how the IMU is turned there."""
    made = moving(0, "white")
    recording, t, t_imu = made.recording, made.recording.arm.t_s, made.recording.imu.t_s
    no_elbow = recording.arm.hide((t > 12.0) & (t < 16.0), ("elbow",))
    lost = np.any([(t_imu > at) & (t_imu < at + 0.2) for at in (12.9, 15.1)], axis=0)
    scene = blind(made, replace(recording, arm=no_elbow, imu=recording.imu.select(~lost)))
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
    assert with_it.residuals is not None and np.isnan(with_it.joints["hand"]).all()
    assert not with_it.residuals.used[:, hand].any()
    moved_m = np.linalg.norm(with_it.position - without.position, axis=1)
    # a thousandth of the 8 cm that lie between hand and IMU is left for other excerpts
    assert np.nanmax(moved_m) < 0.002
