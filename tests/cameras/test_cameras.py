"""Several cameras, with depth and without: their places, clocks, faults, and what they recover."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.file import CalibrationFile
from calib.intrinsics import calibrate_cameras, camera_poses, with_camera_poses
from smoother.baselines.registry import recover
from smoother.baselines.scene import of_best_camera
from smoother.cameras.joining import join_cameras, placed_camera
from smoother.cameras.keypoint_places import clock_of_known_place, placed_keypoints
from smoother.cameras.placing import CAUCHY, weights
from smoother.cameras.rig import RelativeClock, candidate_offsets, depth_by_rays
from smoother.cli.run import run
from smoother.errors import CalibrationError, SolveError
from smoother.evaluation.gaps import HiddenGap, hide, visible_runs
from smoother.evaluation.summary import cameras
from smoother.measurements.visibility import seen_by_any
from smoother.recording import FOCAL_CALIBRATED, FOCAL_DATA_SHEET, JOINTS, CameraPose, JointState, Recording
from smoother.recovery.cameras import spans
from smoother.result import CameraEstimate, Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from smoother.window.nodes import GROUPED_S, group_frames_of_cameras


@cache
def made(preset: str = "realistic", seed: int = 900, **changes: Any) -> SimulatedArm:
    settings = {"protocol": "random", "duration_s": 40.0, "cameras": (70.0,), "camera_clock_s": 0.35}
    return simulate_arm(ArmSimulation.preset(preset, **(settings | changes)), seed)


def errors(simulated: SimulatedArm, pose: CameraPose, offset_s: float) -> tuple[float, float, float]:
    """Degrees, m where the arm is, s."""
    true = simulated.parameters["cameras"]["camera_2"]
    turned = np.linalg.norm(Rotation.from_matrix(pose.R_K_C @ true["R_K_C"].T).as_rotvec())
    arm = np.array([0.0, 0.0, 2.0])
    seen_C = true["R_K_C"].T @ (arm - true["p_K_C_m"])
    off = np.linalg.norm(pose.to_first(seen_C) - arm)
    return float(np.degrees(turned)), float(off), offset_s - true["offset_s"]


def test_without_errors_pose_and_clock_are_exact() -> None:
    simulated = made("clean")
    row = placed_camera(simulated.recording.cameras[0], simulated.recording.arm)
    turned_deg, off_m, late_s = errors(simulated, row.pose, row.clock.offset_s)
    # frames lie between each other: straight lines between them are off by some tenths of a millimetre
    assert turned_deg < 0.02
    assert off_m < 0.001
    assert abs(late_s) < 3e-4
    assert not row.reason


@pytest.mark.parametrize("seed", [901, 902, 903])
def test_with_realistic_errors_they_are_within_what_is_stated(seed: int) -> None:
    simulated = made(seed=seed)
    row = placed_camera(simulated.recording.cameras[0], simulated.recording.arm)
    turned_deg, off_m, late_s = errors(simulated, row.pose, row.clock.offset_s)
    # of three normal numbers 99.9 % lie within four sigmas
    assert turned_deg < 4.0 * np.degrees(row.pose.sigma_rad)
    assert off_m < 4.0 * row.pose.sigma_m
    assert abs(late_s) < 0.005
    assert turned_deg < 1.2


def test_weights_are_those_of_a_sigma_that_outliers_do_not_move() -> None:
    residual, both = 0.01 * np.random.default_rng(0).normal(size=(4000, 5, 3)), np.ones((4000, 5), bool)
    residual[::20], both[:, 3] = residual[::20] + 1.0, False
    size = np.linalg.norm(residual, axis=2) / 0.01
    expected = np.where(both, 1.0 / (1.0 + (size / CAUCHY) ** 2) / 0.01**2, 0.0)
    # one in twenty moves the median by some per cent
    np.testing.assert_allclose(weights(residual, both), expected, rtol=0.15)


def test_clocks_that_are_seconds_apart_are_found() -> None:
    simulated = made()
    camera = simulated.recording.cameras[0]
    late = replace(camera.arm, t_s=camera.arm.t_s + 12.0)
    true_s = simulated.parameters["cameras"]["camera_2"]["offset_s"] - 12.0
    assert min(abs(offset_s - true_s) for offset_s in candidate_offsets(simulated.recording.arm, late)) < 0.04


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rgb", "fault", "seed", "words"),
    [
        ("none", "mirrored", 905, "mirror image"),
        ("none", "other_person", 905, "another person"),
        ("none", "moved", 905, "was moved"),
        ("further", "other_person", 930, "its rays pass"),
        ("further", "moved", 932, "from about 15 s"),
    ],
)
def test_a_camera_that_is_wrong_is_named_and_left_out(rgb: str, fault: str, seed: int, words: str) -> None:
    settings = {} if rgb == "none" else {"duration_s": 30.0, "cameras": (75.0,)}
    recording = made(seed=seed, rgb=rgb, camera_fault=fault, **settings).recording
    joined, rig = join_cameras(recording)
    assert words in rig.cameras[1].reason
    assert rig.cautions[0].startswith("camera_2 was left out")
    assert joined.arm is recording.arm


@pytest.mark.slow
def test_a_camera_that_stood_still_was_not_moved() -> None:
    """Fourteen seconds off, its parts lie 146 degrees apart and fit to 5.4 cm; the whole fits to 4.9."""
    simulated = made("azure", 5007, duration_s=60.0, cameras=(75.0,))
    _, rig = join_cameras(simulated.recording)
    assert rig is not None and not rig.cameras[1].reason
    turned_deg, off_m, late_s = errors(simulated, rig.cameras[1].pose, rig.cameras[1].clock.offset_s)
    assert turned_deg < 2.0 and off_m < 0.03 and abs(late_s) < 0.01


def test_a_camera_that_never_sees_the_arm_with_the_first_is_left_out() -> None:
    recording = made().recording
    camera = recording.cameras[0]
    hidden = np.ones(len(camera.arm), bool)
    hidden[:30] = False
    blind = camera.with_arm(camera.arm.hide(hidden, ("shoulder", "elbow", "wrist", "hand")))
    _, rig = join_cameras(replace(recording, cameras=(blind,)))
    assert "less than 3 s together" in rig.cameras[1].reason


def test_joined_frames_lie_in_the_first_frame_in_the_order_of_time() -> None:
    simulated = made("clean")
    joined, _ = join_cameras(simulated.recording)
    arm = joined.arm
    assert arm.camera is not None
    assert (np.diff(arm.t_s) >= 0).all()
    assert len(arm) == len(simulated.recording.arm) + len(simulated.recording.cameras[0].arm)
    assert not joined.cameras
    truth = simulated.recording.truth
    seen = arm.tracked("wrist") & (arm.t_s > 0.1) & (arm.t_s < 39.9)
    true = np.stack([np.interp(arm.t_s, truth.t_s, truth.joints["wrist"][:, k]) for k in range(3)], axis=1)
    # the pose is solved: a millimetre is what a straight line between frames leaves
    assert np.abs(arm.joint("wrist") - true)[seen].max() < 0.003
    cameras = (simulated.recording.arm, simulated.recording.cameras[0].arm)
    tracked = sum(int((each.state == JointState.TRACKED).sum()) for each in cameras)
    assert int((arm.state == JointState.TRACKED).sum()) == tracked


def test_a_known_pose_is_a_prior() -> None:
    simulated = made("azure", 906)
    true = simulated.parameters["cameras"]["camera_2"]
    known = CameraPose(true["R_K_C"], true["p_K_C_m"], np.radians(0.1), 0.002)
    camera = replace(simulated.recording.cameras[0], pose=known)
    row = placed_camera(camera, simulated.recording.arm)
    assert errors(simulated, row.pose, 0.0)[0] < 0.3


def test_a_frame_is_seen_where_another_camera_sees_on_both_sides() -> None:
    t = np.array([0.00, 0.01, 0.03, 0.04, 0.07, 0.50, 0.53])
    camera = np.array([0, 1, 0, 1, 1, 0, 0], np.int8)
    visible = np.array([False, True, False, True, False, False, True])
    assert seen_by_any(t, visible, camera).tolist() == [False, True, True, True, False, False, True]
    assert seen_by_any(t, visible, None).tolist() == visible.tolist()


@cache
def keypoints(rgb: str, preset: str = "realistic", seed: int = 930, **changes: Any) -> SimulatedArm:
    return made(preset, seed, **{"duration_s": 30.0, "rgb": rgb, "cameras": (75.0,)} | changes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "noise", "most_deg", "most_m", "most_s"),
    [  # frames lie between each other: straight lines between them are off by some tenths of a millimetre
        ("clean", {"rgb_noise_px": 0.0}, 0.05, 0.005, 5e-4),
        ("realistic", {}, 1.2, np.inf, 0.005),
    ],
)
def test_beside_a_camera_with_depth_pose_and_clock_are_found(
    preset: str, noise: dict[str, float], most_deg: float, most_m: float, most_s: float
) -> None:
    simulated = keypoints("further", preset, **noise)
    row = placed_keypoints(simulated.recording.cameras[0], simulated.recording.arm, "camera")
    true = simulated.parameters["cameras"]["camera_2"]
    assert row.takes_part
    assert np.degrees(Rotation.from_matrix(row.pose.R_K_C @ true["R_K_C"].T).magnitude()) < most_deg
    assert np.linalg.norm(row.pose.p_K_C_m - true["p_K_C_m"]) < most_m
    assert abs(row.clock.offset_s - true["offset_s"]) < most_s


def test_rays_of_two_cameras_meet_in_the_joints() -> None:
    simulated = keypoints("all", "clean", rgb_noise_px=0.0)
    recording, (camera,) = simulated.recording, simulated.recording.cameras
    true = simulated.parameters["cameras"]["camera_2"]
    pose = CameraPose(true["R_K_C"], true["p_K_C_m"], 0.0, 0.0)
    clock = RelativeClock(-true["offset_s"])
    first = CameraPose(np.eye(3), np.zeros(3), 0.0, 0.0)
    depth, met = depth_by_rays(recording.arm, first, clock, camera.arm, pose)
    t = recording.arm.t_s + simulated.parameters["clock_offset_s"]
    for joint in ("shoulder", "elbow", "wrist"):
        column = JOINTS.index(joint)
        there = [np.interp(t, recording.truth.t_s, recording.truth.joints[joint][:, k]) for k in range(3)]
        rows = met[:, column]
        assert rows.mean() > 0.5
        np.testing.assert_allclose(depth[rows, column], there[2][rows], atol=0.01)  # between frames


@pytest.mark.slow
def test_the_clock_of_a_camera_whose_place_is_known() -> None:
    simulated = keypoints("all")
    clock, misfit_m = clock_of_known_place(simulated.recording.cameras[0], simulated.recording.arm)
    assert abs(clock.offset_s - simulated.parameters["cameras"]["camera_2"]["offset_s"]) < 0.005
    assert misfit_m < 0.04


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["other_person", "mirrored", "moved"])
def test_a_wrong_one_of_two_without_depth_is_refused_by_name(fault: str) -> None:
    simulated = keypoints("all", camera_fault=fault, seed=932)
    with pytest.raises(SolveError, match="camera_2 was left out: its rays pass camera's by"):
        join_cameras(simulated.recording)


def test_one_whose_place_is_not_known_is_refused() -> None:
    recording = keypoints("all").recording
    unknown = replace(recording, cameras=(replace(recording.cameras[0], pose=None),))
    with pytest.raises(SolveError, match="camera_2 was left out: its pose is unknown"):
        join_cameras(unknown)


def gaps(recovery: Recovery, simulated: SimulatedArm) -> tuple[float, float]:
    """The wrist's rms error in gaps, m, and its squared sigmas / 3."""
    truth = simulated.recording.truth
    error = (recovery.joints["wrist"] - truth.joints["wrist"])[recovery.occluded]
    covariance = recovery.joint_covariance["wrist"][recovery.occluded]
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), float(squared.mean()) / 3.0


