"""Cameras without depth: placed, where their rays meet, and the arm that they give."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.baselines.registry import recover
from smoother.cameras import join_cameras
from smoother.cameras.keypoint_places import clock_of_known_place, placed_keypoints
from smoother.cameras.rig import RelativeClock, depth_by_rays
from smoother.cli.run import run
from smoother.errors import SolveError
from smoother.recording import FOCAL_CALIBRATED, FOCAL_DATA_SHEET, JOINTS, CameraPose
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth

FIRST = CameraPose(np.eye(3), np.zeros(3), 0.0, 0.0)


@cache
def made(rgb: str, preset: str = "realistic", seed: int = 930, **changes: Any) -> SimulatedArm:
    settings = {"protocol": "random", "duration_s": 30.0, "rgb": rgb, "camera_clock_s": 0.35} | changes
    settings.setdefault("cameras", (75.0,))
    return simulate_arm(ArmSimulation.preset(preset, **settings), seed)


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
    simulated = made("further", preset, **noise)
    row = placed_keypoints(simulated.recording.cameras[0], simulated.recording.arm, "camera")
    true = simulated.parameters["cameras"]["camera_2"]
    assert row.takes_part
    assert np.degrees(Rotation.from_matrix(row.pose.R_K_C @ true["R_K_C"].T).magnitude()) < most_deg
    assert np.linalg.norm(row.pose.p_K_C_m - true["p_K_C_m"]) < most_m
    assert abs(row.clock.offset_s - true["offset_s"]) < most_s


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "seed", "words"),
    [("other_person", 930, "its rays pass"), ("moved", 932, "from about 15 s on it is")],
)
def test_a_wrong_camera_is_left_out_and_named(fault: str, seed: int, words: str) -> None:
    _, rig = join_cameras(made("further", camera_fault=fault, seed=seed).recording)
    (caution,) = rig.cautions
    assert caution.startswith(f"camera_2 was left out: {words}")


def test_rays_of_two_cameras_meet_in_the_joints() -> None:
    simulated = made("all", "clean", rgb_noise_px=0.0)
    recording, (camera,) = simulated.recording, simulated.recording.cameras
    true = simulated.parameters["cameras"]["camera_2"]
    pose = CameraPose(true["R_K_C"], true["p_K_C_m"], 0.0, 0.0)
    clock = RelativeClock(-true["offset_s"])
    depth, met = depth_by_rays(recording.arm, FIRST, clock, camera.arm, pose)
    t = recording.arm.t_s + simulated.parameters["clock_offset_s"]
    for joint in ("shoulder", "elbow", "wrist"):
        column = JOINTS.index(joint)
        there = [np.interp(t, recording.truth.t_s, recording.truth.joints[joint][:, k]) for k in range(3)]
        rows = met[:, column]
        assert rows.mean() > 0.5
        np.testing.assert_allclose(depth[rows, column], there[2][rows], atol=0.01)  # between frames


@pytest.mark.slow
def test_the_clock_of_a_camera_whose_place_is_known() -> None:
    simulated = made("all")
    clock, misfit_m = clock_of_known_place(simulated.recording.cameras[0], simulated.recording.arm)
    assert abs(clock.offset_s - simulated.parameters["cameras"]["camera_2"]["offset_s"]) < 0.005
    assert misfit_m < 0.04


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["other_person", "mirrored", "moved"])
def test_a_wrong_one_of_two_without_depth_is_refused_by_name(fault: str) -> None:
    simulated = made("all", camera_fault=fault, seed=932)
    with pytest.raises(SolveError, match="camera_2 was left out: its rays pass camera's by"):
        join_cameras(simulated.recording)


def test_one_whose_place_is_not_known_is_refused() -> None:
    recording = made("all").recording
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
    simulated = made("all")
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
def test_one_camera_alone_is_solved_and_its_sigma_holds() -> None:
    """At ordinary speed the IMU shows the distance; gaps of 1 to 2 s (other seeds: 1.2 to 3.3 cm)."""
    simulated = made("all", seed=941, cameras=(), duration_s=40.0, occlusion_lengths_s=(1.0, 2.0))
    recovery = smooth(replace(simulated.recording, truth=None), processes=1)
    rms_m, nees = gaps(recovery, simulated)
    assert rms_m < 0.045
    assert nees < 2.0
    assert recovery.estimates.trusted


@pytest.mark.slow
def test_a_baseline_gets_the_distances_of_one_camera_alone() -> None:
    """By the forearm's length that the graph found (other seeds: 3 to 6 cm); on rays of 1 m it was 60 cm."""
    simulated = made("first", seed=930, cameras=())
    recording = replace(simulated.recording, truth=None)
    recovery = recover(recording, smooth(recording, processes=1), "rts")
    error = np.linalg.norm(recovery.position - simulated.recording.truth.position, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.06


@pytest.mark.slow
def test_slow_motion_does_not_show_the_distance_and_is_said_so() -> None:
    simulated = made("all", seed=942, cameras=(), duration_s=40.0, speed=0.25)
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
    simulated = made("all", seed=6000, cameras=(), duration_s=40.0, occlusion_lengths_s=(1.0, 2.0))
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
    recording = replace(made("none", cameras=(), duration_s=8.0).recording, truth=None)
    answers = [
        smooth(replace(recording, arm=replace(recording.arm, focal_share=share)), processes=1)
        for share in (FOCAL_CALIBRATED, FOCAL_DATA_SHEET)
    ]
    for one, other in zip(*(each.joint_covariance.values() for each in answers), strict=True):
        assert one.tobytes() == other.tobytes()


@pytest.mark.slow
def test_an_imu_of_another_motion_is_refused() -> None:
    one, other = made("all", seed=941, cameras=(), duration_s=40.0), made("all", seed=943, cameras=())
    with pytest.raises(SolveError, match="does not turn as the IMU does"):
        join_cameras(replace(other.recording, imu=one.recording.imu, truth=None))


@pytest.mark.slow
def test_start_depths_are_those_of_the_forearm_that_was_assumed() -> None:
    simulated = made("all", seed=944, cameras=())
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
