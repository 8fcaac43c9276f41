"""Where a camera stands and how its clock runs, against simulated cameras and an independent computation."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from smoother.cameras.joining import join_cameras, placed_camera
from smoother.cameras.placing import OFFSET_M, place
from smoother.cameras.rig import RelativeClock, candidate_offsets
from smoother.measurements.visibility import seen_by_any
from smoother.recording import CameraPose, JointState
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


@cache
def made(
    preset: str = "realistic", seed: int = 900, fault: str = "none", duration_s: float = 40.0
) -> SimulatedArm:
    config = ArmSimulation.preset(
        preset,
        protocol="random",
        duration_s=duration_s,
        cameras=(70.0,),
        camera_clock_s=0.35,
        camera_fault=fault,
    )
    return simulate_arm(config, seed)


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


def test_the_steps_end_where_a_general_solver_does() -> None:
    """White noise alone: the robust steps and SciPy's solver on the same residuals agree."""
    simulated = made("white", 904)
    arm, camera = simulated.recording.arm, simulated.recording.cameras[0]
    true = simulated.parameters["cameras"]["camera_2"]
    placed = place(arm, camera.arm, RelativeClock(true["offset_s"]))
    placement, together = placed
    both = together.both

    def residual(x: np.ndarray) -> np.ndarray:
        R = Rotation.from_rotvec(x[:3]).as_matrix() @ placement.R
        there = together.other @ R.T + placement.p + x[3:6] + x[6:].reshape(5, 3)
        sigma = 0.011
        return np.concatenate([((together.first - there)[both] / sigma).ravel(), x[6:] / OFFSET_M])

    found = least_squares(residual, np.concatenate([np.zeros(6), placement.offset_m.ravel()]), loss="cauchy")
    assert np.degrees(np.linalg.norm(found.x[:3])) < 0.1  # its sigma; the two losses are not the same


def test_clocks_that_are_seconds_apart_are_found() -> None:
    simulated = made()
    camera = simulated.recording.cameras[0]
    late = replace(camera.arm, t_s=camera.arm.t_s + 12.0)
    true_s = simulated.parameters["cameras"]["camera_2"]["offset_s"] - 12.0
    assert min(abs(offset_s - true_s) for offset_s in candidate_offsets(simulated.recording.arm, late)) < 0.04


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "words"),
    [("mirrored", "mirror image"), ("other_person", "another person"), ("moved", "was moved")],
)
def test_a_camera_that_is_wrong_is_named_and_left_out(fault: str, words: str) -> None:
    recording = made(seed=905, fault=fault).recording
    joined, rig = join_cameras(recording)
    assert words in rig.cameras[1].reason
    assert rig.cautions[0].startswith("camera_2 was left out")
    assert joined.arm is recording.arm


@pytest.mark.slow
def test_a_camera_that_stood_still_was_not_moved() -> None:
    """Fourteen seconds off, its parts lie 146 degrees apart and fit to 5.4 cm; the whole fits to 4.9."""
    config = ArmSimulation.preset(
        "azure", protocol="random", duration_s=60.0, cameras=(75.0,), camera_clock_s=0.35
    )
    simulated = simulate_arm(config, 5007)
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


def test_one_camera_is_left_as_it_is() -> None:
    recording = replace(made().recording, cameras=())
    joined, rig = join_cameras(recording)
    assert joined is recording
    assert rig is None


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


def test_states_of_joined_frames_are_the_cameras_own() -> None:
    recording = made("clean").recording
    joined, _ = join_cameras(recording)
    tracked = sum(
        int((arm.state == JointState.TRACKED).sum()) for arm in (recording.arm, recording.cameras[0].arm)
    )
    assert int((joined.arm.state == JointState.TRACKED).sum()) == tracked
