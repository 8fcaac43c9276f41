"""A recording of two cameras recovered: better where one helps, no worse elsewhere, faults named."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calib.file import CalibrationFile
from calib.intrinsics import calibrate_cameras, camera_poses, with_camera_poses
from smoother.baselines.scene import of_best_camera
from smoother.cameras import join_cameras
from smoother.errors import CalibrationError
from smoother.evaluation.gaps import HiddenGap, hide, visible_runs
from smoother.evaluation.summary import cameras
from smoother.recording import JointState, Recording
from smoother.recovery.cameras import spans
from smoother.result import CameraEstimate, Estimates, Recovery
from smoother.result.verdict import from_plain
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from smoother.window.nodes import GROUPED_S, group_frames_of_cameras

SETTINGS = {
    "protocol": "random",
    "duration_s": 25.0,
    "cameras": (75.0,),
    "camera_clock_s": 0.35,
    "occlusion_lengths_s": (2.0,),
    "camera_blind": 0.0,
}


@cache
def made(seed: int = 920) -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset("realistic", **SETTINGS), seed)


@cache
def recovered(cameras: int) -> Recovery:
    recording = replace(made().recording, truth=None)
    return smooth(recording if cameras > 1 else replace(recording, cameras=()), processes=1)


def wrist_m(recovery: Recovery, mask: np.ndarray) -> float:
    truth = made().recording.truth
    error = (recovery.joints["wrist"] - truth.joints["wrist"])[mask]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.mark.slow
def test_gaps_are_where_no_camera_sees_and_the_answer_is_better_in_the_first_ones() -> None:
    one, two = recovered(1), recovered(2)
    assert two.estimates.trusted
    assert two.occluded.sum() < one.occluded.sum()
    # the two answers' clocks differ by a millisecond: a sample at the end of a gap may go either way
    assert (two.occluded & ~one.occluded).sum() <= 3
    assert wrist_m(two, one.occluded) < wrist_m(one, one.occluded)


@pytest.mark.slow
def test_the_table_of_cameras_is_among_the_estimates_and_survives_a_file() -> None:
    recovery = recovered(2)
    first, second = recovery.estimates.cameras
    assert (first.name, second.name) == ("camera", "camera_2")
    np.testing.assert_allclose(first.R_K_C, np.eye(3))  # type: ignore[arg-type]
    assert second.offset_s == pytest.approx(made().parameters["cameras"]["camera_2"]["offset_s"], abs=0.005)
    assert {"elbow", "wrist"} <= second.joint_sigma_m.keys()
    assert set(recovery.estimates.camera_sigma_m or {}) <= {"elbow", "wrist", "hand", "strap"}
    again = Estimates.from_plain(recovery.estimates.plain())
    assert again.cameras == recovery.estimates.cameras
    assert len(cameras(recovery).rows) == len(recovery.estimates.cameras)


def test_each_sample_says_which_cameras_saw_it() -> None:
    recovery = recovered(2)
    seen = np.stack([camera.saw_at(recovery.t_s) for camera in recovery.estimates.cameras], axis=1)
    inside = slice(20, -20)
    # a frame or two of difference at the ends of gaps: samples lie between frames
    assert (seen.any(axis=1) == ~recovery.occluded)[inside].mean() > 0.98
    assert (seen.sum(axis=1) == 2).any()
    assert (seen.sum(axis=1) == 1).any()


@pytest.mark.slow
def test_a_camera_that_guesses_for_seconds_is_named_and_changes_little() -> None:
    recording = replace(made().recording, truth=None)
    (camera,) = recording.cameras
    position = np.array(camera.arm.position)
    visible = camera.arm.tracked("wrist")
    runs = np.split(np.flatnonzero(visible), np.flatnonzero(np.diff(np.flatnonzero(visible)) > 1) + 1)
    rows = max(runs, key=len)[10:130]
    position[rows, 1:4] += np.array([0.15, 0.1, -0.1])
    wrong = camera.with_arm(replace(camera.arm, position=position))
    recovery = smooth(replace(recording, cameras=(wrong,)), processes=1)
    assert any("camera_2's joints contradict" in caution for caution in recovery.estimates.cautions)
    assert not any("camera's joints contradict" in caution for caution in recovery.estimates.cautions)
    everywhere = np.ones(len(recovery.t_s), bool)
    assert wrist_m(recovery, everywhere) < 1.3 * wrist_m(recovered(2), everywhere)


def test_hidden_gaps_are_hidden_from_all_cameras() -> None:
    joined, _ = join_cameras(made().recording)
    start_s, end_s = max(visible_runs(joined), key=lambda run: run[1] - run[0])
    gap = HiddenGap(start_s + 0.5, start_s + 1.5)
    hidden = hide(joined, [gap])
    inside = gap.contains(joined.arm.t_s)
    assert set(np.unique(joined.arm.camera[inside])) == {0, 1}  # type: ignore[index]
    assert not (hidden.arm.state[inside][:, 1:] == JointState.TRACKED).any()
    assert end_s > start_s + 2.0


def test_baselines_get_the_camera_that_saw_most() -> None:
    recording, graph = of_best_camera(made().recording, recovered(2))
    assert recording.arm.camera is None
    assert len(recording.arm) == len(graph.arm) < len(recovered(2).arm)
    assert len(graph.residuals) == len(graph.arm)
    sums = [int(camera.arm.forearm_tracked.sum()) for camera in made().recording.cameras]
    most = max(int(made().recording.arm.forearm_tracked.sum()), *sums)
    assert int(recording.arm.forearm_tracked.sum()) == most


def test_a_camera_estimate_of_another_kind_is_no_estimate() -> None:
    assert from_plain(CameraEstimate, {"name": 3}) is None
    assert from_plain(CameraEstimate, {"name": "a", "R_K_C": [[1, 0], [0, 1]]}) is None
    assert CameraEstimate("a").saw_at(np.zeros(2)).tolist() == [False, False]


def test_spans_end_where_a_frame_is_missing() -> None:
    t = np.array([0.0, 0.03, 0.06, 0.09, 0.5, 0.53])
    visible = np.array([True, True, True, False, True, True])
    assert spans(t, visible) == ((0.0, 0.06), (0.5, 0.53))


def test_frames_of_two_cameras_share_nodes_and_none_is_lost() -> None:
    rng = np.random.default_rng(3)
    t = np.sort(np.concatenate([np.arange(0, 3, 1 / 30), np.arange(0.001, 3, 1 / 30)]))
    visible = np.ones(len(t), bool)
    visible[80:100] = False
    owner = group_frames_of_cameras(t, visible, ~visible, 2)
    nodes = np.unique(t[owner])
    assert np.diff(nodes).min() >= 0.008
    assert np.abs(t - t[owner]).max() <= 1.5 * GROUPED_S
    assert len(nodes) < 0.5 * len(t)
    struck = np.abs(t - 1.5) < 0.02
    apart = group_frames_of_cameras(t, visible, struck, 2)
    assert np.abs(t - t[apart])[struck].max() < 0.008  # with the other camera's frame of that moment alone
    far = np.abs(t - 1.5) > 0.5
    np.testing.assert_array_equal(apart[far], owner[far])
    assert (group_frames_of_cameras(t[:2], visible[:2], ~visible[:2], 2) == 0).all()
    few = np.sort(rng.uniform(0, 0.01, 2))
    assert len(group_frames_of_cameras(few, np.ones(2, bool), np.zeros(2, bool), 2)) == 2


@pytest.mark.slow
def test_a_set_up_is_calibrated_kept_and_used_as_a_prior() -> None:
    set_up = calibrate_cameras([made().recording, made(921).recording])
    # two set-ups: the second recording's camera stands elsewhere, and is named
    assert "was moved since" in " ".join(set_up.figures["left_out"])
    assert set_up.grade == "not good enough"
    answer = calibrate_cameras([made().recording])
    poses = camera_poses(answer.table)
    recording = with_camera_poses(made().recording, poses)
    np.testing.assert_allclose(
        recording.cameras[0].pose.R_K_C, answer.figures["cameras"]["camera_2"]["R_K_C"]
    )
    _, rig = join_cameras(recording)
    assert rig.cameras[1].pose.sigma_rad < recording.cameras[0].pose.sigma_rad


@pytest.mark.parametrize(
    "table",
    [
        {"left": {"R_K_C": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}},
        {"left": {"R_K_C": np.diag([1, 1, -1]).tolist(), "p_K_C_m": [0, 0, 0], "sigma_deg": 1, "sigma_m": 1}},
        {"left": 3},
        3,
    ],
)
def test_a_table_that_is_wrong_is_refused(table: object) -> None:
    with pytest.raises(CalibrationError, match=r"calibrate cameras|rotation"):
        camera_poses(CalibrationFile().with_table("cameras", table))  # type: ignore[arg-type]


def test_one_camera_has_nothing_to_be_placed() -> None:
    alone: Recording = replace(made().recording, cameras=())
    with pytest.raises(CalibrationError, match="only one camera"):
        calibrate_cameras([alone])
