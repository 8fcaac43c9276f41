"""Baselines without a model: nothing hidden, what has arrived alone, odd scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import solved_arm

from smoother.baselines.scene import Scene, between, scenes_of
from smoother.baselines.simple import autoregressive, camera_only, constant_velocity, hold
from smoother.calibration import ArmCalibration
from smoother.recording import JOINTS, ImuStream

FRAME_S = 1.0 / 30.0


@pytest.fixture(scope="module")
def behind() -> Scene:
    it = solved_arm("white", 3, protocol="behind", repetitions=1)
    (scene,) = scenes_of(it.recording, it.graph)
    return scene


def test_camera_only_by_equation_16(behind: Scene):
    """In frames where the camera states both joints: the paper's formula from its own d_se and d_sw."""
    levers = behind.calibration.lever_arms
    elbow, wrist = levers["elbow"].position_m, levers["wrist"].position_m
    along = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    d_se, d_sw = float(-elbow @ along), float(wrist @ along)
    L, T = (behind.camera_joints[:, JOINTS.index(joint)] for joint in ("elbow", "wrist"))
    D = L + d_se / (d_sw + d_se) * (T - L)
    known = np.isfinite(D).all(axis=1)
    frames = behind.frame_t[known]
    at_frames = replace(behind, imu=replace(behind.imu, t_s=frames))
    np.testing.assert_allclose(camera_only(at_frames).position, D[known], atol=1e-12)


def test_camera_only_takes_guesses_and_bridges_silence(behind: Scene):
    gap = behind.gaps[0]
    hidden = (behind.frame_t > gap.start_s) & (behind.frame_t < gap.end_s)
    camera_joints = behind.camera_joints.copy()
    camera_joints[hidden] = np.array([1.0, 2.0, 3.0])
    inside = (behind.t > gap.start_s + FRAME_S) & (behind.t < gap.end_s - FRAME_S)
    np.testing.assert_allclose(
        camera_only(replace(behind, camera_joints=camera_joints)).position[inside],
        [[1.0, 2.0, 3.0]] * inside.sum(),
    )
    camera_joints[hidden] = np.nan
    line = camera_only(replace(behind, camera_joints=camera_joints)).position[inside]
    assert np.abs(np.diff(line, n=2, axis=0)).max() < 1e-9


def test_camera_only_with_fewer_joints(behind: Scene):
    strap = np.full_like(behind.camera_joints, np.nan)
    strap[:, JOINTS.index("strap")] = [0.1, 0.2, 2.0]
    bare = replace(behind, camera_joints=strap, calibration=replace(behind.calibration, lever_arms={}))
    np.testing.assert_allclose(camera_only(bare).position, np.tile([0.1, 0.2, 2.0], (len(behind.t), 1)))
    nothing = replace(behind, camera_joints=np.full_like(strap, np.nan))
    assert np.isnan(camera_only(nothing).position).all()


def test_hold_stands_still_in_a_gap(behind: Scene):
    path = hold(behind)
    for gap in behind.gaps:
        inside = behind.occluded & (behind.t > gap.start_s) & (behind.t < gap.end_s)
        last = behind.point[np.searchsorted(behind.frame_t, gap.start_s)]
        np.testing.assert_allclose(path.position[inside], np.tile(last, (inside.sum(), 1)))
        assert (path.R_K_A[inside] == path.R_K_A[inside][0]).all()
    seen = ~behind.occluded
    np.testing.assert_allclose(
        path.position[seen],
        between(behind.frame_t, behind.point, behind.t)[seen],
    )


LATENCY_S = 0.1


def scene(hidden_from_s: float = np.inf, sigma_m: float = 0.003) -> Scene:
    """A point that swings along x, 6 s of it, seen at 30 Hz until it hides."""
    rng = np.random.default_rng(3)
    t, frame_t = np.arange(0.0, 6.0, 0.01), np.arange(0.0, 6.0, 1 / 30)
    acceleration = -(2.0**2) * truth(t)
    point = truth(frame_t) + sigma_m * rng.normal(size=(len(frame_t), 3))
    point[frame_t >= hidden_from_s] = np.nan
    joints = np.full((len(frame_t), 5, 3), np.nan)
    return Scene(
        imu=ImuStream("imu", t, acceleration, np.zeros_like(acceleration)),
        R_K_A=np.tile(np.eye(3), (len(t), 1, 1)),
        attitude_sigma_rad=0.01,
        gravity=np.array([0.0, -9.81, 0.0]),
        acceleration=acceleration,
        frame_t=frame_t,
        joints=joints,
        camera_joints=joints,
        point=point,
        point_sigma_m=sigma_m,
        gaps=(),
        calibration=ArmCalibration(),
        point_effective_sigma_m=sigma_m,
    )


def truth(t: np.ndarray) -> np.ndarray:
    return np.outer(0.15 * np.sin(2.0 * t), [1.0, 0.0, 0.0])


@pytest.mark.parametrize("method", [autoregressive, constant_velocity])
def test_what_has_arrived_answers_for_the_present(method):
    moving, cut = scene(), scene(hidden_from_s=4.0)
    t, answer, of_cut = moving.t, method(moving, LATENCY_S).position, method(cut, LATENCY_S)
    assert np.isnan(answer[t < LATENCY_S - 0.05]).all()
    later = t > 1.0
    error = np.linalg.norm(answer - truth(t), axis=1)[later]
    # what arrived is 0.1 s old: held, it would be off by up to 0.15 x 2 x 0.1 = 3 cm
    held = np.linalg.norm(truth(t - LATENCY_S) - truth(t), axis=1)[later]
    assert np.sqrt(np.mean(error**2)) < 0.6 * np.sqrt(np.mean(held**2))
    # it never sees what has not arrived, but for hyper-parameters of the whole segment
    before = t < 4.0 + LATENCY_S - 0.04
    off_m = 2e-3 if method is autoregressive else 0.0
    np.testing.assert_allclose(answer[before], of_cut.position[before], rtol=0.0, atol=off_m)
    sigma = np.sqrt(np.trace(of_cut.covariance, axis1=1, axis2=2))
    at = [int(np.searchsorted(t, s)) for s in (4.05, 4.5, 5.5)]
    assert sigma[at[0]] < sigma[at[1]] < sigma[at[2]]
