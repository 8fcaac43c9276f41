"""`smooth` and `smooth_arms`: definitions of what they answer, several arms."""

from __future__ import annotations

import inspect
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import ALONE, Scene, point

import smoother
from smoother import Recoveries, smooth_arms, write_recovery
from smoother.array_types import BoolArray
from smoother.errors import RecordingError, SolveError
from smoother.measurements.visibility import MISSING_FRAMES, MISSING_S
from smoother.recording import FOREARM_JOINTS, JOINTS, JointState, Recording
from smoother.result.draws import USUAL_DRAWS
from smoother.simulation import ArmSimulation, simulate_both_arms
from smoother.smoothing import smooth


def occluded_by_definition(scene: Scene) -> BoolArray:
    """A loop: a sample is visible at, or between neighbouring, visible frames with nothing lost between."""
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    residuals = scene.recovery.residuals
    present = (scene.recording.arm.state[:, forearm] == JointState.TRACKED).any(axis=0).sum()
    seen, frames = residuals.used[:, forearm].sum(axis=1) >= min(2, present), residuals.t_s
    limit = max(MISSING_S, MISSING_FRAMES * float(np.median(np.diff(frames))))
    answer = []
    for t in scene.recovery.t_s:
        before, after = np.flatnonzero(frames <= t), np.flatnonzero(frames >= t)
        if not len(before) or not len(after):  # before the first frame, after the last
            end = after[0] if len(after) else before[-1]
            answer.append(not (seen[end] and abs(frames[end] - t) <= limit))
        else:  # two frames, or one that is at the sample
            a, b = before[-1], after[0]
            answer.append(not (seen[a] and seen[b] and frames[b] - frames[a] <= limit))
    return np.array(answer)


def test_gaps_and_the_occluded_column_are_those_of_the_streams(white_arm: Scene, white_point: Scene) -> None:
    for scene in (white_arm, white_point):
        recovery = scene.recovery
        np.testing.assert_array_equal(recovery.occluded, occluded_by_definition(scene))
        tracked = scene.recording.arm.state == JointState.TRACKED
        # white noise: hardly a tracked sample may be set aside (4 sigmas of three axes: 1 in 1000)
        assert not (recovery.residuals.used & ~tracked).any()
        assert recovery.residuals.used.sum() > 0.99 * tracked.sum()
        np.testing.assert_array_equal(recovery.t_s, scene.recording.imu.t_s)  # the IMU's own stamps
        np.testing.assert_allclose(np.linalg.norm(recovery.quaternion, axis=1), 1.0, atol=1e-9)
    recovery, hidden = white_arm.recovery, white_arm.recording.arm.t_s[white_arm.made.occluded]
    assert len(recovery.gaps) == 4
    inside = [((hidden > gap.start_s) & (hidden < gap.end_s)) for gap in recovery.gaps]
    assert np.any(inside, axis=0).mean() > 0.99
    assert all(a.end_s < b.start_s for a, b in itertools.pairwise(recovery.gaps))
    arrays = recovery.to_arrays()
    assert {"t_s", "occluded", "imu", "imu_quaternion", "sigma", "sigma_deg", "elbow", "wrist"} <= set(arrays)
    assert all(len(values) == len(recovery) for values in arrays.values())


def test_joints_velocity_gravity_and_biases_are_found(white_arm: Scene) -> None:
    truth, recovery, drawn = white_arm.recording.truth, white_arm.recovery, white_arm.made.parameters
    for joint, limit in (("elbow", 0.012), ("wrist", 0.010), ("shoulder", 0.020)):
        error = recovery.joints[joint] - truth.joints[joint]
        assert np.sqrt((error**2).sum(axis=1)[recovery.occluded].mean()) < limit
    slope = np.gradient(truth.position, truth.t_s, axis=0)
    assert np.sqrt(((recovery.velocity - slope)[5:-5] ** 2).sum(axis=1).mean()) < 0.03
    down = drawn["gravity"] / np.linalg.norm(drawn["gravity"])
    assert np.degrees(np.arccos(np.clip(recovery.gravity_direction @ down, -1, 1))) < 1.0
    bias = np.array(recovery.estimates.gyroscope_bias)
    np.testing.assert_allclose(bias, drawn["gyroscope_bias"], atol=0.004)


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
