"""Samples that cannot be right are found, and sound ones are not."""

from __future__ import annotations

import numpy as np
import pytest
from live_play import simulated

from smoother.body import FOREARM
from smoother.live.imu import ImuCheck, LiveImu
from smoother.recording import ImuStream

RNG = np.random.default_rng(5)
T = np.arange(100) / 100.0


def moving() -> tuple[np.ndarray, np.ndarray]:
    """An arm that swings once a second, with the noise of a sensor."""
    phase = 2 * np.pi * T
    acc = np.stack([3 * np.sin(phase), 2 * np.cos(phase), 9.8 + np.sin(2 * phase)], axis=1)
    gyro = np.stack([2 * np.cos(phase), np.sin(phase), 0.5 * np.sin(phase)], axis=1)
    return acc + RNG.normal(0.0, 0.03, acc.shape), gyro + RNG.normal(0.0, 0.005, gyro.shape)


def doubtful(acc, gyro) -> tuple[np.ndarray, np.ndarray]:
    found, _ = ImuCheck().doubt(T, acc, gyro)
    return found[:, 0] > 0, found[:, 1] > 0


def test_sound_samples_of_simulated_arms_are_not_doubted():
    for seed in (1, 2):
        imu = simulated(seed, 20.0, ()).recording.imu
        buffer, doubted = LiveImu(FOREARM, 60.0), 0
        for first in range(0, len(imu), 5):
            rows = slice(first, first + 5)
            buffer.add(ImuStream("", imu.t_s[rows], imu.acc[rows], imu.gyro[rows]))
            buffer.check(0.0)
            doubted = int((buffer.doubt(-np.inf) > 0).any(axis=1).sum())
        assert doubted <= 0.002 * len(imu)  # an impact may look like a spike


@pytest.mark.parametrize("which", ["both", "acc", "gyro"])
def test_held_values_of_a_moving_arm(which):
    acc, gyro = moving()
    if which != "gyro":
        acc[40:80] = acc[40]
    if which != "acc":
        gyro[40:80] = gyro[40]
    force, rate = doubtful(acc, gyro)
    assert force[41:80].all() == (which != "gyro") and rate[41:80].all() == (which != "acc")
    assert not force[:38].any() and not rate[:38].any()


def test_a_coarse_sensor_that_rests_may_repeat_its_values():
    acc, gyro = np.tile([0.0, 0.0, 9.8], (100, 1)), np.zeros((100, 3))
    force, rate = doubtful(acc, gyro)
    assert not force.any() and not rate.any()


def test_spikes_are_single_samples_and_knocks_stay_possible():
    acc, gyro = moving()
    acc[50] += [0.0, 60.0, 0.0]
    found, _ = ImuCheck().doubt(T, acc, gyro)
    assert np.flatnonzero(found[:, 0]).tolist() == [50]
    # the velocity that is missing where it was a knock: 60 m/s^2 for 10 ms
    assert 0.2 < np.sqrt(found[50, 0]) / 0.6 < 0.6


def test_units_ranges_and_limits():
    acc, gyro = moving()
    assert doubtful(acc / 9.81, gyro)[0].mean() > 0.9
    assert doubtful(acc, gyro * 57.3)[1].mean() > 0.5
    assert doubtful(acc * 1e5, gyro)[0].all()
    acc[60:] = 0.0
    assert doubtful(acc, gyro)[0][62:].all()
    acc, gyro = moving()
    _, rate = doubtful(acc, np.clip(gyro, -1.6, 1.6))
    clipped = (np.abs(gyro) > 1.6).any(axis=1)
    assert rate[clipped].mean() > 0.9 and not rate[~clipped].any()


def test_a_doubtful_stretch_is_replaced_and_left_to_no_calibration():
    acc, gyro = moving()
    acc[40:80], gyro[40:80] = acc[40], gyro[40]
    buffer = LiveImu(FOREARM, 60.0)
    for first in range(0, 100, 5):
        rows = slice(first, first + 5)
        buffer.add(ImuStream("", T[rows], acc[rows], gyro[rows]))
        buffer.check(0.0)
    assert np.abs(buffer.stream(-np.inf).gyro[45:75]).max() == 0.0
    assert len(buffer.sound_stream()) == 61
    assert not buffer.because or buffer.end_s - T[80] < 0.5
