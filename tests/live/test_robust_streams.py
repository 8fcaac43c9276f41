"""Streams as they are: late, out of order, lost and back, in bursts, with clocks that are set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_play import errors, events, play, rms, simulated

from smoother.live.answers import LiveState
from smoother.live.buffers import FrameBuffer, ImuBuffer, SkeletonFrame
from smoother.live.camera_clock import CameraClock, ShiftCause
from smoother.recording import ImuStream

SIMULATION = simulated(2, 15.0, ())
ARRIVALS = events(SIMULATION)


def batch(*times: float) -> ImuStream:
    t = np.array(times)
    return ImuStream("", t, np.outer(t, np.ones(3)), np.zeros((len(t), 3)))


def frame(t: float, arrival: float | None = None) -> SkeletonFrame:
    return SkeletonFrame(t, t + 0.1 if arrival is None else arrival, np.ones((5, 3)), np.full(5, 2, np.int8))


def test_late_samples_are_sorted_in_and_older_ones_counted():
    buffer = ImuBuffer(10.0)
    assert buffer.add(batch(0.0, 0.01, 0.02, 0.3)) is None
    assert buffer.add(batch(0.2, 0.1)) == 0.1
    np.testing.assert_array_equal(buffer.t, [0.0, 0.01, 0.02, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(buffer.stream(-np.inf).acc[:, 0], buffer.t)
    assert buffer.add(batch(1.0)) is None
    assert buffer.add(batch(0.4)) is None and buffer.late == 1
    assert buffer.add(batch(1.0)) is None and buffer.duplicate == 1
    assert buffer.add(batch(np.nan)) is None and buffer.invalid == 1


@pytest.mark.slow
def test_a_buffer_holds_no_more_than_it_was_told():
    buffer, frames = ImuBuffer(2.0), FrameBuffer(2.0)
    for k in range(40_000):
        buffer.add(batch(k * 0.01))
        frames.add(frame(k * 0.03))
    assert len(buffer) < 2000 and len(frames) < 100
    assert buffer.end_s == pytest.approx(399.99)


def test_frames_out_of_order():
    frames = FrameBuffer(10.0)
    added = [frames.add(frame(t)) for t in (1.0, 1.2, 1.1, 1.1, 0.6, np.nan)]
    assert added == [True] * 3 + [False] * 3
    assert [each.t_s for each in frames.since(-np.inf)] == [1.0, 1.1, 1.2]
    assert (frames.late, frames.duplicate) == (2, 1)


@pytest.mark.parametrize("step_s", [0.3, -0.3, 0.05])
def test_a_camera_clock_that_is_set_is_followed(step_s):
    clock = CameraClock()
    usual = [each for k in range(30) for each in clock.take(frame(k / 30))[0]]
    assert len(usual) == 30
    jumps, taken = [], []
    for k in range(30, 45):  # the stamps go on otherwise than before, the arrivals do not
        frames, jump = clock.take(frame(k / 30 + step_s, k / 30 + 0.1))
        jumps += [] if jump is None else [jump]
        taken += frames
    assert [jump.cause for jump in jumps] == [ShiftCause.CLOCK]
    assert jumps[0].seconds == pytest.approx(-step_s, abs=1e-9)
    np.testing.assert_allclose([each.t_s for each in taken], np.arange(30, 45) / 30)


@pytest.mark.parametrize("seconds", [0.1, -0.06])
def test_frames_that_come_later_than_before_keep_their_stamps_and_none_waits(seconds):
    clock = CameraClock()
    for k in range(30):
        clock.take(frame(k / 30))
    jumps = []
    for k in range(30, 60):
        frames, jump = clock.take(frame(k / 30, k / 30 + 0.1 + seconds))
        assert [each.t_s for each in frames] == [k / 30]
        jumps += [] if jump is None else [jump]
    assert [jump.cause for jump in jumps] == [ShiftCause.LATENCY]
    assert clock.correction_s == 0.0 and clock.delay_s == pytest.approx(0.1 + seconds)


def test_frames_that_overtake_others_show_that_the_latency_has_changed():
    clock = CameraClock()
    late = [frame(k / 30, k / 30 + 0.2) for k in range(30)]
    soon = [frame(k / 30, k / 30 + 0.1) for k in range(30, 60)]
    jumps = [clock.take(each)[1] for each in sorted([*late, *soon], key=lambda each: each.arrival_s)]
    assert [jump.cause for jump in jumps if jump is not None] == [ShiftCause.LATENCY]
    assert clock.correction_s == 0.0


def test_what_frames_that_were_lost_leave_open_stays_open():
    clock = CameraClock()
    for k in range(30):
        clock.take(frame(k / 30))
    jumps = [clock.take(frame(k / 30, k / 30 + 0.2))[1] for k in range(40, 55)]
    assert [jump.cause for jump in jumps if jump is not None] == [ShiftCause.OPEN]


def test_a_jitter_of_arrivals_is_no_jump():
    rng, clock = np.random.default_rng(2), CameraClock()
    for k in range(400):
        _, jump = clock.take(frame(k / 30, k / 30 + 0.1 + rng.exponential(0.02)))
        assert jump is None


def test_a_burst_is_no_jump():
    clock = CameraClock()
    for k in range(30):
        clock.take(frame(k / 30))
    taken = []
    for k in range(30, 50):  # held up, then all at once
        frames, jump = clock.take(frame(k / 30, 50 / 30 + 0.1))
        assert jump is None
        taken += frames
    taken += clock.take(frame(50 / 30))[0]
    assert len(taken) == 21 and clock.correction_s == 0.0


def rearranged() -> list:
    """Every fifth batch 0.3 s late, every seventh frame 0.25 s."""
    late = []
    for number, (at, event) in enumerate(ARRIVALS):
        if isinstance(event, tuple):
            late.append((at + (0.3 if number % 5 == 0 else 0.0), event))
        else:
            late.append((at + (0.25 if number % 7 == 0 else 0.0), event))
    return sorted(late, key=lambda each: each[0])


def lost_and_back() -> list:
    """No IMU from 11 to 12 s, no camera from 13.5 to 14.1 s, then its frames in a burst."""
    left = []
    for at, event in ARRIVALS:
        if isinstance(event, tuple):
            if not 11.0 < at < 12.0:
                left.append((at, event))
        elif 13.5 < at < 14.1:
            left.append((14.1, replace(event, arrival_s=14.1)))
        else:
            left.append((at, event))
    return sorted(left, key=lambda each: each[0])


@pytest.mark.slow
def test_late_and_out_of_order_samples_cost_little():
    outputs = list(play(rearranged()))
    answers = errors(SIMULATION, outputs, "settled")
    assert len(answers) > 50
    assert rms(answers[:, 0]) < 0.03
    assert not any(outputs[-1].dropped.values())


@pytest.mark.slow
def test_streams_that_are_lost_come_back():
    outputs = list(play(lost_and_back()))
    during = [o for o in outputs if 11.7 < o.now_s < 11.95]
    assert during and all(o.state is LiveState.LOST and o.now is None for o in during)
    assert any("paused" in note for o in outputs for note in o.notes)
    gap = [o for o in outputs if 13.9 < o.now_s < 14.05]
    assert gap and all(o.state is LiveState.GAP for o in gap)
    assert outputs[-1].state is LiveState.VISIBLE
    last = errors(SIMULATION, [o for o in outputs if o.now_s > 14.5])
    assert len(last) > 5 and rms(last[:, 0]) < 0.04
