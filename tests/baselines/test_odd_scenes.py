"""Every baseline with a model of the motion, on short, sparse or odd scenes: an answer, or nan and a note."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_scenes import NO_GAPS, arm, errors, rms, scene_of

from smoother.array_types import BoolArray
from smoother.baselines.gaussian_process import gaussian_process
from smoother.baselines.kalman import kalman, multirate_kalman
from smoother.baselines.rts import rts
from smoother.baselines.scene import Baseline, Path, Scene
from smoother.baselines.ukf import ukf
from smoother.measurements.visibility import find_gaps
from smoother.recording import JOINTS

BASELINES = [kalman, multirate_kalman, gaussian_process, ukf, rts]
every_baseline = pytest.mark.parametrize("baseline", BASELINES)


def seen_only(scene: Scene, frames: BoolArray) -> Scene:
    """The scene with the forearm seen in these frames only."""
    point, joints = scene.point.copy(), scene.joints.copy()
    point[~frames] = np.nan
    joints[~frames, 1:] = np.nan
    gaps = find_gaps(scene.frame_t, frames, float(scene.t[0]), float(scene.t[-1]))
    return replace(scene, point=point, joints=joints, gaps=gaps)


def first_samples(scene: Scene, count: int) -> Scene:
    end_s = scene.t[count - 1]
    frames = scene.frame_t <= end_s
    part = seen_only(scene, np.ones(len(scene.frame_t), dtype=bool))
    return replace(
        part,
        imu=scene.imu.select(slice(0, count)),
        R_K_A=scene.R_K_A[:count],
        acceleration=scene.acceleration[:count],
        frame_t=scene.frame_t[frames],
        joints=scene.joints[frames],
        camera_joints=scene.camera_joints[frames],
        point=scene.point[frames],
    )


def check(scene: Scene, path: Path) -> None:
    """Shapes; where there is a position there is a covariance with no negative variance."""
    n = len(scene.t)
    assert path.position.shape == (n, 3)
    answered = np.isfinite(path.position).all(axis=1)
    assert answered.any() or path.notes
    if answered.any():
        assert path.velocity is not None and path.velocity.shape == (n, 3)
        assert path.covariance is not None and path.covariance.shape == (n, 3, 3)
        eigenvalues = np.linalg.eigvalsh(path.covariance[answered])
        assert np.isfinite(eigenvalues).all() and eigenvalues.min() > -1e-12


@every_baseline
@pytest.mark.parametrize("count", [8, 13, 40])
def test_short_scenes(baseline: Baseline, count: int):
    made = arm("white", 1, occlusion_lengths_s=NO_GAPS, duration_s=3.0)
    scene = first_samples(scene_of(made), count)
    check(scene, baseline(scene))


@every_baseline
def test_frames_that_stand_alone(baseline: Baseline):
    made = arm("white", 2, occlusion_lengths_s=NO_GAPS, duration_s=8.0)
    scene = scene_of(made)
    rng = np.random.default_rng(0)
    scene = seen_only(scene, rng.uniform(size=len(scene.frame_t)) < 0.15)
    path = baseline(scene)
    check(scene, path)
    error = errors(made, path)
    # five frames per second, in between the IMU: `kalman`'s low-pass cannot work on single frames
    assert rms(error[np.isfinite(error)]) < (0.10 if baseline is kalman else 0.03)


@every_baseline
@pytest.mark.parametrize("rate_hz", [30.0, 400.0])
def test_slow_and_fast_imus(baseline: Baseline, rate_hz: float):
    made = arm("white", 3, occlusion_lengths_s=NO_GAPS, duration_s=6.0, imu_rate_hz=rate_hz)
    scene = scene_of(made)
    path = baseline(scene)
    check(scene, path)
    error = errors(made, path)
    assert rms(error[np.isfinite(error)]) < 0.025


@every_baseline
def test_no_shoulder_and_no_measures(baseline: Baseline):
    made = arm("white", 4, duration_s=10.0)
    scene = scene_of(made)
    joints = scene.joints.copy()
    joints[:, JOINTS.index("shoulder")] = np.nan
    bare = replace(scene, joints=joints, calibration=replace(scene.calibration, upper_arm=None))
    path = baseline(bare)
    check(bare, path)
    error = errors(made, path)
    assert rms(error[np.isfinite(error) & ~scene.occluded]) < 0.02


@every_baseline
def test_the_same_scene_gives_the_same_answer(baseline: Baseline):
    scene = scene_of(arm("white", 5, duration_s=6.0))
    np.testing.assert_array_equal(baseline(scene).position, baseline(scene).position)
