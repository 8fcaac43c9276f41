"""How streams are doing, and steps of their clocks."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.streams.arrivals import Rows, StampSteps
from smoother.streams.session import StreamHealth


def fed(t, batch: int, delay_s: float = 0.03) -> tuple[StreamHealth, list[str]]:
    health, events = StreamHealth("wrist"), []
    for start in range(0, len(t), batch):
        part = t[start : start + batch]
        events += health.look(float(part[0]) + delay_s - 1e-6)
        events += health.take(part, part + delay_s)
    return health, events


T = np.arange(0, 30, 0.01)


@pytest.mark.parametrize("batch", [1, 5, 40])
def test_rate_delay_and_missing_samples(batch):
    health, events = fed(T, batch)
    assert health.rate_hz(T[-1] + 0.03) == pytest.approx(100, rel=0.1)
    assert health.delay_s == pytest.approx(0.03)
    assert (health.count, health.missing, health.late, events) == (3000, 0, 0, [])
    assert health.rate_hz(T[-1] + 20) == 0
    assert fed(np.delete(T, [1000, 1001, 1002, 2000]), batch)[0].missing == 4


def test_a_stream_lost_and_back():
    health, _ = fed(T[(T < 10) | (T > 14)], 1, 0.0)
    assert (health.lost_times, health.is_lost) == (1, False)
    assert health.lost_s == pytest.approx(4.0, abs=0.03)
    said = [health.look(now_s) for now_s in (30.5, 32.0, 33.0)]
    assert said == [[], ["wrist: nothing for 2.0 s"], []]
    assert health.take(np.array([35.0]), np.array([35.0])) == ["wrist: back, after 5.0 s"]


def passed(t, arrival, batch: int = 7) -> tuple[np.ndarray, list[str], StampSteps]:
    """What comes out of stamps that arrive in batches, with the events."""
    steps, rows, events = StampSteps("wrist"), [], []
    for start in range(0, len(t), batch):
        corrected, said = steps.corrected(Rows(t[start : start + batch], arrival[start : start + batch]))
        rows.append(corrected)
        events += said
    return Rows.joined(rows).t_s, events, steps


TRUE = np.arange(0, 20, 0.01)
ARRIVAL = TRUE + 0.02 + 0.004 * np.random.default_rng(0).random(len(TRUE))


@pytest.mark.parametrize("step_s", [-3600.0, -3.0, 0.7, 3.0, 1e6])
@pytest.mark.parametrize("batch", [1, 7, 200])
def test_a_step_is_taken_out(step_s, batch):
    t, (said,), steps = passed(np.where(TRUE > 10, TRUE + step_s, TRUE), ARRIVAL, batch)
    # the least delay settles where the clock stands: as exact as arrivals are
    np.testing.assert_allclose(t, TRUE, atol=0.005)
    assert f"stepped by {step_s:+.3f}"[:-3] in said
    assert steps.moved_s == pytest.approx(-step_s, abs=0.005)


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_a_queue_that_empties_slowly_is_no_step(batch):
    """Nothing for 150 s, then all that waited, ten times as fast as it was sent."""
    t = np.arange(0, 300, 0.05)
    arrival = np.where(t < 10, t + 0.02, np.maximum(160 + (t - 10) / 10, t + 0.02))
    out, events, steps = passed(t, arrival, batch)
    np.testing.assert_array_equal(out, t)
    assert not events and not steps.dropped


def test_late_and_disordered_samples_pass_and_single_wrong_stamps_do_not():
    rng = np.random.default_rng(1)
    arrival = ARRIVAL + np.where(rng.random(len(TRUE)) < 0.1, 0.5 * rng.random(len(TRUE)), 0)
    order = np.argsort(arrival)
    t, events, _ = passed(TRUE[order], arrival[order])
    np.testing.assert_array_equal(t, TRUE[order])
    assert not events
    wrong = TRUE.copy()
    wrong[[500, 900]] = 1e6, -50.0
    t, events, steps = passed(wrong, ARRIVAL)
    np.testing.assert_array_equal(t, np.delete(TRUE, [500, 900]))
    assert not events and steps.dropped == 2


def test_a_clock_of_its_own_is_moved_to_this_computers():
    t, (said,), _ = passed(TRUE - 5000.0, ARRIVAL)
    np.testing.assert_allclose(t, ARRIVAL[0] + TRUE, atol=0.005)
    assert "come from another clock" in said
