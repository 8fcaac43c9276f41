"""An IMU that drops out, and joints that are hardly seen: no error, and a sigma that holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import arm

from smoother import smooth
from smoother.evaluation.advice import advice
from smoother.linalg import interpolate
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, JointState, Recording, Truth
from smoother.selfcal.excerpts import CONTEXT_S, WANTED, spread_excerpts


def sound(seed: int = 0, duration_s: float = 30.0) -> Recording:
    return arm(seed, protocol="random", duration_s=duration_s).recording


def dropping_out(recording: Recording, every_s: float, lost_s: float) -> Recording:
    """The same without the IMU's samples of the first moments of each period."""
    return replace(
        recording, imu=recording.imu.select(np.mod(recording.imu.t_s, every_s) > lost_s), truth=None
    )


def position_errors(recovery, truth: Truth) -> tuple[np.ndarray, float]:
    """Distances (n,), m, and NEES of the IMU's position."""
    difference = recovery.position - interpolate(truth.t_s, truth.position, recovery.t_s)
    known = np.isfinite(difference).all(axis=1)
    spread = recovery.pose_covariance[known, :3, :3]
    squared = np.einsum("na,nab,nb->n", difference[known], np.linalg.inv(spread), difference[known])
    return np.linalg.norm(difference[known], axis=1), float(squared.mean() / 3.0)


@pytest.mark.parametrize("every_s", [1.0, 2.0])
def test_a_sensor_that_drops_out_again_and_again(every_s: float) -> None:
    """Its own place on the arm is hardly known, which sigma and verdict say; the joints are right."""
    recording = sound(1)
    recovery = smooth(dropping_out(recording, every_s, 0.15), processes=1)
    assert recording.truth is not None
    _, nees = position_errors(recovery, recording.truth)
    assert nees < 2.0
    assert any("drops out every" in caution for caution in recovery.estimates.cautions)
    wrist = recording.truth.joints["wrist"]
    visible = ~recovery.occluded
    off = recovery.joints["wrist"] - interpolate(recording.truth.t_s, wrist, recovery.t_s)
    # 8 mm of noise on the camera's joints; the sum over three axes
    assert np.sqrt(np.nanmean(np.sum(off[visible] ** 2, axis=1))) < 0.012


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


def test_short_segments_that_show_one_joint_only() -> None:
    """Between two pauses the elbow is never seen: gravity alone says how the IMU is turned there."""
    recording = sound(0)
    t = recording.arm.t_s
    no_elbow = recording.arm.hide((t > 12.0) & (t < 16.0), ("elbow",))
    lost = [(recording.imu.t_s > at) & (recording.imu.t_s < at + 0.2) for at in (12.9, 15.1)]
    one = replace(recording, arm=no_elbow, imu=recording.imu.select(~(lost[0] | lost[1])), truth=None)
    recovery = smooth(one, processes=1)
    assert recording.truth is not None
    distance_m, _ = position_errors(recovery, recording.truth)
    assert recovery.estimates.trusted and distance_m.max() < 0.03


def test_a_wrist_that_is_hardly_seen() -> None:
    """Elbow and wrist come together in a few frames: no direction of the forearm, and no error."""
    recording = sound(0, 20.0)
    rarely = recording.arm.hide(recording.arm.t_s > recording.arm.t_s[0] + 0.3, ("wrist",))
    recovery = smooth(replace(recording, arm=rarely, truth=None), processes=1)
    assert recovery.answered.mean() > 0.9


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
