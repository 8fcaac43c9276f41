"""Steps of a stream's clock, bursts, late samples and single wrong stamps, each told from the others."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.streams.arrivals import FrameRows, ImuRows
from smoother.streams.stamp_steps import StampSteps


def imu(t, arrival) -> ImuRows:
    t = np.asarray(t, float)
    return ImuRows(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)), np.asarray(arrival, float))


def passed(t, arrival, batch: int = 7) -> tuple[np.ndarray, list[str], StampSteps]:
    """What comes out of stamps that arrive in batches, with the events."""
    steps: StampSteps[ImuRows] = StampSteps("wrist")
    rows, events = [], []
    for start in range(0, len(t), batch):
        mended, said = steps.mended(imu(t[start : start + batch], arrival[start : start + batch]))
        rows.append(mended)
        events += said
    return ImuRows.joined(rows).t_s, events, steps


TRUE = np.arange(0, 20, 0.01)
ARRIVAL = TRUE + 0.02 + 0.004 * np.random.default_rng(0).random(len(TRUE))


def test_a_clock_that_runs_is_left_alone():
    t, events, _ = passed(TRUE, ARRIVAL)
    np.testing.assert_array_equal(t, TRUE)
    assert not events


@pytest.mark.parametrize("step_s", [-3600.0, -3.0, 0.7, 3.0, 1e6])
@pytest.mark.parametrize("batch", [1, 7, 200])
def test_a_step_is_taken_out(step_s, batch):
    stamps = np.where(TRUE > 10, TRUE + step_s, TRUE)
    t, events, steps = passed(stamps, ARRIVAL, batch)
    assert len(t) == len(TRUE)
    # the least delay settles where the clock stands: as exact as arrivals are
    np.testing.assert_allclose(t, TRUE, atol=0.005)
    assert len(events) == 1
    assert f"stepped by {step_s:+.3f}"[:-3] in events[0]
    assert steps.moved_s == pytest.approx(-step_s, abs=0.005)


def test_a_burst_after_a_pause_is_no_step():
    arrival = ARRIVAL.copy()
    paused = (TRUE > 8) & (TRUE < 12)
    arrival[paused] = 12.02
    t, events, steps = passed(TRUE, np.maximum.accumulate(arrival))
    np.testing.assert_array_equal(t, TRUE)
    assert not events
    assert not steps.dropped


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_a_queue_that_empties_slowly_is_no_step(batch):
    """Nothing for 150 s, then all that waited, ten times as fast as it was sent."""
    t = np.arange(0, 300, 0.05)
    arrival = np.where(t < 10, t + 0.02, np.maximum(160 + (t - 10) / 10, t + 0.02))
    out, events, steps = passed(t, arrival, batch)
    np.testing.assert_array_equal(out, t)
    assert not events
    assert not steps.dropped


def test_late_and_disordered_samples_pass():
    rng = np.random.default_rng(1)
    arrival = ARRIVAL + np.where(rng.random(len(TRUE)) < 0.1, 0.5 * rng.random(len(TRUE)), 0)
    order = np.argsort(arrival)
    t, events, _ = passed(TRUE[order], arrival[order])
    np.testing.assert_array_equal(t, TRUE[order])
    assert not events


def test_single_wrong_stamps_are_dropped():
    stamps = TRUE.copy()
    stamps[500], stamps[900] = 1e6, -50.0
    t, events, steps = passed(stamps, ARRIVAL)
    np.testing.assert_array_equal(t, np.delete(TRUE, [500, 900]))
    assert not events
    assert steps.dropped == 2


def test_a_clock_of_its_own_is_moved_to_this_computers():
    t, events, _ = passed(TRUE - 5000.0, ARRIVAL)
    np.testing.assert_allclose(t, ARRIVAL[0] + TRUE, atol=0.005)
    assert len(events) == 1
    assert "a clock of its own" in events[0]


def test_frames_too():
    steps: StampSteps[FrameRows] = StampSteps("kinect")
    t = np.arange(0, 10, 1 / 30)
    rows = FrameRows(t + 2.0 * (t > 5), np.zeros((len(t), 5, 3)), np.zeros((len(t), 5), np.int8), t + 0.1)
    mended, events = steps.mended(rows)
    np.testing.assert_allclose(mended.t_s, t, atol=1e-9)
    assert len(events) == 1
