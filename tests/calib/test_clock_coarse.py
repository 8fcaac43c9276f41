"""Clocks that are seconds apart: the coarse search, and the motion's offset about it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.clock.motion_clock import COARSE_S, clock_from_motion
from smoother.cli.config import with_processes
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.recording import Recording
from smoother.selfcal.pairing import coarse_offset
from smoother.simulation import ArmSimulation, simulate_arm


def later(recording: Recording, offset_s: float) -> Recording:
    return replace(recording, imu=replace(recording.imu, t_s=recording.imu.t_s + offset_s))


@pytest.fixture(scope="module")
def moving() -> Recording:
    return simulate_arm(ArmSimulation.preset("realistic", protocol="random", duration_s=40.0), 3).recording


@pytest.mark.parametrize("offset_s", [-12.3, -0.7, 1.234, 9.5])
def test_a_large_offset_is_found_roughly(moving, offset_s):
    # the fine search reaches 0.4 s; smoothed speeds on a 50 Hz grid are good to some frames
    assert abs(coarse_offset(later(moving, offset_s), COARSE_S) - offset_s) < 0.15


def test_a_small_offset_is_left_to_the_fine_search(moving):
    assert coarse_offset(later(moving, 0.15), COARSE_S) == 0.0


def test_motion_finds_an_offset_of_seconds_as_well_as_none(moving):
    config = with_processes(Config(), 1)
    near = clock_from_motion(moving, None, config).link
    far = clock_from_motion(later(moving, 3.21), None, config).link
    # the stretches are cut elsewhere, so the two differ by their noise
    assert abs(far.offset_s - 3.21 - near.offset_s) < 3 * np.hypot(near.sigma_s, far.sigma_s)
    assert far.sigma_s < 0.003


def test_periodic_motion_seconds_apart_is_refused(moving):
    t_c, t_i = moving.arm.t_s, moving.imu.t_s
    angle = 0.8 * np.sin(2 * np.pi * 0.5 * t_c)
    position = np.zeros_like(moving.arm.position)
    position[:, :, 2] = 2.0
    wrist = 2
    position[:, wrist, 0], position[:, wrist, 1] = 0.25 * np.cos(angle), 0.25 * np.sin(angle)
    gyro = np.zeros((len(t_i), 3))
    gyro[:, 2] = 0.8 * np.pi * np.cos(2 * np.pi * 0.5 * t_i)
    recording = replace(
        moving,
        arm=replace(moving.arm, position=position, state=np.full_like(moving.arm.state, 2)),
        imu=replace(moving.imu, gyro=gyro),
    )
    with pytest.raises(CalibrationError, match="irregular motion"):
        coarse_offset(later(recording, 0.5), 0.1)
