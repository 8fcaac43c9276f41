"""What a baseline gets, and how its path becomes a recovery."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from scenes import ALONE, solved_arm
from scenes import Scene as Solved
from scipy.spatial.transform import Rotation

from smoother.baselines.registry import recover
from smoother.baselines.scene import Path, Scene, recovery_of, scenes_of
from smoother.errors import SolveError, UnoccludeError
from smoother.linalg import interpolate
from smoother.recording import JOINTS


@pytest.fixture(scope="module")
def behind() -> Solved:
    return solved_arm("white", 3, protocol="behind", repetitions=1)


def only(it: Solved, orientation: str = "vqf") -> Scene:
    (scene,) = scenes_of(it.recording, it.recovery, orientation)
    return scene


def test_a_scene_is_the_graphs_clock_and_samples(behind: Solved):
    scene = only(behind)
    residuals = behind.recovery.residuals
    inside = (behind.recovery.arm.t_s >= scene.t[0]) & (behind.recovery.arm.t_s <= scene.t[-1])
    np.testing.assert_array_equal(scene.frame_t, behind.recovery.arm.t_s[inside])
    np.testing.assert_array_equal(np.isfinite(scene.joints).all(axis=2), residuals.used[inside])
    assert scene.gaps == behind.recovery.gaps
    assert scene.calibration is behind.recovery.calibration
    np.testing.assert_array_equal(scene.occluded, behind.recovery.occluded[scene.rows])
    # no frame inside a gap is a visible one, and the frames at its ends are
    for gap in scene.gaps:
        within = (scene.frame_t > gap.start_s) & (scene.frame_t < gap.end_s)
        assert not scene.visible[within].any()
        assert scene.visible[np.searchsorted(scene.frame_t, [gap.start_s, gap.end_s])].all()


def test_a_scene_agrees_with_the_truth():
    """Without errors: orientation to the filter's 1.5 degrees, acceleration to what that tilts of gravity."""
    it = solved_arm("clean", 21, protocol="random", duration_s=12.0, occlusion_lengths_s=())
    truth, scene = it.made.recording.truth, only(it)
    true = Rotation.from_quat(truth.quaternion[scene.rows], scalar_first=True)
    off = (Rotation.from_matrix(scene.R_K_A) * true.inv()).magnitude()
    assert np.degrees(off.max()) < 1.5
    acceleration = true.apply(scene.imu.acc) + it.made.parameters["gravity"]
    error = np.linalg.norm(scene.acceleration - acceleration, axis=1)
    assert error.max() < 1.5 * off.max() * np.linalg.norm(scene.imu.acc, axis=1).max()
    point = interpolate(truth.t_s, truth.position, scene.frame_t)
    distance = np.linalg.norm(scene.point - point, axis=1)[scene.visible]
    assert distance.max() < 0.003  # 1 degree over a lever of 0.1 m, and the truth between samples


