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

from smoother.linalg import runs
from smoother.recording import JOINTS, JointState
from smoother.simulation import ArmSimulation, Preset, SimulatedArm, simulate_arm

SHOULDER, ELBOW, WRIST, HAND, STRAP = range(5)


def make(seed: int = 0, **changes: Any) -> SimulatedArm:
    """A minute and a half of random motion without any error but those given."""
    defaults = {"protocol": "random", "duration_s": 90.0, "occlusion_lengths_s": ()}
    return simulate_arm(ArmSimulation.preset("clean", **{**defaults, **changes}), seed)


def residual(simulated: SimulatedArm, latency_s: float = 0.0) -> np.ndarray:
    """(F, 4, 3) camera minus truth at the moment of exposure, frames near the ends left out."""
    tracks, truth = simulated.recording.arm, simulated.recording.truth
    moment = tracks.t_s - latency_s
    inside = (moment > 0.2) & (moment < truth.t_s[-1] - 0.2)
    at = [make_interp_spline(truth.t_s, truth.joints[joint], k=5)(moment[inside]) for joint in JOINTS[:4]]
    return tracks.position[inside, :4] - np.stack(at, axis=1)


def test_clean_is_clean_and_late_stamps_are_an_offset():
    simulated, late = make(), make(latency_s=0.02)
    np.testing.assert_allclose(residual(simulated), 0, atol=2e-5)  # the test's own interpolation
    for sensor in ("acc", "gyro"):
        measured, ideal = getattr(simulated.recording.imu, sensor), getattr(simulated.ideal_imu, sensor)
        np.testing.assert_array_equal(measured, ideal)
    np.testing.assert_allclose(np.diff(simulated.recording.arm.t_s), 1 / 30, atol=1e-9)
    assert (simulated.recording.arm.state[:, :4] == JointState.TRACKED).all()
    assert late.parameters["clock_offset_s"] == -0.02  # t_imu = t_camera + offset
    np.testing.assert_allclose(residual(late, latency_s=0.02), 0, atol=2e-5)
    assert residual(late)[:, WRIST].std() > 0.005  # half a metre a second for 20 ms


def test_depth_noise_lies_along_the_ray_and_grows_with_distance():
    sigma = {}
    for distance in (1.5, 3.0):
        simulated = make(noise_depth_m=0.01, distance_m=distance)
        noise, place = residual(simulated), simulated.recording.truth.joints["shoulder"].mean(axis=0)
        true_distance = np.linalg.norm(place)
        along = noise[:, SHOULDER] @ (place / true_distance)
        across = noise[:, SHOULDER] - along[:, None] * place / true_distance
        assert across.std() < 0.05 * along.std()  # the shoulder sways a little off its mean ray
        assert along.std() == pytest.approx(0.01 * (true_distance / 2) ** 2, rel=0.1)
        sigma[distance] = along.std()
    assert sigma[3.0] > 3 * sigma[1.5]


def test_constant_errors_are_told():
    biases, scales, crosses = [], [], []
    for seed in range(30):
        simulated = make(seed, joint_bias_m=0.008, imu_scale=0.003, imu_misalignment_deg=0.2, duration_s=3)
        off = residual(simulated)
        for column, joint in enumerate(JOINTS[:4]):
            told = simulated.parameters["joint_bias"][joint]
            np.testing.assert_allclose(off[:, column], np.tile(told, (len(off), 1)), atol=5e-5)
            biases.append(told)
        for sensor, name in (("accelerometer", "acc"), ("gyroscope", "gyro")):
            matrix = simulated.parameters[f"{sensor}_matrix"]
            measured, true = getattr(simulated.recording.imu, name), getattr(simulated.ideal_imu, name)
            np.testing.assert_allclose(measured, true @ matrix.T, atol=1e-12)
            scales.extend(np.diag(matrix) - 1)
            crosses.extend(matrix[~np.eye(3, dtype=bool)])
    assert np.std(biases) == pytest.approx(0.008, rel=0.2)  # 360 values
    assert np.std(scales) == pytest.approx(0.003, rel=0.25)  # 180 values
    assert np.std(crosses) == pytest.approx(np.radians(0.2), rel=0.2)


def test_outliers_and_noise():
    simulated = make(outliers=0.02, outlier_m=0.3, occlusion_lengths_s=(1.0,))
    off = np.linalg.norm(residual(simulated), axis=2)
    wrong = off > 0.01
    assert wrong.sum() / np.isfinite(off).sum() == pytest.approx(0.02, abs=0.006)  # sigma 0.0014
    np.testing.assert_allclose(off[wrong], 0.3, atol=1e-3)
    assert simulated.parameters["outliers"] >= wrong.sum()
    noisy = make(accelerometer_noise=0.003, gyroscope_noise=0.0003, imu_rate_hz=100)
    imu, ideal = noisy.recording.imu, noisy.ideal_imu
    np.testing.assert_allclose((imu.acc - ideal.acc).std(axis=0), 0.003 * 10, rtol=0.05)
    np.testing.assert_allclose((imu.gyro - ideal.gyro).std(axis=0), 0.0003 * 10, rtol=0.05)


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
def test_a_seed_is_a_recording_and_errors_do_not_change_the_motion(preset: Preset):
    config = ArmSimulation.preset(preset, repetitions=1, wobble_deg=0.0)
    one, again, other = simulate_arm(config, 7), simulate_arm(config, 7), simulate_arm(config, 8)
    for stream, names in (("imu", ("t_s", "acc", "gyro")), ("arm", ("t_s", "position", "state"))):
        for name in names:
            first, second = (getattr(getattr(made.recording, stream), name) for made in (one, again))
            np.testing.assert_array_equal(first, second)
    assert not np.array_equal(one.recording.imu.acc[:100], other.recording.imu.acc[:100])
    clean = simulate_arm(ArmSimulation.preset("clean", repetitions=1), 7)
    np.testing.assert_array_equal(clean.recording.truth.position, one.recording.truth.position)
    np.testing.assert_array_equal(clean.ideal_imu.acc, one.ideal_imu.acc)


@pytest.mark.parametrize(
    "changes",
    [
        *({"noise": 1}, {"noise_m": -1}, {"noise_m": float("nan")}, {"dropped_frames": 1.0}),
        *({"joint_slow_m": (-0.01,)}, {"joint_slow_m": (0.01,) * 6}, {"joint_off_m": (0.1,) * 3}),
    ],
)
def test_wrong_settings_are_refused(changes: dict):
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


@pytest.mark.parametrize("frame", ["kinect", "optical", "zup"])
def test_a_further_camera_without_depth_sees_the_arm(frame: str):
    simulated = make(duration_s=8.0, camera_frame=frame, cameras=(60.0,), rgb="further")
    (camera,) = simulated.recording.cameras
    assert (camera.arm.state[:, [SHOULDER, ELBOW, WRIST]] == JointState.TRACKED).mean() > 0.5
