"""Times of an even sensor from stamps that repeat, go back, wrap around or come in bursts."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measurements.timestamps import counted, even_times, needs_counting, unwrapped


def delivered(seed: int, pauses: tuple[float, ...] = (), count: int = 12_000) -> tuple[np.ndarray, ...]:
    """Times of a 100 Hz sensor whose clock is off by 0.04 %, and stamps of which 40 % are a burst's."""
    rng = np.random.default_rng(seed)
    t = np.arange(count) * 0.01 * 1.0004
    for number, length in enumerate(pauses):
        t[(number + 1) * count // (len(pauses) + 1) :] += length
    arrivals = np.sort(rng.uniform(0, t[-1] + 2, int(t[-1] / 0.06)))
    late = arrivals[np.minimum(np.searchsorted(arrivals, t), len(arrivals) - 1)]
    return t, np.where(rng.random(count) < 0.6, t + rng.normal(0, 0.002, count), late)


@pytest.mark.parametrize("pauses", [(), (3.0,), (1.0, 0.5, 7.0)])
def test_bursts(pauses: tuple[float, ...]):
    for seed in range(3):
        t, stamps = delivered(seed, pauses)
        assert (np.diff(stamps) <= 0).mean() > 0.3 and needs_counting(stamps)
        even = even_times(stamps)
        assert even is not None and even.pauses == len(pauses) and even.clock_resets == 0
        # A constant delay does no harm, a wandering one does: 1 ms is a tenth of a period.
        assert np.std(even.t_s - t) < 1e-3 and abs(np.median(even.t_s - t)) < 0.005
        assert (np.diff(even.t_s) > 0).all()


def test_a_stall_that_is_caught_up_is_no_pause():
    t = np.arange(6000) / 100.0
    stamps = t + np.random.default_rng(0).normal(0, 1e-3, len(t))
    stamps[3000:3200] = stamps[3200]  # 2 s of samples at once
    even = even_times(stamps)
    assert even is not None and even.pauses == 0 and np.abs(even.t_s - t).max() < 2e-3


def test_whole_seconds_and_a_clock_set_back():
    t = np.arange(6000) / 100.0
    even = even_times(np.floor(t))
    assert even is not None and np.std(even.t_s - t) < 1e-3
    stamps = t.copy()
    stamps[3000:] -= 4.0
    even = even_times(stamps)
    assert even is not None and even.clock_resets == 1 and np.abs(even.t_s - t).max() < 1e-6


def test_an_uneven_sensor_is_not_made_even():
    rng = np.random.default_rng(1)
    steps = rng.exponential(0.01, 6000)
    steps[rng.random(6000) < 0.02] = 0.0
    assert even_times(np.cumsum(steps)) is None
    assert even_times(np.zeros(6000)) is None and even_times(np.arange(10.0)) is None


def test_good_stamps_need_nothing():
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.006, 0.014, 3000))
    t[1500:] += 3.0
    assert not needs_counting(t)


@pytest.mark.parametrize("wrap_s", [2**32 * 1e-6, 2**24 / 32768, 86_400.0])
def test_wraps(wrap_s: float):
    t = wrap_s - 3.0 + np.arange(1000) / 100.0
    went_on, wraps = unwrapped(np.mod(t, wrap_s))
    assert wraps == 1 and np.allclose(went_on, t, atol=1e-6)
    assert unwrapped(np.array([0.0, 1.0, 0.5]))[1] == 0


def test_counters():
    number = np.delete(np.arange(70_000), [500, 501, 40_000])
    counts, restarts = counted((number + 65_000) % 65_536, 65_536)
    assert np.array_equal(counts, number) and restarts == 2
    assert np.array_equal(
        counted(np.array([0, 4, 8, 16]), 0)[0], [0, 1, 2, 4]
    )  # counts ticks of a faster clock
    assert np.array_equal(counted(np.array([900, 901, 5, 6]), 65_536)[0], [0, 1, 2, 3])  # started anew


def test_a_counter_and_bad_stamps():
    t, stamps = delivered(0)
    keep = np.random.default_rng(3).random(len(t)) > 0.05
    even = even_times(stamps[keep], np.flatnonzero(keep))
    assert even is not None and np.std(even.t_s - t[keep]) < 1e-3
