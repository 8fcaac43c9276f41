"""Times of a sensor: from stamps that repeat, wrap or come in bursts; segments and even stamps."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measurements.segment import Timeline
from smoother.measurements.timestamps import counted, dejitter, even_times, needs_counting, unwrapped
from smoother.recording import FOREARM_JOINTS, JOINTS, ImuStream, JointState, JointTracks, Recording


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


RATE_HZ = 80.0


def ticks(count: int = 4000) -> np.ndarray:
    return np.arange(count) / RATE_HZ


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


def test_a_missing_sample_leaves_the_stamps_alone() -> None:
    rng = np.random.default_rng(2)
    stamps = np.delete(np.sort(ticks() + rng.normal(0.0, 0.002, 4000)), 2000)
    np.testing.assert_array_equal(dejitter(stamps), stamps)


def recording(jitter_s: float = 0.004, joints: tuple[str, ...] = FOREARM_JOINTS, seed: int = 0) -> Recording:
    """Three segments of a sensor whose stamps scatter, joints tracked at random; no value is finite."""
    rng = np.random.default_rng(seed)
    t = np.concatenate(
        [start + np.arange(count) / RATE_HZ for start, count in ((0.0, 1500), (21.0, 30), (24.0, 2000))]
    )
    t = np.sort(t + rng.uniform(-jitter_s, jitter_s, len(t)))
    frame_t = np.arange(0.0, 50.0, 1 / 30)
    state = np.full((len(frame_t), len(JOINTS)), JointState.NOT_TRACKED, np.int8)
    state[:, JOINTS.index("shoulder")] = JointState.TRACKED
    for joint in joints:
        state[:, JOINTS.index(joint)] = rng.choice(list(JointState), len(frame_t))
    nothing = np.full((len(t), 3), np.nan)
    arm = JointTracks("camera", frame_t, np.full((len(frame_t), len(JOINTS), 3), np.nan), state)
    return Recording(ImuStream("imu", t, nothing, nothing), arm)


def test_stamps_are_even_segment_by_segment() -> None:
    made = recording()
    t, timeline = made.imu.t_s, Timeline.of(made)
    assert [(rows.start, rows.stop) for rows in timeline.segments] == [(0, 1500), (1500, 1530), (1530, 3530)]
    for rows in timeline.segments:
        np.testing.assert_array_equal(timeline.even_t_imu[rows], dejitter(t[rows]))
    assert np.std(np.diff(timeline.even_t_imu[:1500])) < 0.1 * np.std(np.diff(t[:1500]))
    np.testing.assert_array_equal(timeline.even_t_imu[1500:1530], t[1500:1530])  # too few to be dejittered


@pytest.mark.parametrize("joints", [FOREARM_JOINTS, ("elbow", "wrist"), ("wrist",), ("strap",)], ids="-".join)
def test_visible_is_the_definition(joints: tuple[str, ...]) -> None:
    """A loop: two tracked forearm joints, or one where the recording has only one; the shoulder is none."""
    made = recording(joints=joints)
    needed = min(2, len(joints))
    expected = [
        sum(frame[JOINTS.index(joint)] == JointState.TRACKED for joint in FOREARM_JOINTS) >= needed
        for frame in made.arm.state
    ]
    np.testing.assert_array_equal(Timeline.of(made).visible, expected)
    assert 0.02 < np.mean(expected) < 0.98


def test_stamps_of_a_program_are_noticed() -> None:
    made = recording()
    assert not Timeline.of(made).synthetic_stamps
    arm = JointTracks("camera", np.arange(1500) / 27.3, made.arm.position, made.arm.state)
    assert Timeline.of(Recording(made.imu, arm)).synthetic_stamps
