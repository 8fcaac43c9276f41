"""`smooth` where the recording gives little: gaps at an end, rest, an IMU that drops out, nothing at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE, OVER_CONFIDENT, Scene, arm, assert_accurate, point, recovered

from smoother.errors import SolveError
from smoother.evaluation.advice import advice
from smoother.evaluation.validate import sample_errors
from smoother.linalg import interpolate
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, JointState, Recording, Truth
from smoother.recovery.samples import LINEAR_RAD, widen_turns
from smoother.selfcal.excerpts import CONTEXT_S, WANTED, spread_excerpts
from smoother.smoothing import smooth

OPEN_S = 2.0


@pytest.fixture(scope="module", params=["arm", "point"])
def open_ended(request: pytest.FixtureRequest) -> Scene:
    """The camera comes 2 s late and goes 2 s early."""
    made = arm(1) if request.param == "arm" else point(1)
    t = made.recording.arm.t_s
    hidden = (t < t[0] + OPEN_S) | (t > t[-1] - OPEN_S)
    return recovered(made, replace(made.recording, arm=made.recording.arm.hide(hidden)))


def test_open_gaps_are_marked(open_ended: Scene) -> None:
    gaps = open_ended.recovery.gaps
    assert [gap.open_start for gap in gaps] == [True] + [False] * (len(gaps) - 1)
    assert [gap.open_end for gap in gaps] == [False] * (len(gaps) - 1) + [True]
    t = open_ended.recovery.t_s
    assert open_ended.recovery.occluded[t < gaps[0].end_s].all()
    assert open_ended.recovery.occluded[t > gaps[-1].start_s].all()


def test_sigma_grows_away_from_the_camera(open_ended: Scene) -> None:
    """Every quarter of a second farther out is less sure, and the end far less than the border."""
    recovery = open_ended.recovery
    sigma = recovery.sigma_m.max(axis=1)
    for gap, outwards in ((recovery.gaps[0], -1), (recovery.gaps[-1], 1)):
        border = gap.end_s if outwards < 0 else gap.start_s
        steps = border + outwards * np.arange(0.0, OPEN_S - 0.1, 0.25)
        along = np.interp(steps, recovery.t_s, sigma)
        assert (np.diff(along) > 0).all()
        assert along[-1] > 5 * along[0]


def test_sigma_covers_the_error_of_open_gaps(open_ended: Scene) -> None:
    recovery, truth = open_ended.recovery, open_ended.recording.truth
    errors = sample_errors(recovery, truth)
    for gap in (recovery.gaps[0], recovery.gaps[-1]):
        inside = (recovery.t_s >= gap.start_s) & (recovery.t_s <= gap.end_s)
        assert np.isfinite(errors.distance_m[inside]).all()
        assert np.mean(errors.squared_sigmas[inside]) / 3 < OVER_CONFIDENT
        # free integration from one side: 2 s cost up to 12 cm here, 17 to 33 on real data
        assert errors.distance_m[inside].max() < 0.30


def test_the_rest_does_not_suffer_from_open_ends(open_ended: Scene) -> None:
    recovery, truth = open_ended.recovery, open_ended.recording.truth
    distance = sample_errors(recovery, truth).distance_m
    inner = (recovery.t_s > recovery.gaps[0].end_s) & (recovery.t_s < recovery.gaps[-1].start_s)
    assert np.nanmax(distance[inner]) < 0.02


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
    shift = 5000.0
    recording = made.recording
    moved = replace(
        recording,
        imu=replace(recording.imu, t_s=recording.imu.t_s + shift),
        arm=replace(recording.arm, t_s=recording.arm.t_s + shift),
        truth=replace(recording.truth, t_s=recording.truth.t_s + shift),
    )
    assert_accurate(recovered(made, moved))


@pytest.mark.parametrize("sentence", ["never tracked", "overlap"])
def test_nothing_seen_and_clocks_that_never_meet_are_one_sentence(sentence: str) -> None:
    recording = point(0, duration_s=5.0, occlusion_lengths_s=()).recording
    if sentence == "overlap":
        recording = replace(recording, imu=replace(recording.imu, t_s=recording.imu.t_s + 1000.0))
    else:
        state = np.full_like(recording.arm.state, JointState.INFERRED)
        recording = replace(recording, arm=replace(recording.arm, state=state))
    with pytest.raises(SolveError, match=sentence):
        smooth(recording, None, ALONE)


def sound(seed: int = 0, duration_s: float = 30.0) -> Recording:
    return arm(seed, protocol="random", duration_s=duration_s).recording


def position_errors(recovery, truth: Truth) -> tuple[np.ndarray, float]:
    """Distances (n,), m, and NEES of the IMU's position."""
    difference = recovery.position - interpolate(truth.t_s, truth.position, recovery.t_s)
    known = np.isfinite(difference).all(axis=1)
    spread = recovery.pose_covariance[known, :3, :3]
    squared = np.einsum("na,nab,nb->n", difference[known], np.linalg.inv(spread), difference[known])
    return np.linalg.norm(difference[known], axis=1), float(squared.mean() / 3.0)


