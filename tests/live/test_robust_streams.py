"""Streams as they are: late, out of order, lost and back, in bursts, with clocks that are set."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.body import FOREARM
from smoother.live.buffers import CameraClock, FrameBuffer, Shift, ShiftCause, SkeletonFrame
from smoother.live.imu import LiveImu
from smoother.recording import ImuStream


def batch(*times: float) -> ImuStream:
    t = np.array(times)
    return ImuStream("", t, np.outer(t, np.ones(3)), np.zeros((len(t), 3)))


def frame(t: float, arrival: float | None = None) -> SkeletonFrame:
    return SkeletonFrame(t, t + 0.1 if arrival is None else arrival, np.ones((5, 3)), np.full(5, 2, np.int8))


def test_late_samples_are_sorted_in_and_older_ones_counted():
    imu = LiveImu(FOREARM, 10.0)
    imu.add(batch(0.0, 0.01, 0.02, 0.3))
    assert imu.changed_s is None
    imu.add(batch(0.2, 0.1))
    assert imu.changed_s == 0.1
    np.testing.assert_array_equal(imu.t, [0.0, 0.01, 0.02, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(imu.stream(-np.inf).acc[:, 0], imu.t)
    imu.changed_s = None
    for times in ((1.0,), (0.4,), (1.0,), (np.nan,)):
        imu.add(batch(*times))
    assert imu.changed_s is None and (imu.late, imu.duplicate, imu.invalid) == (1, 1, 1)


def test_frames_out_of_order():
    frames = FrameBuffer(10.0)
    added = [frames.add(frame(t)) for t in (1.0, 1.2, 1.1, 1.1, 0.6, np.nan)]
    assert added == [True] * 3 + [False] * 3
    assert [each.t_s for each in frames.since(-np.inf)] == [1.0, 1.1, 1.2]
    assert (frames.late, frames.duplicate) == (2, 1)


def fed(frames: list[SkeletonFrame]) -> tuple[CameraClock, list[Shift], list[float]]:
    """A clock after 30 usual frames and these, its jumps and the stamps that it gave out."""
    clock, jumps, stamps = CameraClock(), [], []
    for each in [*(frame(k / 30) for k in range(30)), *frames]:
        taken, jump = clock.take(each)
        jumps += [] if jump is None else [jump]
        stamps += [one.t_s for one in taken]
    return clock, jumps, stamps[30:]


@pytest.mark.parametrize(
    "frames, cause, seconds",
    [
        *(
            ([frame(k / 30 + step_s, k / 30 + 0.1) for k in range(30, 45)], ShiftCause.CLOCK, -step_s)
            for step_s in (0.3, -0.3, 0.05)  # the stamps go on otherwise than before, the arrivals do not
        ),
        *(
            ([frame(k / 30, k / 30 + 0.1 + late_s) for k in range(30, 60)], ShiftCause.LATENCY, late_s)
            for late_s in (0.1, -0.06)
        ),
        ([frame(k / 30, k / 30 + 0.2) for k in range(40, 55)], ShiftCause.OPEN, 0.1),  # some were lost
    ],
)
def test_a_clock_that_is_set_and_a_latency_that_changes(frames, cause, seconds):
    clock, jumps, stamps = fed(frames)
    assert [jump.cause for jump in jumps] == [cause]
    assert jumps[0].seconds == pytest.approx(seconds, abs=1e-9)
    if cause is not ShiftCause.OPEN:
        np.testing.assert_allclose(stamps, np.arange(30, 30 + len(frames)) / 30)
    if cause is ShiftCause.LATENCY:
        assert clock.correction_s == 0.0 and clock.delay_s == pytest.approx(0.1 + seconds)


def test_a_jitter_of_arrivals_is_no_jump():
    rng, clock = np.random.default_rng(2), CameraClock()
    for k in range(400):
        _, jump = clock.take(frame(k / 30, k / 30 + 0.1 + rng.exponential(0.02)))
        assert jump is None


def test_a_burst_is_no_jump():
    held_up = [frame(k / 30, 50 / 30 + 0.1) for k in range(30, 50)]
    clock, jumps, stamps = fed([*held_up, frame(50 / 30)])
    assert not jumps and len(stamps) == 21 and clock.correction_s == 0.0
