"""Gaps against the definition and slow loops, and what a recording allows."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import moving, point

from smoother.measurements.allowance import allowance
from smoother.measurements.visibility import (
    MISSING_S,
    Gap,
    find_gaps,
    occluded_at,
    visible_frames,
)
from smoother.recording import FOREARM_JOINTS, JOINTS, JointState, JointTracks, Recording

masks = st.lists(st.booleans(), min_size=1, max_size=80)


def tracks(**tracked: list[bool]) -> JointTracks:
    """Joints tracked in the frames that say so, at 30 Hz."""
    count = len(next(iter(tracked.values())))
    position = np.zeros((count, 5, 3))
    state = np.zeros((count, 5), dtype=np.int8)
    for joint, mask in tracked.items():
        state[:, JOINTS.index(joint)] = np.where(mask, JointState.TRACKED, JointState.NOT_TRACKED)
    return JointTracks("", np.arange(count) / 30.0, position, state)


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=30))
def test_two_joints_make_a_frame_visible(rows: list[tuple[bool, bool, bool]]) -> None:
    """The definition as a loop; with fewer than two joints in the recording one is enough."""
    elbow, wrist, hand = (list(column) for column in zip(*rows, strict=True))
    has = sum(any(column) for column in (elbow, wrist, hand))
    needed = max(1, min(2, has))
    arm = tracks(elbow=elbow, wrist=wrist, hand=hand)
    assert visible_frames(arm).tolist() == [sum(row) >= needed for row in rows]
    seen = tracks(elbow=[True] * 4, wrist=[True] * 4)  # a guess or a nan is not accepted
    seen.state[1:3, JOINTS.index("wrist")] = JointState.INFERRED, JointState.NOT_TRACKED
    seen.position[3, JOINTS.index("wrist"), 1] = np.nan
    assert visible_frames(seen).tolist() == [True, False, False, False]


@given(masks, st.lists(st.floats(-0.5, 3.5), min_size=1, max_size=60))
def test_gaps_cover_exactly_the_occluded_frames(mask: list[bool], times: list[float]) -> None:
    """Every occluded frame is in one gap, no visible one in any; gaps in order and disjoint."""
    t, shown = np.arange(len(mask)) / 30.0, np.array(mask)
    gaps = find_gaps(t, shown, float(t[0]), float(t[-1]))
    for a, b in itertools.pairwise(gaps):
        assert a.end_s <= b.start_s
    for time, is_visible in zip(t, shown, strict=True):
        inside = sum(_inside(time, gap) for gap in gaps)
        assert inside == (0 if is_visible else 1)
    for gap in gaps:
        assert gap.open_start == (not shown[: np.searchsorted(t, gap.start_s) + 1].any())
        assert gap.open_end == (not shown[np.searchsorted(t, gap.end_s) :].any())
    at = np.concatenate([np.array(times), t])
    assert occluded_at(at, gaps).tolist() == [any(_inside(time, gap) for gap in gaps) for time in at]


def _inside(time: float, gap: Gap) -> bool:
    """The definition: between the visible frames beside it, which do not belong to it."""
    if gap.start_s < time < gap.end_s:
        return True
    return (time == gap.start_s and gap.open_start) or (time == gap.end_s and gap.open_end)


def test_frames_that_never_arrived_are_a_gap() -> None:
    """A silence of over 0.15 s (or 2.5 frames of a slow camera) is one; two frames are not."""
    t, shown = np.arange(60) / 30.0, np.ones(60, dtype=bool)
    for lost, count in ((1, 0), (3, 0), (5, 1)):
        keep = ~((np.arange(60) >= 20) & (np.arange(60) < 20 + lost))
        assert len(find_gaps(t[keep], shown[keep], 0.0, t[-1])) == count, lost
    slow = np.delete(np.arange(20) / 10.0, 7)  # 0.2 s at 10 Hz: two frames
    assert find_gaps(slow, shown[:19], 0.0, slow[-1]) == ()
    # an IMU that runs on is a gap only when it is long; nothing seen is one that is open on both sides
    assert find_gaps(t, shown, -0.05, t[-1] + 0.05) == ()
    gaps = find_gaps(t, shown, -MISSING_S - 0.05, t[-1] + MISSING_S + 0.05)
    assert [(gap.open_start, gap.open_end) for gap in gaps] == [(True, False), (False, True)]
    for count in (0, 10):
        assert find_gaps(t[:count], ~shown[:count], 0.0, 1.0) == (Gap(0.0, 1.0, True, True),)


def never(recording: Recording, *joints: str) -> Recording:
    return replace(recording, arm=recording.arm.hide(np.ones(len(recording.arm), bool), joints))


@pytest.mark.parametrize(
    ("change", "is_ready", "words"),
    [
        (lambda r: replace(r, imu=r.imu.select(slice(None, None, 3))), True, "slow"),
        (lambda r: replace(r, imu=r.imu.select(slice(None, None, 8))), False, "samples per second"),
        (lambda r: replace(r, imu=replace(r.imu, gyro=0.01 * r.imu.gyro)), True, "hardly turns"),
        (lambda r: replace(r, imu=replace(r.imu, gyro=r.imu.gyro * [1.0, 0.0, 0.0])), True, "the roll"),
        (lambda r: never(r, "elbow", "hand", "strap"), True, "without elbow and wrist"),
        (lambda r: replace(r, arm=r.arm.hide(r.arm.t_s > r.arm.t_s[0] + 3.0)), None, "in view for 3 s"),
        (lambda r: never(r, *FOREARM_JOINTS), False, "never tracked"),
        (lambda r: replace(r, arm=replace(r.arm, t_s=r.arm.t_s + 1e3)), False, "in common"),
        (lambda r: point(1, duration_s=20.0).recording, True, ""),  # it is no arm
    ],
)
def test_what_a_recording_allows(
    change: Callable[[Recording], Recording], is_ready: bool | None, words: str
) -> None:
    recording = replace(moving(1).recording, truth=None)
    usual, found = allowance(recording), allowance(change(recording))
    assert is_ready is None or found.ready is is_ready
    assert words in found.sentence or any(words in sentence for sentence in found.undetermined)
    if found.undetermined:
        assert found.longest_s is None or found.within_m > 0.02 or found.longest_s < usual.longest_s
    assert words or not any("roll" in sentence for sentence in found.undetermined)


def test_what_one_camera_without_depth_leaves_open_is_said() -> None:
    recording = moving(5, duration_s=20.0, rgb="all", cameras=(75.0,)).recording
    nowhere = tuple(replace(camera, pose=None) for camera in recording.cameras)
    both, alone, unplaced = (
        allowance(replace(recording, cameras=cameras)) for cameras in (recording.cameras, (), nowhere)
    )
    assert both.ready and alone.ready
    assert "one camera without depth" not in both.sentence
    assert "one camera without depth: how far away the arm is shows" in alone.sentence
    assert "do not show how far away the arm is" in unplaced.sentence
    elbow_alone = recording.arm.hide(np.ones(len(recording.arm), bool), ("wrist", "hand"))
    assert not allowance(replace(recording, arm=elbow_alone, cameras=())).ready
