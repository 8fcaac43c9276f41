"""Who follows the arm: a successor catches up in small steps, and takes its place."""

from __future__ import annotations

import numpy as np
import pytest
from live_play import events, play, simulated

from smoother.live.answers import LiveOutput, LiveState
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.live.tracker import Tracker
from smoother.live.tracker_handover import CATCH_UP_FRAMES, SUCCESSOR_FRAMES

#: Who was fed how many frames, in order.
Fed = list[tuple[Tracker, int]]
#: Every answer with how many frames were fed in its step.
Steps = list[tuple[LiveOutput, list[int]]]


@pytest.fixture(scope="module")
def played() -> tuple[Steps, Fed]:
    """Twenty-seven seconds, with a second calibration on the way."""
    fed: Fed = []
    feed = Tracker.feed

    def counted(self, frames):
        fed.append((self, len(frames)))
        return feed(self, frames)

    outputs: Steps = []
    before = 0
    live = LiveSmoother("right", calibrator=InlineCalibrator(5))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Tracker, "feed", counted)
        for output in play(events(simulated(3, 27.0, ())), live):
            outputs.append((output, [count for _, count in fed[before:]]))
            before = len(fed)
    return outputs, fed


def test_catching_up_is_spread_over_steps(played: tuple[Steps, Fed]) -> None:
    outputs, _ = played
    assert max(sum(counts) for _, counts in outputs) <= CATCH_UP_FRAMES + 2  # two that had just come
    first = next(k for k, (output, _) in enumerate(outputs) if output.now is not None)
    busy = [k for k, (_, counts) in enumerate(outputs) if counts]
    calibrated = next(k for k, (output, _) in enumerate(outputs) if "catching up" in output.calibration)
    # to find where the arm was takes a step of its own
    assert busy[0] == calibrated + 1
    # a second after the frames that are due it is there
    assert first - calibrated < 30


def test_a_successor_takes_over_without_a_break(played: tuple[Steps, Fed]) -> None:
    outputs, fed = played
    followers = list(dict.fromkeys(tracker for tracker, _ in fed))
    assert len(followers) == 2, "one calibration from 8 s, one 15 s later"
    first, second = followers
    beside = [
        count for k, (one, count) in enumerate(fed) if one is second and first in [f for f, _ in fed[k:]]
    ]
    assert beside and max(beside) <= SUCCESSOR_FRAMES
    answers = [output for output, _ in outputs if output.now_s > 10.0]
    assert all(output.now is not None and output.state is not LiveState.LOST for output in answers)
    moved_m = np.linalg.norm(np.diff([output.now.position for output in answers], axis=0), axis=1)
    # the fastest hand here moves 1.5 m/s, 5 cm in a step
    assert moved_m.max() < 0.08
