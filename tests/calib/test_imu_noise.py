"""Allan deviation and what is read from it."""

from __future__ import annotations

import numpy as np
import pytest

from calib.imu.sensor_calibration import allan_deviation, allan_noise, calibrate_imu
from smoother.recording import ImuStream

RATE = 50.0


def white(count: int, density: float, seed: int = 0) -> np.ndarray:
    return density * np.sqrt(RATE) * np.random.default_rng(seed).normal(size=(count, 3))


def test_deviation_is_the_definition():
    """Against the double sum over means of neighbouring intervals (IEEE Std 952)."""
    samples = np.random.default_rng(1).normal(size=(300, 3)).cumsum(axis=0)
    tau, deviation = allan_deviation(samples, RATE)
    for t, found in zip(tau, deviation, strict=True):
        n = round(t * RATE)
        means = np.array([samples[k : k + n].mean(axis=0) for k in range(300 - n + 1)])
        pairs = means[n:] - means[:-n]
        assert np.allclose(found, np.sqrt(0.5 * np.mean(pairs**2, axis=0)), rtol=1e-9)


def test_white_noise_of_a_short_rest():
    found = allan_noise(white(3000, 0.002), RATE)
    assert found.density == pytest.approx(0.002, rel=0.1)  # a minute at 50 Hz
    assert np.isnan(found.walk).all() and np.isnan(found.instability).all()
    assert allan_noise(white(500, 0.002), RATE) is None


def test_random_walk_and_white_noise_of_a_long_rest():
    count = int(3600 * RATE)
    walk = np.cumsum(1e-4 / np.sqrt(RATE) * np.random.default_rng(3).normal(size=(count, 3)), axis=0)
    found = allan_noise(white(count, 0.002, 2) + walk, RATE)
    assert found.density == pytest.approx(0.002, rel=0.03)
    assert np.sqrt(np.nanmean(found.walk**2)) == pytest.approx(
        1e-4, rel=0.35
    )  # few independent long averages


def test_bias_instability_of_flicker_noise():
    count = int(3600 * RATE)
    rng = np.random.default_rng(4)
    spectrum = np.fft.rfft(rng.normal(size=(count, 3)), axis=0)
    frequency = np.fft.rfftfreq(count, 1.0 / RATE)
    frequency[0] = frequency[1]
    level = 1e-3
    # power B^2 / (pi f), one-sided: the Allan variance is (2 ln 2 / pi) B^2 at any averaging time
    shaped = spectrum * np.sqrt(level**2 / (np.pi * frequency) * RATE / 2.0)[:, None]
    flicker = np.fft.irfft(shaped, count, axis=0)
    found = allan_noise(flicker + white(count, 1e-3, 5), RATE)
    assert found.instability == pytest.approx(level, rel=0.2)


def test_a_long_rest_alone_gives_noise_and_bias():
    count = int(120 * RATE)
    acc = white(count, 0.003, 6) + np.array([0.1, 9.7, 0.3])
    gyro = white(count, 2e-4, 7) + np.array([0.01, -0.02, 0.005])
    found = calibrate_imu(ImuStream("/imu/base", np.arange(count) / RATE, acc, gyro))
    assert found.accelerometer is None
    assert found.gyroscope.offset == pytest.approx([0.01, -0.02, 0.005], abs=1e-4)
    tables = found.tables()
    assert tables["accelerometer"]["noise_density"] == pytest.approx(0.003, rel=0.1)
    assert tables["gyroscope"]["noise_density"] == pytest.approx(2e-4, rel=0.1)
    assert "offset" not in tables["accelerometer"]
