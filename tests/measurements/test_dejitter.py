"""Stamps that a radio made uneven, and stamps that are to be left alone."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measurements.timestamps import dejitter

RATE_HZ = 80.0


def ticks(count: int = 4000) -> np.ndarray:
    return np.arange(count) / RATE_HZ


def test_good_stamps_come_back_unchanged() -> None:
    assert dejitter(ticks()) is not None
    np.testing.assert_array_equal(dejitter(ticks()), ticks())


@pytest.mark.parametrize("sigma_s", [0.003, 0.005])
def test_scatter_is_taken_off(sigma_s: float) -> None:
    rng = np.random.default_rng(0)
    stamps = np.sort(ticks() + rng.normal(0.0, sigma_s, 4000))
    error = dejitter(stamps) - ticks()
    # 4 s of samples average 320 stamps: sigma / 18, and four of those bound all of them; at the ends the
    # average is of fewer
    assert np.abs(error[200:-200]).max() < 4 * sigma_s / np.sqrt(320) + 2e-4
    assert np.abs(error).max() < 0.5 * np.abs(stamps - ticks()).max()


def test_packets_of_four_become_even() -> None:
    k = np.arange(2400)
    arrival = ticks(2400)[np.minimum((k // 4) * 4 + 3, 2399)] + (k % 4) * 1e-3
    steadied = dejitter(arrival)
    assert np.ptp(np.diff(arrival)) > 0.04
    assert np.ptp(np.diff(steadied)) < 0.002


def test_a_slow_drift_stays() -> None:
    rng = np.random.default_rng(1)
    true = ticks() * 1.0003 + 0.003 * np.sin(ticks() / 8.0)
    steadied = dejitter(np.sort(true + rng.normal(0.0, 0.003, 4000)))
    middle = slice(200, -200)  # the average leans at the ends
    assert np.abs(steadied - true)[middle].max() < 1.5e-3


def test_a_missing_sample_leaves_the_stamps_alone() -> None:
    rng = np.random.default_rng(2)
    stamps = np.delete(np.sort(ticks() + rng.normal(0.0, 0.002, 4000)), 2000)
    np.testing.assert_array_equal(dejitter(stamps), stamps)