def test_the_graphs_path_and_the_truth_are_not_looked_at(behind: Solved):
    nonsense = np.where(np.isfinite(behind.recovery.position), 7.0, np.nan)
    blind = replace(
        behind.recovery,
        position=nonsense,
        quaternion=np.full_like(behind.recovery.quaternion, 0.5),
        velocity=nonsense,
        joints={},
        joint_covariance={},
    )
    same_or_not = [
        (only(behind), scene)
        for scene in (
            *scenes_of(behind.recording, blind),
            *scenes_of(replace(behind.recording, truth=None), behind.recovery),
        )
    ]
    for expected, found in same_or_not:
        for each in fields(Scene):
            value = getattr(expected, each.name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(getattr(found, each.name), value, err_msg=each.name)


def test_known_biases_are_taken_off(behind: Solved):
    calibration = behind.recovery.calibration
    acc, gyro = np.array([0.1, -0.2, 0.3]), np.array([0.01, 0.02, -0.03])
    known = replace(calibration, accelerometer_bias=acc, gyroscope_bias=gyro)
    scene = only(replace(behind, recovery=replace(behind.recovery, calibration=known)))
    np.testing.assert_allclose(scene.imu.acc, behind.recording.imu.acc[scene.rows] - acc)
    np.testing.assert_allclose(scene.imu.gyro, behind.recording.imu.gyro[scene.rows] - gyro)


def test_pauses_of_the_imu_split_the_scenes(behind: Solved):
    from smoother.smoothing import smooth

    imu = behind.recording.imu
    keep = (imu.t_s < 9.0) | (imu.t_s > 9.6)
    recording = replace(behind.recording, imu=imu.select(keep))
    graph = smooth(recording, behind.made.calibration, ALONE)
    before, after = scenes_of(recording, graph)
    assert before.t[-1] < 9.0 < 9.6 < after.t[0]
    assert (before.rows.stop, after.rows.stop) == (after.rows.start, len(recording.imu))
    answered = recover(recording, graph, "pchip")
    np.testing.assert_array_equal(np.isfinite(answered.position), np.isfinite(graph.position))
    # each segment by itself: nothing of the one comes into the other
    alone = recover(recording, graph, "linear-drift")
    truth = behind.made.recording.truth
    error = np.linalg.norm(alone.position - truth.position[keep], axis=1)
    assert np.nanmax(error[~graph.occluded]) < 0.04


def test_stamps_that_a_radio_made_uneven_get_their_answers(behind: Solved):
    from smoother.smoothing import smooth

    rng = np.random.default_rng(5)
    imu = behind.recording.imu
    step = float(np.median(np.diff(imu.t_s)))
    uneven = imu.t_s + step * rng.uniform(-0.4, 0.4, len(imu))
    recording = replace(behind.recording, imu=replace(imu, t_s=uneven))
    graph = smooth(recording, behind.made.calibration, ALONE)
    (scene,) = scenes_of(recording, graph)
    assert np.diff(scene.t).min() > 0.7 * step > np.diff(uneven).min()
    found = recover(recording, graph, "hold")
    np.testing.assert_array_equal(found.t_s, uneven)
    before = found.position[~graph.occluded]
    expected = interpolate(scene.frame_t[scene.visible], scene.point[scene.visible], uneven[~graph.occluded])
    known = np.isfinite(before).all(axis=1)
    # the answer at even times, carried linearly to the stamps
    assert np.abs(before - expected)[known].max() < 0.01
    assert np.allclose(np.linalg.norm(found.quaternion[~graph.occluded][known], axis=1), 1.0)


def test_what_belongs_to_another_recording_is_refused(behind: Solved):
    short = replace(behind.recording, imu=behind.recording.imu.select(slice(0, 500)))
    with pytest.raises(SolveError, match="another recording"):
        scenes_of(short, behind.recovery)
    with pytest.raises(UnoccludeError, match="hold has no option boundary_s"):
        recover(behind.recording, behind.recovery, "hold", "vqf", {"boundary_s": 1.0})
    nothing = replace(behind.recovery, position=np.full_like(behind.recovery.position, np.nan))
    with pytest.raises(SolveError, match="never overlap"):
        scenes_of(behind.recording, nothing)


def test_an_answer_repeats_what_is_the_graphs(behind: Solved):
    found = recover(behind.recording, behind.recovery, "linear-drift", "comotti", {"boundary_s": 0.3})
    graph = behind.recovery
    assert (found.method, found.gaps, found.clock_offset_s) == (
        "linear-drift",
        graph.gaps,
        graph.clock_offset_s,
    )
    assert (
        found.estimates.further["orientation"] == "comotti" and found.estimates.further["boundary_s"] == 0.3
    )
    assert found.estimates.camera_sigma_m == graph.estimates.camera_sigma_m
    assert any("are the graph's" in note for note in found.notes)
    np.testing.assert_array_equal(found.occluded, graph.occluded)
    assert np.isnan(found.pose_covariance).all() and np.isnan(found.joint_covariance["wrist"]).all()


def test_an_answers_joints_and_covariances(behind: Solved):
    """Lever arms on the pose; a joint's covariance by finite differences through pose and lever arm."""
    scene = only(behind)
    count = len(scene.t)
    rng = np.random.default_rng(1)
    spread = np.array([0.01, 0.02, 0.03])
    turning = np.array([0.02, 0.01, 0.03])
    path = Path(
        position=np.cumsum(rng.normal(size=(count, 3)), axis=0),
        covariance=np.tile(np.diag(spread**2), (count, 1, 1)),
        attitude_covariance=np.tile(np.diag(turning**2), (count, 1, 1)),
    )
    found = recovery_of(behind.recording, behind.recovery, [scene], [path], "made up")
    levers = scene.calibration.lever_arms
    row, lever = 700, levers["elbow"]
    R = scene.R_K_A[row]
    at = scene.rows.start + row
    np.testing.assert_allclose(found.joints["elbow"][at], path.position[row] + R @ lever.position_m)
    step, expected = 1e-6, np.diag(spread**2)
    for axis in range(3):
        turned = Rotation.from_rotvec(step * np.eye(3)[axis]).as_matrix() @ R @ lever.position_m
        moved = (turned - R @ lever.position_m) / step
        expected = expected + turning[axis] ** 2 * np.outer(moved, moved)
    expected = expected + R @ np.diag(lever.sigma_m**2) @ R.T
    np.testing.assert_allclose(found.joint_covariance["elbow"][at], expected, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(found.sigma_m[at], spread)
    # residuals: camera minus answer at the frames
    residuals = found.residuals
    frame = int(np.argmin(np.abs(residuals.t_s - scene.t[row])))
    wrist = JOINTS.index("wrist")
    at_frame = interpolate(scene.t, found.joints["wrist"][scene.rows], residuals.t_s[[frame]])[0]
    seen = behind.recording.arm.position[frame, wrist]
    np.testing.assert_allclose(residuals.residual[frame, wrist], seen - at_frame)
