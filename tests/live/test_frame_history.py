"""Visible or in a gap: at the present, and at a moment a little ago."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.live.answers import LiveState
from smoother.live.frame_history import FrameHistory

DELAY_S = 0.1


def history(*frames: tuple[float, bool]) -> FrameHistory:
    made = FrameHistory()
    for t_s, is_visible in frames:
        made.add(t_s, is_visible)
    return made


def test_frames_that_are_due_are_no_gap() -> None:
    seen = history(*((k / 30, True) for k in range(31)))
    assert seen.visible_s == 1.0
    assert seen.state_now(1.1, DELAY_S) == (LiveState.VISIBLE, None)
    # nothing came for longer than frames take: it is since the last one
    assert seen.state_now(2.0, DELAY_S) == (LiveState.GAP, 1.0)


def test_a_frame_without_the_forearm_begins_a_gap_at_once() -> None:
    seen = history((0.9, True), (1.0, True), (1.03, False))
    assert seen.state_now(1.05, DELAY_S) == (LiveState.GAP, 1.0)
    seen.add(1.02, True)  # a late one moves its beginning
    assert seen.state_now(1.05, DELAY_S) == (LiveState.GAP, 1.02)
    seen.add(1.06, True)
    assert seen.state_now(1.07, DELAY_S) == (LiveState.VISIBLE, None)


@pytest.mark.parametrize(
    "t_s, expected", [(0.5, None), (1.0, None), (1.2, 1.0), (1.9, 1.0), (2.0, None), (2.3, None)]
)
def test_a_moment_ago_is_judged_by_both_sides(t_s: float, expected: float | None) -> None:
    times = [*np.arange(0.0, 1.01, 0.1).round(3), *np.arange(2.0, 2.51, 0.1).round(3)]
    seen = history(*((t, True) for t in times), (1.5, False))
    assert seen.state_at(t_s) == (LiveState.VISIBLE if expected is None else LiveState.GAP, expected)


def test_all_of_a_window_is_visible_or_not() -> None:
    t = np.arange(1.0, 2.0, 0.1)
    seen = history((0.5, False), *((each, True) for each in t))
    assert seen.sees_all(t)
    assert not seen.sees_all(t[:5]), "too short to tell"
    seen.add(1.55, False)
    assert not seen.sees_all(t) and seen.sees_all(t + 0.6)


def test_nothing_is_visible_before_the_first_frame() -> None:
    assert FrameHistory().state_now(0.0, DELAY_S)[0] is LiveState.GAP
    assert not FrameHistory().visible_s > -np.inf
