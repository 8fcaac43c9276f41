"""Every simulated error has the size and the memory it claims, and is off where it is switched off.

Tolerances: a standard deviation estimated from n independent values scatters by 1 / sqrt(2 n) of itself;
the tests allow five times that or more, so that a change of random numbers does not break them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.interpolate import make_interp_spline
from simulated_points import PointSimulation, simulate_point

from smoother.recording import JOINTS, JointState
from smoother.simulation import ArmSimulation, Preset, SimulatedArm, simulate_arm
from smoother.simulation.camera import runs

SHOULDER, ELBOW, WRIST, HAND, STRAP = range(5)


def make(seed: int = 0, **changes: Any) -> SimulatedArm:
    """A minute and a half of random motion without any error but those given."""
    defaults = {"protocol": "random", "duration_s": 90.0, "occlusion_lengths_s": ()}
    return simulate_arm(ArmSimulation.preset("clean", **{**defaults, **changes}), seed)


def residual(simulated: SimulatedArm, latency_s: float = 0.0) -> np.ndarray:
    """(F, 4, 3) camera minus truth at the moment of exposure, frames near the ends left out."""
    tracks, truth = simulated.recording.arm, simulated.recording.truth
    assert truth is not None
    moment = tracks.t_s - latency_s
    inside = (moment > 0.2) & (moment < truth.t_s[-1] - 0.2)
    at = [make_interp_spline(truth.t_s, truth.joints[joint], k=5)(moment[inside]) for joint in JOINTS[:4]]
    return tracks.position[inside, :4] - np.stack(at, axis=1)


def test_clean_is_clean():
    simulated = make()
    np.testing.assert_allclose(residual(simulated), 0, atol=2e-5)  # the test's own interpolation
    np.testing.assert_array_equal(simulated.recording.imu.acc, simulated.ideal_imu.acc)
    np.testing.assert_array_equal(simulated.recording.imu.gyro, simulated.ideal_imu.gyro)
    np.testing.assert_allclose(np.diff(simulated.recording.arm.t_s), 1 / 30, atol=1e-9)
    assert (simulated.recording.arm.state[:, :4] == JointState.TRACKED).all()


def test_depth_noise_lies_along_the_ray_and_grows_with_distance():
    sigma = {}
    for distance in (1.5, 3.0):
        simulated = make(noise_depth_m=0.01, distance_m=distance)
        noise = residual(simulated)
        ray = simulated.recording.truth.joints["shoulder"].mean(axis=0)
        ray /= np.linalg.norm(ray)
        along = noise[:, SHOULDER] @ ray
        across = noise[:, SHOULDER] - along[:, None] * ray
        assert across.std() < 0.05 * along.std()  # the shoulder sways a little off its mean ray
        true_distance = np.linalg.norm(simulated.recording.truth.joints["shoulder"].mean(axis=0))
        assert along.std() == pytest.approx(0.01 * (true_distance / 2) ** 2, rel=0.1)
        sigma[distance] = along.std()
    assert sigma[3.0] > 3 * sigma[1.5]


def test_joint_biases_are_constant_and_told():
    drawn = []
    for seed in range(25):
        simulated = make(seed, joint_bias_m=0.008, duration_s=3)
        off = residual(simulated)
        for column, joint in enumerate(JOINTS[:4]):
            told = simulated.parameters["joint_bias"][joint]
            np.testing.assert_allclose(off[:, column], np.tile(told, (len(off), 1)), atol=5e-5)
            drawn.append(told)
    assert np.std(drawn) == pytest.approx(0.008, rel=0.2)  # 300 values


def test_late_stamps_and_the_sign_of_the_offset():
    simulated = make(latency_s=0.02)
    assert simulated.parameters["clock_offset_s"] == -0.02  # t_imu = t_camera + offset
    np.testing.assert_allclose(residual(simulated, latency_s=0.02), 0, atol=2e-5)
    assert residual(simulated)[:, WRIST].std() > 0.005  # half a metre a second for 20 ms


def test_outliers():
    simulated = make(outliers=0.02, outlier_m=0.3, occlusion_lengths_s=(1.0,))
    off = np.linalg.norm(residual(simulated), axis=2)
    wrong = off > 0.01
    assert wrong.sum() / np.isfinite(off).sum() == pytest.approx(0.02, abs=0.006)  # sigma 0.0014
    np.testing.assert_allclose(off[wrong], 0.3, atol=1e-3)
    assert simulated.parameters["outliers"] >= wrong.sum()


def test_imu_noise_density():
    simulated = make(accelerometer_noise=0.003, gyroscope_noise=0.0003, imu_rate_hz=100)
    imu, ideal = simulated.recording.imu, simulated.ideal_imu
    np.testing.assert_allclose((imu.acc - ideal.acc).std(axis=0), 0.003 * 10, rtol=0.05)
    np.testing.assert_allclose((imu.gyro - ideal.gyro).std(axis=0), 0.0003 * 10, rtol=0.05)


def test_scale_and_misalignment():
    scales, crosses = [], []
    for seed in range(30):
        simulated = make(seed, imu_scale=0.003, imu_misalignment_deg=0.2, duration_s=3)
        for sensor, measured, true in (
            ("accelerometer", simulated.recording.imu.acc, simulated.ideal_imu.acc),
            ("gyroscope", simulated.recording.imu.gyro, simulated.ideal_imu.gyro),
        ):
            matrix = simulated.parameters[f"{sensor}_matrix"]
            np.testing.assert_allclose(measured, true @ matrix.T, atol=1e-12)
            scales.extend(np.diag(matrix) - 1)
            crosses.extend(matrix[~np.eye(3, dtype=bool)])
    assert np.std(scales) == pytest.approx(0.003, rel=0.25)  # 180 values
    assert np.std(crosses) == pytest.approx(np.radians(0.2), rel=0.2)


def test_saturation():
    imu = make(accelerometer_range=10.0, gyroscope_range=2.0).recording.imu
    assert np.abs(imu.acc).max() == 10.0
    assert np.abs(imu.gyro).max() == 2.0


@pytest.mark.parametrize("state", ["inferred", "not_tracked"])
def test_the_belly_can_be_poor(state: str):
    simulated = simulate_arm(ArmSimulation.preset("clean", belly=state, repetitions=2), 0)
    lost = (simulated.recording.arm.state[:, WRIST] == JointState[state.upper()]) & ~simulated.occluded
    stretches = [gap.stop - gap.start for gap in runs(lost)]
    assert len(stretches) == 2
    assert all(1.5 < frames / 30 < 5 for frames in stretches)


@pytest.mark.parametrize("side", ["right", "left"])
def test_swapped_arms_are_the_other_arm_and_say_tracked(side: str):
    simulated = simulate_arm(ArmSimulation.preset("white", swapped_gaps=1.0, side=side), 0)
    assert len(simulated.parameters["swapped"]) == 4
    tracks, outward = simulated.recording.arm, 1 if side == "right" else -1
    for gap in runs(simulated.occluded):
        assert (tracks.state[gap, ELBOW : HAND + 1] == JointState.TRACKED).all()
        across = tracks.joint("shoulder")[gap, 0] - tracks.joint("wrist")[gap, 0]
        assert (outward * across > 0.2).all()
        assert (tracks.joint("wrist")[gap, 1] < tracks.joint("shoulder")[gap, 1] - 0.35).all()


@pytest.mark.slow
@pytest.mark.parametrize("preset", list(Preset))
def test_a_seed_is_a_recording(preset: Preset):
    config = ArmSimulation.preset(preset, repetitions=1)
    one, again, other = simulate_arm(config, 7), simulate_arm(config, 7), simulate_arm(config, 8)
    for name in ("t_s", "acc", "gyro"):
        np.testing.assert_array_equal(getattr(one.recording.imu, name), getattr(again.recording.imu, name))
    for name in ("t_s", "position", "state"):
        np.testing.assert_array_equal(getattr(one.recording.arm, name), getattr(again.recording.arm, name))
    assert not np.array_equal(one.recording.imu.acc[:100], other.recording.imu.acc[:100])
    point = PointSimulation.preset(preset, duration_s=5)
    np.testing.assert_array_equal(
        simulate_point(point, 7).recording.imu.acc, simulate_point(point, 7).recording.imu.acc
    )


def test_errors_do_not_change_the_motion():
    clean = simulate_arm(ArmSimulation.preset("clean"), 3)
    spoilt = simulate_arm(ArmSimulation.preset("realistic", wobble_deg=0.0, outliers=0.1), 3)
    np.testing.assert_array_equal(clean.recording.truth.position, spoilt.recording.truth.position)
    np.testing.assert_array_equal(clean.ideal_imu.acc, spoilt.ideal_imu.acc)


def test_wrong_settings_are_refused():
    for changes in ({"noise": 1}, {"noise_m": -1}, {"noise_m": float("nan")}, {"dropped_frames": 1.0}):
        with pytest.raises(ValidationError):
            ArmSimulation(**changes)
    for changes in ({"joint_slow_m": (-0.01,)}, {"joint_slow_m": (0.01,) * 6}, {"joint_off_m": (0.1,) * 3}):
        with pytest.raises(ValidationError):
            ArmSimulation(**changes)
    with pytest.raises(ValueError):
        ArmSimulation.preset("perfect")


@pytest.mark.parametrize("seed", [0, 1])
def test_another_person_may_take_longer_or_not_so_long(seed: int):
    config = ArmSimulation.preset("white", repetitions=1, cameras=(60.0,), camera_fault="other_person")
    (camera,) = simulate_arm(config, seed).recording.cameras
    assert len(camera.arm) > 300
    assert np.isfinite(camera.arm.joint("shoulder")).all()
