"""The timeline of a recording: segments, even stamps and visible frames, each against its definition."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.measurements.segment import Timeline
from smoother.measurements.timestamps import dejitter
from smoother.recording import FOREARM_JOINTS, JOINTS, ImuStream, JointState, JointTracks, Recording

RATE_HZ = 80.0


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


def test_length_leaves_the_pauses_out() -> None:
    timeline = Timeline.of(recording(jitter_s=0.0))
    assert timeline.length_s() == pytest.approx((1499 + 29 + 1999) / RATE_HZ, abs=1e-9)


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
