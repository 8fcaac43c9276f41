"""What is known before a window is solved: lengths and noise as they were measured, within bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_segments import ELBOW, forearm, still_imu

from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.config import Config
from smoother.recording import JOINTS, JointState, JointTracks
from smoother.window.priors import (
    LARGEST_UPPER_ARM_SIGMA_M,
    LEAST_DENSITY_SHARE,
    calibration_from,
    upper_arm_length_sigma,
    upper_arm_seen,
    with_measured_noise,
    with_measured_shoulder,
)
from smoother.window.shared import Gaussian, SharedLayout, axes_across

SHOULDER = JOINTS.index("shoulder")
CONFIG = Config()
FLEX_M = CONFIG.arm.upper_arm_flex_m


@pytest.mark.parametrize(
    ("spread_m", "sample_m", "expected"),
    [
        (0.02, 0.0, 0.02),
        (0.025, 0.0125, np.sqrt(0.025**2 - 2 * 0.0125**2)),  # of both ends, by noise alone
        (0.02, 0.02, FLEX_M),
        (0.1, 0.0, LARGEST_UPPER_ARM_SIGMA_M),
    ],
)
def test_how_constant_the_upper_arms_length_is(spread_m: float, sample_m: float, expected: float) -> None:
    segment, rng = forearm(3000), np.random.default_rng(0)
    position = segment.position.copy()
    position[:, SHOULDER] = position[:, ELBOW]
    position[:, SHOULDER, 1] += np.abs(0.31 + spread_m * rng.normal(size=3000))
    seen = replace(segment, position=position, accepted=np.isfinite(position).all(axis=2))
    assert upper_arm_length_sigma([segment, seen], CONFIG, sample_m) == pytest.approx(expected, rel=0.04)
    assert upper_arm_seen([segment, seen], CONFIG).value_m == pytest.approx(0.31, abs=0.1 * spread_m)
    assert upper_arm_length_sigma([segment], CONFIG, 0.0) == FLEX_M
    assert upper_arm_seen([segment], CONFIG) == Length(CONFIG.arm.upper_arm_m, CONFIG.arm.upper_arm_sigma_m)


@pytest.mark.parametrize(("walk", "is_used"), [(0.2, True), (0.4, True), (0.02, False)])
def test_a_shoulder_that_wanders_faster_than_usual(walk: float, is_used: bool) -> None:
    """By steps over a time, so that the noise of single frames and a jump now and then hardly count."""
    rng, t = np.random.default_rng(1), np.arange(9000) / 30.0
    position, state = np.full((9000, 5, 3), np.nan), np.zeros((9000, 5), np.int8)
    position[:, SHOULDER] = np.cumsum(walk * rng.normal(size=(9000, 3)) / np.sqrt(30.0), axis=0)
    position[4000:, SHOULDER] += 20.0
    state[:, SHOULDER] = JointState.TRACKED
    tracks = JointTracks("camera", t, position, state)
    found = with_measured_shoulder(CONFIG, tracks).arm.shoulder_walk
    assert found == (pytest.approx(walk, rel=0.2) if is_used else CONFIG.arm.shoulder_walk)
    stated = Config.model_validate({"arm": {"shoulder_walk": 0.05}})
    assert with_measured_shoulder(stated, tracks) is stated
    assert with_measured_shoulder(CONFIG, tracks.select(slice(0, 40))) is CONFIG


def test_a_measured_density_counts_but_no_better_than_a_sensor_can_be_nor_against_a_stated_one() -> None:
    usual, imu = CONFIG.imu, still_imu(1.0)
    imu = replace(imu, accelerometer_density=2.0 * usual.accelerometer_density, gyroscope_density=1e-12)
    found = with_measured_noise(CONFIG, imu).imu
    assert found.accelerometer_density == imu.accelerometer_density
    assert found.gyroscope_density == pytest.approx(LEAST_DENSITY_SHARE * usual.gyroscope_density)
    stated = Config.model_validate({"imu": {"accelerometer_density": 0.5}})
    assert with_measured_noise(stated, imu).imu.accelerometer_density == 0.5
    assert with_measured_noise(CONFIG, still_imu(1.0)) is CONFIG


def test_a_calibration_states_the_camera_s_own_error_with_its_sigmas() -> None:
    layout = SharedLayout(("elbow", "wrist"), True, axes_across(np.array([0.0, -1.0, 0.1])))
    mean = np.arange(1.0, layout.size - layout.constants.start + 1.0)
    constants = Gaussian(mean, np.diag((0.001 * mean) ** 2))
    before = ArmCalibration("right", {"hand": LeverArm(np.ones(3), np.ones(3))}, Length(0.3, 0.1))
    found = calibration_from(constants, layout, before, 0.004)
    assert found.upper_arm == Length(1.0, pytest.approx(np.hypot(0.001, 0.004)))
    for joint, rows in (("elbow", [2.0, 3, 4]), ("wrist", [5.0, 6, 7])):
        np.testing.assert_array_equal(found.lever_arms[joint].position_m, rows)
        np.testing.assert_allclose(found.lever_arms[joint].sigma_m, np.hypot(0.001 * np.array(rows), 0.004))
    assert found.lever_arms["hand"] is before.lever_arms["hand"]
