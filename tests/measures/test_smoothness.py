"""Smoothness against published worked examples and a slow version written from the definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from smoother.measures.hand import log_dimensionless_jerk, spectral_arc_length, velocity_peaks

#: The worked example that the authors publish with their own program: a Gaussian speed profile at 100 Hz.
BELL = np.exp(-5.0 * np.arange(-1.0, 1.0, 0.01) ** 2)


def slow_sparc(speed: np.ndarray, rate_hz: float) -> float:
    """Sums and loops instead of a Fourier transform: equation 9 of Balasubramanian et al. 2015."""
    n = len(speed)
    size = 2 ** (math.ceil(math.log2(n)) + 4)
    lines = []
    for k in range(size // 2 + 1):
        if k * rate_hz / size > 10.0:
            break
        turn = 2 * np.pi * k * np.arange(n) / size
        lines.append(math.hypot(float(speed @ np.cos(turn)), float(speed @ np.sin(turn))))
    lines = [line / lines[0] for line in lines]  # a speed is never negative: its mean is the largest line
    last = max(k for k, line in enumerate(lines) if line >= 0.05)
    return -sum(math.hypot(1.0 / last, lines[k + 1] - lines[k]) for k in range(last))


def minimum_jerk_speed(seconds: float, rate_hz: float, peak: float = 1.0) -> np.ndarray:
    u = np.arange(0.0, 1.0 + 1e-9, 1.0 / (seconds * rate_hz))
    return peak * 16.0 * (u**2 - 2 * u**3 + u**4)


def test_the_published_examples():
    assert spectral_arc_length(BELL, 100.0) == pytest.approx(-1.41403, abs=5e-6)
    assert log_dimensionless_jerk(BELL, 100.0) == pytest.approx(-5.81636, abs=5e-6)


def test_minimum_jerk_has_its_analytic_jerk():
    # T^3 / v^2 * integral of jerk^2 = 720 / 1.875^2 = 204.8; differences of 1000 samples are within 1 %
    assert log_dimensionless_jerk(minimum_jerk_speed(1.0, 1000.0), 1000.0) == pytest.approx(
        -math.log(204.8), abs=0.01
    )


@pytest.mark.parametrize("seed", range(3))
def test_sparc_is_what_its_definition_says(seed: int):
    rng = np.random.default_rng(seed)
    speed = minimum_jerk_speed(1.5, 80.0) + 0.3 * np.abs(
        np.convolve(rng.normal(size=121), np.ones(9) / 9, "same")
    )
    assert spectral_arc_length(speed, 80.0) == pytest.approx(slow_sparc(speed, 80.0), abs=1e-9)


def test_neither_size_nor_duration_nor_rate_matter():
    usual = spectral_arc_length(minimum_jerk_speed(1.0, 100.0), 100.0)
    assert spectral_arc_length(minimum_jerk_speed(1.0, 100.0, peak=3.0), 100.0) == pytest.approx(
        usual, abs=1e-9
    )
    # the padded spectrum's step changes with the number of samples: 0.01 of 1.4
    assert spectral_arc_length(minimum_jerk_speed(2.5, 100.0), 100.0) == pytest.approx(usual, abs=0.01)
    assert spectral_arc_length(minimum_jerk_speed(1.0, 60.0), 60.0) == pytest.approx(usual, abs=0.01)
    jerk = log_dimensionless_jerk(minimum_jerk_speed(1.0, 100.0), 100.0)
    assert log_dimensionless_jerk(minimum_jerk_speed(2.5, 100.0), 100.0) == pytest.approx(jerk, abs=0.1)


def test_a_stop_between_makes_a_movement_less_smooth():
    one = minimum_jerk_speed(1.0, 100.0)
    two = np.concatenate([one, np.zeros(20), one])
    assert spectral_arc_length(two, 100.0) < spectral_arc_length(one, 100.0) - 0.5
    assert log_dimensionless_jerk(two, 100.0) < log_dimensionless_jerk(one, 100.0) - 1.0
    assert len(velocity_peaks(one, 100.0, 0.02, 0.15)) == 1
    assert velocity_peaks(two, 100.0, 0.02, 0.15).tolist() == [50, 171]


def test_peaks_that_do_not_stand_out_do_not_count():
    t = np.arange(0.0, 1.0, 0.01)
    bell = np.sin(np.pi * t)
    assert len(velocity_peaks(bell + 0.005 * np.sin(2 * np.pi * 9 * t), 100.0, 0.02, 0.15)) == 1
    assert len(velocity_peaks(bell + 0.2 * np.sin(2 * np.pi * 3 * t), 100.0, 0.02, 0.15)) > 1


@pytest.mark.parametrize("speed", [np.zeros(100), np.ones(5), np.full(50, np.nan)])
def test_what_has_no_smoothness_is_nan(speed: np.ndarray):
    assert math.isnan(spectral_arc_length(speed, 100.0))
    assert math.isnan(log_dimensionless_jerk(speed, 100.0))
