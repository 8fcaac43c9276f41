"""An IMU's calibration: rest poses, Allan deviation, the magnetometer's ellipsoid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calib.imu import (
    GRAVITY,
    AccelerometerCalibration,
    MagnetometerCalibration,
    Rests,
    allan_deviation,
    calibrate_accelerometer,
    calibrate_gyroscope,
    calibrate_imu,
    calibrate_magnetometer,
    find_rests,
    imu_answer,
    noise_density,
    running_bias,
    symmetric,
)
from smoother.errors import CalibrationError
from smoother.linalg import sphere
from smoother.recording import ImuStream
from smoother.simulation.rig import REST_POSES, SensorModel, magnetometer_turns, rest_poses


def sensor(seed: int, scale: float = 0.03, cross: float = 0.01) -> SensorModel:
    return SensorModel.draw(seed, offset=0.5, scale=scale, cross=cross)


def corrected(found: AccelerometerCalibration | MagnetometerCalibration, raw: np.ndarray) -> np.ndarray:
    return (raw - found.offset) @ found.matrix.T


def rests_of(acc: np.ndarray) -> Rests:
    """Rests without noise, as means."""
    count = len(acc)
    spans = np.stack([100 * np.arange(count), 100 * np.arange(count) + 100], axis=1)
    return Rests(spans, acc, np.zeros((count, 3)), np.zeros(3), np.zeros(3), np.arange(count))


@pytest.mark.parametrize("seed", range(20))
def test_twelve_poses_correct_to_a_centimetre_a_second_squared(seed):
    model = sensor(seed)
    stream, bias = rest_poses(model, 12, seed=seed)
    found = calibrate_imu(stream)
    up = GRAVITY * sphere(300)
    error = corrected(found.accelerometer, model.distort(up)) - up
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.01
    assert found.accelerometer.poses == 12
    # 12 rests of some 190 samples with 0.002 rad/s of noise: 4e-5 rad/s a sigma
    assert np.abs(found.gyroscope.offset - bias).max() < 2e-4


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.05, 0.3])
def test_rests_are_found_whatever_the_noise(noise):
    stream, _ = rest_poses(sensor(1), 10, seed=1, acc_noise=noise, gyro_noise=noise / 20.0)
    rests = find_rests(stream)
    assert len(rests) == rests.poses == 10
    for k, (first, last) in enumerate(rests.ranges):  # rests of 2 s begin every 3 s
        assert 3.0 * k - 0.3 < stream.t_s[first] < 3.0 * k + 0.3
        assert 3.0 * k + 1.6 < stream.t_s[last - 1] < 3.0 * k + 2.3


def test_a_slow_turn_is_no_rest():
    t = np.arange(0.0, 60.0, 0.01)
    angle = np.radians(6.0) * t
    acc = GRAVITY * np.stack([np.sin(angle), np.zeros(len(t)), np.cos(angle)], axis=1)
    gyro = np.tile([0.0, np.radians(6.0), 0.0], (len(t), 1))
    noise = np.random.default_rng(0).normal(0.0, 0.01, (len(t), 3))
    assert len(find_rests(ImuStream("slow", t, acc + noise, gyro + 0.1 * noise))) == 0


def test_the_fit_is_the_minimum_of_the_published_cost():
    """Against a plain minimiser with numeric derivatives on mean((|S (V - O)|^2 - g^2)^2)."""
    rng = np.random.default_rng(5)
    raw = sensor(5).distort(GRAVITY * REST_POSES[:14]) + rng.normal(0.0, 0.02, (14, 3))
    found = calibrate_accelerometer(rests_of(raw), GRAVITY)

    def misfit(p: np.ndarray) -> np.ndarray:
        return np.array([np.sum((symmetric(p[3:]) @ (v - p[:3])) ** 2) - GRAVITY**2 for v in raw])

    plain = least_squares(misfit, [0.1, 0.1, 0.1, 1, 0, 0, 1, 0, 1], jac="3-point", xtol=1e-14, ftol=1e-14)
    assert np.allclose(plain.x[:3], found.offset, atol=1e-6)
    assert np.allclose(symmetric(plain.x[3:]), found.matrix, atol=1e-7)


def test_gyroscope_running_rule_without_a_rest():
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 40.0, 0.01)
    bias = np.array([0.02, -0.01, 0.03])
    swing = 0.05 * np.sin(2.0 * np.pi * 0.5 * t)[:, None] * [1.0, 0.7, -0.5]
    acc = np.tile([0.0, 0.0, GRAVITY], (len(t), 1)) + 0.5 * rng.normal(size=(len(t), 3))
    gyro = bias + swing + 0.005 * rng.normal(size=(len(t), 3))
    found = calibrate_gyroscope(ImuStream("held", t, acc, gyro), find_rests(ImuStream("held", t, acc, gyro)))
    assert found.rule == "running"
    # the running mean follows a swing of 2 s with a memory of 5 s: a sixth of its amplitude stays
    assert np.abs(found.offset - bias).max() < 0.015


def test_running_mean_is_the_recursion_of_the_paper():
    gyro = np.random.default_rng(4).normal(0.0, 0.03, (2000, 3))
    path, stable = running_bias(gyro)
    mean, count, slow = np.zeros(3), 0, []
    for before, value in pairwise(gyro):
        if (np.abs(value - before) < np.radians(3.0)).all():
            count = min(count + 1, 500)
            mean = mean + (value - mean) / count
            slow.append(mean)
    assert stable.sum() == len(slow)
    assert np.allclose(path, slow, atol=1e-12)


def test_a_knock_does_not_part_a_rest():
    rng = np.random.default_rng(1)
    acc = np.array([0.0, 0.0, GRAVITY]) + 0.02 * rng.normal(size=(4000, 3))
    acc[2000:2004] += 3.0
    stream = ImuStream("/imu", np.arange(4000) / 100.0, acc, 0.002 * rng.normal(size=(4000, 3)), None)
    assert find_rests(stream).ranges.tolist() == [[0, 4000]]


RATE = 50.0


def white(count: int, density: float, seed: int = 0) -> np.ndarray:
    return density * np.sqrt(RATE) * np.random.default_rng(seed).normal(size=(count, 3))


@pytest.mark.parametrize("n", [1, 7, 33])
def test_deviation_is_the_definition(n: int):
    """Against the double sum over means of neighbouring intervals (IEEE Std 952)."""
    samples = np.random.default_rng(1).normal(size=(300, 3)).cumsum(axis=0)
    means = np.array([samples[k : k + n].mean(axis=0) for k in range(300 - n + 1)])
    pairs = means[n:] - means[:-n]
    assert np.allclose(allan_deviation(samples, n), np.sqrt(0.5 * np.mean(pairs**2, axis=0)), rtol=1e-9)


def test_white_noise_beside_a_random_walk():
    count = int(3600 * RATE)
    walk = np.cumsum(1e-4 / np.sqrt(RATE) * np.random.default_rng(3).normal(size=(count, 3)), axis=0)
    assert noise_density(white(count, 0.002, 2) + walk, RATE) == pytest.approx(0.002, rel=0.03)
    assert noise_density(white(900, 0.002), RATE) is None


def test_a_long_rest_alone_gives_noise_and_bias():
    count = int(120 * RATE)
    acc = white(count, 0.003, 6) + np.array([0.1, 9.7, 0.3])
    gyro = white(count, 2e-4, 7) + np.array([0.01, -0.02, 0.005])
    found = calibrate_imu(ImuStream("/imu/base", np.arange(count) / RATE, acc, gyro))
    assert found.accelerometer is None
    assert found.gyroscope.offset == pytest.approx([0.01, -0.02, 0.005], abs=1e-4)
    tables = imu_answer(found).table.tables["imu"]["base"]
    assert tables["accelerometer"]["noise_density"] == pytest.approx(0.003, rel=0.1)
    assert tables["gyroscope"]["noise_density"] == pytest.approx(2e-4, rel=0.1)
    assert "offset" not in tables["accelerometer"]


def lengths(found: MagnetometerCalibration, model: SensorModel) -> np.ndarray:
    """Of the field in every direction, corrected."""
    return np.linalg.norm(corrected(found, model.distort(sphere(400))), axis=1)


@pytest.mark.parametrize("seed", range(20))
def test_radius_to_half_a_percent(seed):
    model = sensor(seed, 0.2, 0.2)
    found = calibrate_magnetometer(magnetometer_turns(model, 3000, noise=0.01, seed=seed))
    assert np.abs(lengths(found, model) - 1.0).max() < 0.005
    assert found.residual == pytest.approx(0.01, rel=0.2)


def test_a_magnet_that_passes_by_does_not_pull():
    model = sensor(4, 0.2, 0.2)
    raw = magnetometer_turns(model, 3000, noise=0.005, seed=4)
    raw[500:620] += [0.4, -0.3, 0.2]
    found = calibrate_magnetometer(raw)
    assert np.sqrt(np.mean((lengths(found, model) - 1.0) ** 2)) < 0.01
    assert found.strays > 0.005


def about_one_axis(wobble_deg: float) -> np.ndarray:
    """A magnetometer that is turned about z, tipped to and fro by so much."""
    angle = np.linspace(0.0, 40.0, 3000)
    tip = np.radians(wobble_deg) * np.sin(1.7 * angle)
    R = Rotation.from_euler("ZX", np.stack([angle, tip], axis=1)).inv()
    raw = R.apply([0.5, 0.0, -0.86]) + np.random.default_rng(0).normal(0.0, 0.01, (3000, 3))
    return np.asarray(48.0 * raw)


RNG, CIRCLE = np.random.default_rng(0), np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
AROUND = GRAVITY * np.stack([np.cos(CIRCLE), np.sin(CIRCLE), np.zeros(12)], axis=1)
SHAKEN = RNG.normal([0, 0, 9.8], 5, (3000, 3)), RNG.normal(0, 2, (3000, 3))
TWICE = rests_of(sensor(3).distort(np.tile(GRAVITY * REST_POSES[:6], (2, 1))))
POINTS = sphere(3000)


@pytest.mark.parametrize(
    ("calibrate", "given", "words"),
    [
        (calibrate_imu, rest_poses(sensor(3), 8, seed=3)[0], r"8 different rest poses.*at least 9 poses"),
        (calibrate_imu, ImuStream("shaken", np.arange(3000) / 100, *SHAKEN), "never still"),
        (calibrate_accelerometer, replace(TWICE, pose=TWICE.pose % 6), "6 different rest poses in 12 rests"),
        (calibrate_accelerometer, rests_of(sensor(0).distort(AROUND)), r"undetermined.*points up"),
        *((calibrate_magnetometer, about_one_axis(tip), "one axis only|sphere open") for tip in (0, 5, 15)),
        (calibrate_magnetometer, POINTS[POINTS[:, 0] > -0.1], "around the sensor's -x"),
        (calibrate_magnetometer, POINTS[:50], "200 are needed"),
        (calibrate_magnetometer, np.ones((500, 3)), "always reads the same"),
        (calibrate_magnetometer, RNG.uniform(-1.0, 1.0, (3000, 3)) ** 3, "ellipsoid"),
    ],
)
def test_what_is_missing_is_said(calibrate: Callable[..., object], given: Any, words: str):
    with pytest.raises(CalibrationError, match=words):
        calibrate(given, *([GRAVITY] if calibrate is calibrate_accelerometer else []))
