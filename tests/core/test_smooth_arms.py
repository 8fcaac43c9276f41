"""`smooth_arms`: every arm as `smooth` gives it alone, side by side or in turn."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import unocclude
from smoother import Recoveries, smooth, smooth_arms, write_recovery
from smoother.errors import RecordingError, SolveError
from smoother.recording import JointState, Recording
from smoother.result.draws import USUAL_DRAWS
from smoother.simulation import ArmSimulation, simulate_both_arms


@pytest.fixture(scope="module")
def recordings() -> list[Recording]:
    both = simulate_both_arms(ArmSimulation(protocol="random", duration_s=10, occlusion_lengths_s=(0.8,)), 3)
    return [one.recording for one in both]


@pytest.fixture(scope="module")
def recovered(recordings: list[Recording]) -> Recoveries:
    return smooth_arms(recordings, processes=1, draws=3, seed=5)


def test_each_arm_is_what_smooth_gives(
    recordings: list[Recording], recovered: Recoveries, tmp_path: Path
) -> None:
    assert recovered.tags == ["right", "left"]
    write_recovery(smooth(recordings[1]), tmp_path / "alone.mcap")
    # motions that were drawn beside it change nothing of the answer
    write_recovery(replace(recovered["left"], draws=None), tmp_path / "together.mcap")
    assert (tmp_path / "alone.mcap").read_bytes() == (tmp_path / "together.mcap").read_bytes()
    for recording, recovery in zip(recordings, recovered, strict=True):
        assert recording.truth is not None and recovery.occluded.any()
        error = np.linalg.norm(recovery.position - recording.truth.position, axis=1)
        # 0.8 s gaps with white noise end in some millimetres; the other arm is decimetres away
        assert error.max() < 0.04


def test_motions_are_drawn_unless_somebody_says_otherwise() -> None:
    for function in (smooth_arms, unocclude.smooth):
        assert inspect.signature(function).parameters["draws"].default == USUAL_DRAWS


def test_side_by_side_gives_the_same(
    recordings: list[Recording], recovered: Recoveries, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smoother.runtime.pool.WORTH_FRAMES", 10)
    seen: list[float] = []
    beside = smooth_arms(
        recordings, progress=lambda share, _: seen.append(share), processes=2, draws=3, seed=5
    )
    assert seen == [0.5, 1.0]
    for one, other in zip(recovered, beside, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.pose_covariance, other.pose_covariance)
        assert one.draws is not None and other.draws is not None
        np.testing.assert_array_equal(one.draws.position, other.draws.position)
        np.testing.assert_array_equal(one.draws.joints["elbow"], other.draws.joints["elbow"])


def test_each_arm_has_draws_of_its_own(recovered: Recoveries) -> None:
    left, right = recovered["left"].draws, recovered["right"].draws
    assert left is not None and right is not None and len(left) == len(right) == 3
    assert left.seed == right.seed == 5
    count = min(len(left.t_s), len(right.t_s))
    a, b = left.position[:, :count].ravel(), right.position[:, :count].ravel()
    # the same numbers would give much the same errors in arms that move alike
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.5


def test_an_arm_that_cannot_be_solved_is_left_out(recordings: list[Recording], recovered: Recoveries) -> None:
    right, left = recordings
    state = np.full_like(left.arm.state, JointState.NOT_TRACKED)
    blind = replace(left, arm=replace(left.arm, state=state))
    found = smooth_arms([right, blind], processes=1, draws=0)
    assert found.tags == ["right"] and len(found.left_out) == 1
    assert "The left arm was left out" in found.left_out[0] and found.left_out[0] in found[0].notes
    np.testing.assert_array_equal(found["right"].position, recovered["right"].position)
    with pytest.raises(SolveError, match="never tracked"):
        smooth_arms([blind], processes=1)
    with pytest.raises(RecordingError, match="at least one recording"):
        smooth_arms([])
