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


def seconds(count: int = 6000) -> np.ndarray:
    """Of a sensor of 100 Hz."""
    return np.arange(count) / 100.0


def caught_up() -> np.ndarray:
    """Two seconds of samples that come at once after a stall."""
    stamps = seconds() + np.random.default_rng(0).normal(0, 1e-3, 6000)
    stamps[3000:3200] = stamps[3200]
    return stamps


@pytest.mark.parametrize(
    ("t", "stamps", "pauses", "resets", "sigma_s", "most_s"),
    # a constant delay does no harm, a wandering one does: 1 ms is a tenth of a period
    [
        *(
            (*delivered(seed, pauses), len(pauses), 0, 1e-3, np.inf)
            for pauses in ((), (3.0,), (1.0, 0.5, 7.0))
            for seed in range(3)
        ),
        (seconds(), caught_up(), 0, 0, 1e-3, 2e-3),
        (seconds(), np.floor(seconds()), 0, 0, 1e-3, np.inf),  # whole seconds
        (seconds(), seconds() - 4.0 * (np.arange(6000) >= 3000), 0, 1, 1e-3, 1e-6),  # a clock set back
    ],
)
def test_stamps_that_repeat_are_counted(
    t: np.ndarray, stamps: np.ndarray, pauses: int, resets: int, sigma_s: float, most_s: float
) -> None:
    even = even_times(stamps)
    assert even is not None and (even.pauses, even.clock_resets) == (pauses, resets)
    assert np.std(even.t_s - t) < sigma_s and np.abs(even.t_s - t).max() < most_s
    assert (np.diff(even.t_s) > 0).all()
    if len(t) > 6000:
        assert needs_counting(stamps)
        assert (np.diff(stamps) <= 0).mean() > 0.3 and abs(np.median(even.t_s - t)) < 0.005


def test_what_is_uneven_is_not_made_even_and_good_stamps_need_nothing() -> None:
    rng = np.random.default_rng(1)
    steps = rng.exponential(0.01, 6000)
    steps[rng.random(6000) < 0.02] = 0.0
    for stamps in (np.cumsum(steps), np.zeros(6000), np.arange(10.0)):
        assert even_times(stamps) is None
    t = np.cumsum(rng.uniform(0.006, 0.014, 3000))
    t[1500:] += 3.0
    assert not needs_counting(t)


@pytest.mark.parametrize("wrap_s", [2**32 * 1e-6, 2**24 / 32768, 86_400.0])
def test_wraps(wrap_s: float):
    t = wrap_s - 3.0 + np.arange(1000) / 100.0
    went_on, wraps = unwrapped(np.mod(t, wrap_s))
    assert wraps == 1 and np.allclose(went_on, t, atol=1e-6)
    assert unwrapped(np.array([0.0, 1.0, 0.5]))[1] == 0


def test_counters() -> None:
    number = np.delete(np.arange(70_000), [500, 501, 40_000])
    counts, restarts = counted((number + 65_000) % 65_536, 65_536)
    assert np.array_equal(counts, number) and restarts == 2
    # one that counts ticks of a faster clock, and one that was started anew
    t, stamps = delivered(0)  # beside bad stamps
    keep = np.random.default_rng(3).random(len(t)) > 0.05
    even = even_times(stamps[keep], np.flatnonzero(keep))
    assert even is not None and np.std(even.t_s - t[keep]) < 1e-3
    for ticks, wrap, expected in (([0, 4, 8, 16], 0, [0, 1, 2, 4]), ([900, 901, 5, 6], 65_536, [0, 1, 2, 3])):
        np.testing.assert_array_equal(counted(np.array(ticks), wrap)[0], expected)


@pytest.mark.parametrize("sigma_s", [0.003, 0.005])
def test_scatter_is_taken_off(sigma_s: float) -> None:
    rng, t = np.random.default_rng(0), np.arange(4000) / 80.0
    stamps = np.sort(t + rng.normal(0.0, sigma_s, 4000))
    error = dejitter(stamps) - t
    # 4 s of samples average 320 stamps: sigma / 18, and four of those bound all of them; at the ends the
    # average is of fewer
    assert np.abs(error[200:-200]).max() < 4 * sigma_s / np.sqrt(320) + 2e-4
    assert np.abs(error).max() < 0.5 * np.abs(stamps - t).max()
    lost = np.delete(stamps, 2000)
    np.testing.assert_array_equal(dejitter(lost), lost)  # a missing sample leaves the stamps alone
    k = np.arange(2400)
    packets = t[np.minimum((k // 4) * 4 + 3, 2399)] + (k % 4) * 1e-3  # of four
    assert np.ptp(np.diff(packets)) > 0.04 and np.ptp(np.diff(dejitter(packets))) < 0.002


@pytest.mark.parametrize("joints", [FOREARM_JOINTS, ("elbow", "wrist"), ("wrist",), ("strap",)], ids="-".join)
def test_a_timeline_has_even_stamps_by_segment_and_what_is_visible(joints: tuple[str, ...]) -> None:
    """Two tracked forearm joints, or one where the recording has only one; the shoulder is none."""
    rng = np.random.default_rng(0)
    starts = ((0.0, 1500), (21.0, 30), (24.0, 2000))
    t = np.concatenate([start + np.arange(count) / 80.0 for start, count in starts])
    t = np.sort(t + rng.uniform(-0.004, 0.004, len(t)))
    frame_t = np.arange(0.0, 50.0, 1 / 30)
    state = np.full((len(frame_t), len(JOINTS)), JointState.NOT_TRACKED, np.int8)
    for joint in ("shoulder", *joints):
        state[:, JOINTS.index(joint)] = rng.choice(list(JointState), len(frame_t))
    nothing, nowhere = np.full((len(t), 3), np.nan), np.full((len(frame_t), len(JOINTS), 3), np.nan)
    imu, arm = ImuStream("imu", t, nothing, nothing), JointTracks("camera", frame_t, nowhere, state)
    timeline, needed = Timeline.of(Recording(imu, arm)), min(2, len(joints))
    assert [(rows.start, rows.stop) for rows in timeline.segments] == [(0, 1500), (1500, 1530), (1530, 3530)]
    for rows in timeline.segments:
        np.testing.assert_array_equal(timeline.even_t_imu[rows], dejitter(t[rows]))
    assert np.std(np.diff(timeline.even_t_imu[:1500])) < 0.1 * np.std(np.diff(t[:1500]))
    np.testing.assert_array_equal(timeline.even_t_imu[1500:1530], t[1500:1530])  # too few to be dejittered
    expected = [
        sum(frame[JOINTS.index(joint)] == JointState.TRACKED for joint in FOREARM_JOINTS) >= needed
        for frame in state
    ]
    np.testing.assert_array_equal(timeline.visible, expected)
    assert 0.02 < np.mean(expected) < 0.98 and not timeline.synthetic_stamps
    made_up = JointTracks("camera", np.arange(len(frame_t)) / 27.3, nowhere, state)  # stamps of a program
    assert Timeline.of(Recording(imu, made_up)).synthetic_stamps