@pytest.mark.slow
def test_a_sensor_that_drops_out_again_and_again() -> None:
    """Its own place on the arm is hardly known, which sigma and verdict say; the joints are right."""
    recording = sound(1)
    kept = recording.imu.select(np.mod(recording.imu.t_s, 1.0) > 0.15)
    recovery = smooth(replace(recording, imu=kept, truth=None), processes=1)
    _, nees = position_errors(recovery, recording.truth)
    assert nees < 2.0
    assert any("drops out every" in caution for caution in recovery.estimates.cautions)
    wrist = recording.truth.joints["wrist"]
    visible = ~recovery.occluded
    off = recovery.joints["wrist"] - interpolate(recording.truth.t_s, wrist, recovery.t_s)
    # 8 mm of noise on the camera's joints; the sum over three axes
    assert np.sqrt(np.nanmean(np.sum(off[visible] ** 2, axis=1))) < 0.012


@pytest.mark.slow
def test_a_pause_within_a_gap_has_its_caution() -> None:
    recording = sound(0)
    hidden = recording.arm.hide((recording.arm.t_s > 12.0) & (recording.arm.t_s < 16.0))
    paused = (recording.imu.t_s > 12.9) & (recording.imu.t_s < 14.5)
    one = replace(recording, arm=hidden, imu=recording.imu.select(~paused), truth=None)
    recovery = smooth(one, processes=1)
    # the frames within the pause, thirty a second
    cautions = [text for text in recovery.estimates.cautions if "paused while the arm was hidden" in text]
    assert len(cautions) == 1 and ("(12.9 to" in cautions[0] or "(13.0 to" in cautions[0])
    assert any("The IMU paused once, for 1.6 s" in sentence for sentence in advice(recovery, None))
    longer = (recording.imu.t_s > 11.0) & (recording.imu.t_s < 17.0)
    cautions = list(smooth(replace(one, imu=recording.imu.select(~longer)), processes=1).estimates.cautions)
    # the pause begins before the gap, what is unseen does not
    (caution,) = (text for text in cautions if "paused while the arm was hidden" in text)
    assert "(12.0 to" in caution


@pytest.mark.slow
def test_short_segments_that_show_one_joint_only() -> None:
    """Between two pauses the elbow is never seen: gravity alone says how the IMU is turned there."""
    recording = sound(0)
    t = recording.arm.t_s
    no_elbow = recording.arm.hide((t > 12.0) & (t < 16.0), ("elbow",))
    lost = [(recording.imu.t_s > at) & (recording.imu.t_s < at + 0.2) for at in (12.9, 15.1)]
    one = replace(recording, arm=no_elbow, imu=recording.imu.select(~(lost[0] | lost[1])), truth=None)
    recovery = smooth(one, processes=1)
    distance_m, _ = position_errors(recovery, recording.truth)
    assert recovery.estimates.trusted and distance_m.max() < 0.03


def test_a_wrist_that_is_hardly_seen() -> None:
    """Elbow and wrist come together in a few frames: no direction of the forearm, and no error."""
    recording = sound(0, 20.0)
    rarely = recording.arm.hide(recording.arm.t_s > recording.arm.t_s[0] + 0.3, ("wrist",))
    recovery = smooth(replace(recording, arm=rarely, truth=None), processes=1)
    assert recovery.answered.mean() > 0.9


@pytest.mark.slow
def test_a_joint_that_the_excerpts_did_not_see_takes_no_part() -> None:
    """Where its place on the arm is unknown its samples must not pull the IMU to themselves."""
    recording = sound(0, 180.0)
    hand, t = JOINTS.index("hand"), recording.arm.t_s
    nowhere = replace(recording, arm=recording.arm.hide(np.ones(len(t), bool), ("hand",)), truth=None)
    excerpts = spread_excerpts(nowhere, Timeline.of(nowhere), WANTED, CONTEXT_S)
    inside = np.any([(t > each.start_s - 1.5) & (t < each.end_s + 1.5) for each in excerpts], axis=0)
    elsewhere = replace(recording, arm=recording.arm.hide(inside, ("hand",)), truth=None)
    assert (elsewhere.arm.state[:, hand] == JointState.TRACKED).sum() > 500
    without, with_it = (smooth(one, processes=1) for one in (nowhere, elsewhere))
    assert with_it.residuals is not None and np.isnan(with_it.joints["hand"]).all()
    assert not with_it.residuals.used[:, hand].any()
    moved_m = np.linalg.norm(with_it.position - without.position, axis=1)
    # a thousandth of the 8 cm that lie between hand and IMU is left for other excerpts
    assert np.nanmax(moved_m) < 0.002
