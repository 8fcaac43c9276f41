"""What a dashboard says of a stream."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.streams.session_figures import DelayCounts, StreamHealth


def fed(t, arrival, batch: int = 1) -> tuple[StreamHealth, list[str]]:
    health, events = StreamHealth("wrist"), []
    for start in range(0, len(t), batch):
        part = slice(start, start + batch)
        events += health.look(float(arrival[part][0]) - 1e-6)
        events += health.take(np.asarray(t[part]), np.asarray(arrival[part]))
    return health, events


T = np.arange(0, 30, 0.01)


@pytest.mark.parametrize("batch", [1, 5, 40])
def test_rate_and_delay(batch):
    health, events = fed(T, T + 0.03, batch)
    assert health.rate_hz(T[-1] + 0.03) == pytest.approx(100, rel=0.1)
    assert health.delay_s == pytest.approx(0.03)
    assert (health.count, health.missing, health.late, events) == (3000, 0, 0, [])
    assert health.rate_hz(T[-1] + 20) == 0


@pytest.mark.parametrize("batch", [1, 40])
def test_missing_samples_are_counted(batch):
    kept = np.delete(np.arange(3000), [1000, 1001, 1002, 2000])
    health, _ = fed(T[kept], T[kept], batch)
    assert health.missing == 4


def test_late_samples_are_counted_once_and_not_missed():
    order = np.arange(3000)
    order[[1000, 1001]] = order[[1001, 1000]]
    health, _ = fed(T[order], T, 1)
    assert health.late == 1
    assert health.missing <= 1  # one was not there when the next one came


def test_a_stream_lost_and_back():
    there = (T < 10) | (T > 14)
    health, _ = fed(T[there], T[there], 1)
    assert (health.lost_times, health.is_lost) == (1, False)
    assert health.lost_s == pytest.approx(4.0, abs=0.03)
    assert health.look(30.5) == ()
    (said,) = health.look(32.0)
    assert said == "wrist: nothing since 30.0 s"
    assert health.look(33.0) == ()
    (said,) = health.take(np.array([35.0]), np.array([35.0]))
    assert said == "wrist: back at 35.0 s, after 5.0 s"


def test_a_stream_that_never_sends_counts_as_lost():
    health = StreamHealth("wrist")
    assert health.look(3.0) == health.look(3.9) == ()
    assert health.look(4.1) == ("wrist: nothing since 3.0 s",)
    assert health.rate_hz(4.1) == 0


def test_memory_does_not_grow():
    health, _ = fed(np.arange(0, 500, 0.1), np.arange(0, 500, 0.1))
    assert len(health._arrivals) < 100


def test_delays_in_percentiles():
    counts = DelayCounts()
    for delay in np.linspace(0.001, 0.030, 1000):
        counts.add(float(delay))
    figures = counts.figures()
    assert figures["median_ms"] == pytest.approx(15.5, abs=0.5)
    assert figures["percentile_99_ms"] == pytest.approx(29.7, abs=0.5)
    assert figures["largest_ms"] == pytest.approx(30.0)
    assert figures["share_within_20_ms"] == pytest.approx(19 / 29, abs=0.02)
    counts.add(100.0)
    assert counts.largest_s == 100.0
    assert np.isnan(DelayCounts().percentile_s(99))
