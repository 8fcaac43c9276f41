"""An IMU that was taken off lies still while the camera sees the arm move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother.config import Config
from smoother.recording import Recording
from smoother.recovery.change_signs import imu_lies_still
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})
NO_BIAS = np.zeros(3)


@pytest.fixture(scope="module")
def sound() -> tuple[Recovery, Recording]:
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=25.0)
    recording = replace(simulate_arm(config, 6).recording, truth=None)
    return smooth(recording, config=ONE_PROCESS), recording


def taken_off(recording: Recording, at_s: float) -> Recording:
    """From then on the IMU lies on a table."""
    imu, rng = recording.imu, np.random.default_rng(0)
    late = imu.t_s > at_s
    acc, gyro = imu.acc.copy(), imu.gyro.copy()
    acc[late] = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.02, (late.sum(), 3))
    gyro[late] = rng.normal(0.0, 0.002, (late.sum(), 3))
    return replace(recording, imu=replace(imu, acc=acc, gyro=gyro))


def test_a_worn_imu_is_not_named(sound: tuple[Recovery, Recording]) -> None:
    assert list(imu_lies_still(*sound, NO_BIAS)) == []


def test_an_arm_at_rest_is_not_named(sound: tuple[Recovery, Recording]) -> None:
    """Camera noise turns the forearm by some degrees."""
    recovery, recording = sound
    arm, rng = recording.arm, np.random.default_rng(1)
    still = np.where(np.isfinite(arm.position), arm.position[:1], np.nan)
    noisy = replace(arm, position=still + rng.normal(0.0, 0.03, still.shape))
    resting = replace(taken_off(recording, 0.0), arm=noisy)
    assert list(imu_lies_still(recovery, resting, NO_BIAS)) == []


def test_from_when_on(sound: tuple[Recovery, Recording]) -> None:
    recovery, recording = sound
    (found,) = imu_lies_still(recovery, taken_off(recording, 14.0), NO_BIAS)
    assert found.start_s == pytest.approx(14.0, abs=0.3) and found.end_s > 24.0
    assert "lies still" in found.reasons[0]