@pytest.mark.slow
def test_two_cameras_without_depth_are_as_good_as_cameras_with_it() -> None:
    simulated = keypoints("all")
    recovery = smooth(replace(simulated.recording, truth=None), processes=1)
    rms_m, nees = gaps(recovery, simulated)
    assert rms_m < 0.02
    assert nees < 2.0
    assert [camera.takes_part for camera in recovery.estimates.cameras] == [True, True]


def depth_off(recovery: Recovery, simulated: SimulatedArm) -> tuple[float, float]:
    """How much too far away the wrist is in the mean, m, and the stated sigma of its depth."""
    truth = simulated.recording.truth
    error = recovery.joints["wrist"] - truth.joints["wrist"]
    return float(np.mean(error[:, 2])), float(np.sqrt(np.median(recovery.joint_covariance["wrist"][:, 2, 2])))


@pytest.mark.slow
def test_a_baseline_gets_the_distances_of_one_camera_alone() -> None:
    """By the forearm's length that the graph found (other seeds: 3 to 6 cm); on rays of 1 m it was 60 cm."""
    simulated = keypoints("first", seed=930, cameras=())
    recording = replace(simulated.recording, truth=None)
    recovery = recover(recording, smooth(recording, processes=1), "rts")
    error = np.linalg.norm(recovery.position - simulated.recording.truth.position, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.06


@pytest.mark.slow
def test_slow_motion_does_not_show_the_distance_and_is_said_so() -> None:
    simulated = keypoints("all", seed=942, cameras=(), duration_s=40.0, speed=0.25)
    recovery = smooth(replace(simulated.recording, truth=None), processes=1)
    off_m, sigma_m = depth_off(recovery, simulated)
    assert sigma_m > 0.03
    assert abs(off_m) < 2.5 * sigma_m
    assert not recovery.estimates.trusted
    assert any("is not determined better than" in each for each in recovery.estimates.reasons)


@pytest.mark.slow
@pytest.mark.parametrize("part", [1.1, 1 / 1.1], ids=["longer", "shorter"])
@pytest.mark.parametrize("share", [FOCAL_CALIBRATED, FOCAL_DATA_SHEET])
def test_a_wrong_focal_length_is_in_sigma_and_not_trusted(part: float, share: float) -> None:
    """The motion contradicts a lens that is 10 % off, whatever was stated; other seeds: sigma 8 to 19 cm."""
    simulated = keypoints("all", seed=6000, cameras=(), duration_s=40.0, occlusion_lengths_s=(1.0, 2.0))
    arm = simulated.recording.arm
    wrong = replace(arm, position=np.asarray(arm.position) * [part, part, 1.0], focal_share=share)
    recovery = smooth(replace(simulated.recording, arm=wrong, truth=None), processes=1)
    off_m, sigma_m = depth_off(recovery, simulated)
    assert abs(off_m) > 0.08
    assert abs(off_m) < 3.5 * sigma_m  # the statement is ten of its own sigmas off
    assert not recovery.estimates.trusted
    asked = any("calibrate the lens" in each for each in recovery.estimates.reasons)
    assert asked == (share == FOCAL_DATA_SHEET)


@pytest.mark.slow
def test_a_lens_changes_nothing_of_a_camera_with_depth() -> None:
    recording = replace(keypoints("none", cameras=(), duration_s=8.0).recording, truth=None)
    answers = [
        smooth(replace(recording, arm=replace(recording.arm, focal_share=share)), processes=1)
        for share in (FOCAL_CALIBRATED, FOCAL_DATA_SHEET)
    ]
    for one, other in zip(*(each.joint_covariance.values() for each in answers), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.slow
def test_an_imu_of_another_motion_is_refused() -> None:
    one, other = (
        keypoints("all", seed=941, cameras=(), duration_s=40.0),
        keypoints("all", seed=943, cameras=()),
    )
    with pytest.raises(SolveError, match="does not turn as the IMU does"):
        join_cameras(replace(other.recording, imu=one.recording.imu, truth=None))


@pytest.mark.slow
def test_start_depths_are_those_of_the_forearm_that_was_assumed() -> None:
    simulated = keypoints("all", seed=944, cameras=())
    recording, truth = simulated.recording, simulated.recording.truth
    true_m = float(np.median(np.linalg.norm(truth.joints["wrist"] - truth.joints["elbow"], axis=1)))
    started, rig = join_cameras(recording, forearm_m=1.1 * true_m)
    assert rig is None
    t = started.arm.t_s + simulated.parameters["clock_offset_s"]
    for joint in ("elbow", "wrist"):
        there = np.interp(t, truth.t_s, truth.joints[joint][:, 2])
        assert np.nanmedian(started.arm.joint(joint)[:, 2] / there) == pytest.approx(1.1, abs=0.06)


@pytest.mark.slow
def test_the_command_recovers_one_camera_without_depth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, recovered = str(tmp_path / "a.mcap"), str(tmp_path / "out.mcap")
    settings = "--preset realistic --set protocol=random --set duration_s=30 --set rgb=all --seed 945"
    assert run(["simulate", "arm", "-o", recording, *settings.split()]) == 0
    height = ["--body-height", "1.75", "--processes", "1", "--draws", "0"]
    assert run(["smooth", recording, "-o", recovered, *height]) == 0
    said = capsys.readouterr()
    assert "Usable" in said.out and "Not carried over" not in said.out + said.err  # keypoints show nobody
    figures = tmp_path / "v.json"
    assert run(["validate", recovered, "--truth", recording, "--json", str(figures)]) == 0
    occluded = json.loads(figures.read_text())["occluded"]
    # a minute of other arms: 1.2 to 3.3 cm
    assert occluded["joint_rms_m"]["wrist"] < 0.05
    assert occluded["coverage_95"] > 0.8
    assert occluded["nees"] < 2.0
    assert run(["smooth", recording, "-o", recovered, "--force", "--body-height", "175"]) == 2
    capsys.readouterr()
    assert run(["live", "--replay", recording, "--speed", "0"]) == 1
    assert "a camera without depth, which live does not use" in capsys.readouterr().err


def two(seed: int = 920) -> SimulatedArm:
    """A recording of two cameras; what one does not see the other does."""
    lasting = {"duration_s": 25.0, "cameras": (75.0,)}
    return made(seed=seed, **lasting, occlusion_lengths_s=(2.0,), camera_blind=0.0)


@cache
def recovered(cameras: int) -> Recovery:
    recording = replace(two().recording, truth=None)
    return smooth(recording if cameras > 1 else replace(recording, cameras=()), processes=1)


def wrist_m(recovery: Recovery, mask: np.ndarray) -> float:
    truth = two().recording.truth
    error = (recovery.joints["wrist"] - truth.joints["wrist"])[mask]
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


@pytest.mark.slow
def test_gaps_are_where_no_camera_sees_and_the_answer_is_better_in_the_first_ones() -> None:
    one, two = recovered(1), recovered(2)
    assert two.estimates.trusted
    first, second = two.estimates.cameras
    np.testing.assert_allclose(first.R_K_C, np.eye(3))
    assert {"elbow", "wrist"} <= second.joint_sigma_m.keys() and len(cameras(two).rows) == 2
    assert two.occluded.sum() < one.occluded.sum()
    # the two answers' clocks differ by a millisecond: a sample at the end of a gap may go either way
    assert (two.occluded & ~one.occluded).sum() <= 3
    assert wrist_m(two, one.occluded) < wrist_m(one, one.occluded)


def test_each_sample_says_which_cameras_saw_it() -> None:
    assert CameraEstimate("a").saw_at(np.zeros(2)).tolist() == [False, False]
    recovery = recovered(2)
    seen = np.stack([camera.saw_at(recovery.t_s) for camera in recovery.estimates.cameras], axis=1)
    inside = slice(20, -20)
    # a frame or two of difference at the ends of gaps: samples lie between frames
    assert (seen.any(axis=1) == ~recovery.occluded)[inside].mean() > 0.98
    assert (seen.sum(axis=1) == 2).any()
    assert (seen.sum(axis=1) == 1).any()


@pytest.mark.slow
def test_a_camera_that_guesses_for_seconds_is_named_and_changes_little() -> None:
    recording = replace(two().recording, truth=None)
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
    joined, _ = join_cameras(two().recording)
    start_s, end_s = max(visible_runs(joined), key=lambda run: run[1] - run[0])
    gap = HiddenGap(start_s + 0.5, start_s + 1.5)
    hidden = hide(joined, [gap])
    inside = gap.contains(joined.arm.t_s)
    assert set(np.unique(joined.arm.camera[inside])) == {0, 1}  # type: ignore[index]
    assert not (hidden.arm.state[inside][:, 1:] == JointState.TRACKED).any()
    assert end_s > start_s + 2.0


def test_baselines_get_the_camera_that_saw_most() -> None:
    recording, graph = of_best_camera(two().recording, recovered(2))
    assert recording.arm.camera is None
    assert len(recording.arm) == len(graph.arm) < len(recovered(2).arm)
    assert len(graph.residuals) == len(graph.arm)
    sums = [int(camera.arm.forearm_tracked.sum()) for camera in two().recording.cameras]
    most = max(int(two().recording.arm.forearm_tracked.sum()), *sums)
    assert int(recording.arm.forearm_tracked.sum()) == most


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
    set_up = calibrate_cameras([two().recording, two(921).recording])
    # two set-ups: the second recording's camera stands elsewhere, and is named
    assert "was moved since" in " ".join(set_up.figures["left_out"])
    assert set_up.grade == "not good enough"
    answer = calibrate_cameras([two().recording])
    poses = camera_poses(answer.table)
    recording = with_camera_poses(two().recording, poses)
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
    alone: Recording = replace(two().recording, cameras=())
    with pytest.raises(CalibrationError, match="only one camera"):
        calibrate_cameras([alone])
    joined, rig = join_cameras(alone)
    assert joined is alone and rig is None
