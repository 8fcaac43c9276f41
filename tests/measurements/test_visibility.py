"""Gaps against the definition and slow loops, and what a recording allows."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import moving
from simulated_points import PointSimulation, simulate_point

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


def visible(arm: JointTracks) -> list[bool]:
    return visible_frames(arm).tolist()


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=30))
def test_two_joints_make_a_frame_visible(rows: list[tuple[bool, bool, bool]]) -> None:
    """The definition as a loop; with fewer than two joints in the recording one is enough."""
    elbow, wrist, hand = (list(column) for column in zip(*rows, strict=True))
    has = sum(any(column) for column in (elbow, wrist, hand))
    needed = max(1, min(2, has))
    assert visible(tracks(elbow=elbow, wrist=wrist, hand=hand)) == [sum(row) >= needed for row in rows]


@pytest.mark.parametrize("state", [JointState.INFERRED, JointState.NOT_TRACKED])
def test_a_guess_or_a_nan_is_not_accepted(state: JointState) -> None:
    arm = tracks(elbow=[True] * 3, wrist=[True] * 3)
    arm.state[1, JOINTS.index("wrist")] = state
    arm.position[2, JOINTS.index("wrist"), 1] = np.nan
    assert visible(arm) == [True, False, False]


@given(masks)
def test_gaps_cover_exactly_the_occluded_frames(mask: list[bool]) -> None:
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


def _inside(time: float, gap: Gap) -> bool:
    """The definition: between the visible frames beside it, which do not belong to it."""
    if gap.start_s < time < gap.end_s:
        return True
    return (time == gap.start_s and gap.open_start) or (time == gap.end_s and gap.open_end)


@given(masks, st.lists(st.floats(-0.5, 3.5), min_size=1, max_size=60))
def test_occluded_at_agrees_with_a_loop(mask: list[bool], times: list[float]) -> None:
    t = np.arange(len(mask)) / 30.0
    gaps = find_gaps(t, np.array(mask), float(t[0]), float(t[-1]))
    at = np.concatenate([np.array(times), t])
    expected = [any(_inside(time, gap) for gap in gaps) for time in at]
    assert occluded_at(at, gaps).tolist() == expected


def test_frames_that_never_arrived_are_a_gap() -> None:
    """A silence of over 0.15 s (or 2.5 frames of a slow camera) is one; two frames are not."""
    t = np.arange(60) / 30.0
    everything = np.ones(60, dtype=bool)
    for lost, count in ((1, 0), (3, 0), (5, 1)):
        keep = everything.copy()
        keep[20 : 20 + lost] = False
        gaps = find_gaps(t[keep], everything[keep], 0.0, t[-1])
        assert len(gaps) == count, lost
    slow = np.arange(20) / 10.0
    keep = np.arange(20) != 7
    assert find_gaps(slow[keep], keep[keep], 0.0, slow[-1]) == ()  # 0.2 s at 10 Hz: two frames


def test_an_imu_that_runs_on_is_a_gap_only_when_it_is_long() -> None:
    """The first frame comes some time after the first IMU sample: that alone is no occlusion."""
    t = np.arange(30) / 30.0
    shown = np.ones(30, dtype=bool)
    assert find_gaps(t, shown, -0.05, t[-1] + 0.05) == ()
    gaps = find_gaps(t, shown, -MISSING_S - 0.05, t[-1] + MISSING_S + 0.05)
    assert [(gap.open_start, gap.open_end) for gap in gaps] == [(True, False), (False, True)]


def test_nothing_seen_is_one_gap_open_on_both_sides() -> None:
    t = np.arange(10) / 30.0
    assert find_gaps(t, np.zeros(10, dtype=bool), 0.0, 1.0) == (Gap(0.0, 1.0, True, True),)
    assert find_gaps(np.zeros(0), np.zeros(0, dtype=bool), 0.0, 1.0) == (Gap(0.0, 1.0, True, True),)


def arm() -> Recording:
    return replace(moving(1).recording, truth=None)


def test_a_slow_imu_allows_less_and_then_nothing() -> None:
    imu = arm().imu
    usual, slow, still_slower = (
        allowance(replace(arm(), imu=imu.select(slice(None, None, every)))) for every in (1, 3, 8)
    )
    assert slow.ready and slow.longest_s < usual.longest_s
    assert any("slow" in sentence for sentence in slow.undetermined)
    assert not still_slower.ready and "samples per second" in still_slower.sentence
    point = allowance(simulate_point(PointSimulation(duration_s=20.0), 1).recording)  # it is no arm
    assert point.ready and not any("roll" in sentence for sentence in point.undetermined)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: replace(r, imu=replace(r.imu, gyro=0.01 * r.imu.gyro)), "hardly turns"),
        (lambda r: replace(r, imu=replace(r.imu, gyro=r.imu.gyro * [1.0, 0.0, 0.0])), "the roll"),
        (
            lambda r: replace(r, arm=r.arm.hide(np.ones(len(r.arm), bool), ("elbow", "hand", "strap"))),
            "without elbow and wrist",
        ),
        (lambda r: replace(r, arm=r.arm.hide(r.arm.t_s > r.arm.t_s[0] + 3.0)), "in view for 3 s"),
    ],
)
def test_what_nothing_determines(change, words: str):
    found = allowance(change(arm()))
    assert any(words in sentence and "nothing determines" in sentence for sentence in found.undetermined)
    assert found.longest_s is None or found.within_m > 0.02 or found.longest_s < allowance(arm()).longest_s


def test_nothing_tracked_and_no_common_time() -> None:
    tracks = arm().arm
    hidden, later = (
        tracks.hide(np.ones(len(tracks), bool), FOREARM_JOINTS),
        replace(tracks, t_s=tracks.t_s + 1e3),
    )
    for changed, words in ((hidden, "never tracked"), (later, "in common")):
        found = allowance(replace(arm(), arm=changed))
        assert words in found.sentence and not found.ready


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
