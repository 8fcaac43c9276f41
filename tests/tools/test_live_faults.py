"""Faults fed into a live session: the answer is never wrong for long without its sigma saying so."""

from __future__ import annotations

from functools import partial

import pytest

from tools.live_faults.bench import Sound, forked, simulated, verdict_of
from tools.live_faults.kinds import KINDS

#: On a busy machine a kind takes some seconds.
LONGEST_S = 120.0


@pytest.fixture(scope="module")
def sound() -> Sound:
    """Twelve seconds of a sound session; its calibration is there after 8."""
    return Sound(simulated(4, 16.0, ()), 12.0)


@pytest.mark.parametrize(
    "kind, said",
    [
        ("IMU held for 1 s", "the gyroscope repeats a value; the camera leads meanwhile"),
        ("other body 1 m away for 3 s", "the camera is left out: it jumped away"),
        ("IMU clock set back 0.1 s", "stepped by -0.100 s"),
    ],
)
def test_a_fault_is_said_and_the_answer_stays_within_its_sigma(sound, kind, said):
    verdict = forked(partial(verdict_of, kind, 4, sound), LONGEST_S)
    assert verdict.wrong_s <= 0.5, verdict
    (first,) = [line for line in verdict.said if said in line][:1]
    assert float(first.split(" s:")[0]) < 0.5  # seconds after it began


def test_a_sound_session_is_not_accused(sound):
    verdict = forked(partial(verdict_of, "nothing wrong", 4, sound), LONGEST_S)
    assert verdict.wrong_s == 0.0 and verdict.silent_s == 0.0
    assert verdict.said == ()
    assert verdict.sound_cm < 4.0


def test_there_are_more_than_thirty_kinds():
    assert len(KINDS) > 30
